#!/usr/bin/env bash
# Installs the built package without any extra into an empty environment, and tracks there: with a clock, and then as a
# user without home, in another folder than the sources', on a file system where only the results' folder and the one
# for temporary files can be written, and with no network.
set -euo pipefail
cd "$(dirname "$0")/.."
. .ci/installing.sh
work=$(mktemp -d)
trap 'rm -rf "$work"' EXIT
python=${PYTHON:-.venv/bin/python}
wheel=$(wheel_in "$work")
"$python" -m venv "$work/venv"
install "$work/venv" --constraint constraints.txt "$wheel"
check=$PWD/.ci/check_core_install.py
examples=$PWD/.ci/check_examples.py
cd "$work" # away from the sources: what counts is what was installed
"$work/venv/bin/python" "$check"

mkdir "$work/out" "$work/tmp"
run="env -u CI -u XDG_CACHE_HOME HOME=/nonexistent TMPDIR=$work/tmp $work/venv/bin/twohands demo --out $work/out/demo"
cd /
if unshare --net --mount true 2>/dev/null; then
    unshare --net --mount bash -euc "
        mount --bind $work/out $work/out && mount --bind $work/tmp $work/tmp
        mount -o remount,bind,ro / 2>/dev/null || echo 'the file system stays writable here'
        $run"
else
    echo "no name spaces here: with network and a writable file system"
    $run
fi
"$work/venv/bin/python" "$examples" "$work/out/demo/hands.json"
left=$(find "$work/tmp" -type f ! -path "*/twohands-cache-*" | head)
[ -z "$left" ] || { echo "left behind: $left" >&2; exit 1; }
echo "quiet: no home, nothing left behind"
