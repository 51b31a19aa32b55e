#!/usr/bin/env bash
# Tracks from a wheel, as a user without home, in a folder that is not the sources, on a file system where only the
# results' folder and the one for temporary files can be written, and with no network; then looks at what was left.
set -euo pipefail
cd "$(dirname "$0")/.."
work=$(mktemp -d)
trap 'rm -rf "$work"' EXIT
"${PYTHON:-.venv/bin/python}" -m pip wheel --quiet --no-deps --wheel-dir "$work" .
"${PYTHON:-.venv/bin/python}" -m venv "$work/venv"
"$work/venv/bin/python" -m pip install --quiet --constraint constraints.txt "$work"/twohands-*.whl
mkdir "$work/out" "$work/tmp"
run="env -u CI -u XDG_CACHE_HOME HOME=/nonexistent TMPDIR=$work/tmp $work/venv/bin/twohands demo --out $work/out/demo"
cd /
if unshare --net --mount true 2>/dev/null; then
    unshare --net --mount bash -euc "
        mount --bind $work/out $work/out && mount --bind $work/tmp $work/tmp
        mount -o remount,bind,ro / 2>/dev/null || true
        $run"
else
    $run
fi
test -s "$work/out/demo/hands.json"
left=$(find "$work/tmp" -type f ! -path "*/twohands-cache-*" | head)
[ -z "$left" ] || { echo "left behind: $left" >&2; exit 1; }
echo "quiet: no home, no network, nothing left behind"
