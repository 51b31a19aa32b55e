#!/usr/bin/env bash
# Installs the core at the lower bounds that pyproject.toml declares into an empty environment, on Python 3.10 where
# there is one; tracks there, and runs the tests that need nothing more.
set -euo pipefail
cd "$(dirname "$0")/.."
. .ci/installing.sh
python=${PYTHON:-$(find_python 3.10 || echo "$PWD/.venv/bin/python")}
work=$(mktemp -d)
trap 'rm -rf "$work"' EXIT
sed -n '/^dependencies = \[/,/^\]/s/^ *"\([^"]*\)>=\([^"]*\)",.*/\1==\2/p' pyproject.toml > "$work/bounds.txt"
[ -s "$work/bounds.txt" ] || { echo "no lower bounds found in pyproject.toml" >&2; exit 1; }
echo "lowest versions on $("$python" --version): $(tr '\n' ' ' < "$work/bounds.txt")"
"$python" -m venv "$work/venv"
install "$work/venv" --requirement "$work/bounds.txt" "$(wheel_in "$work")" pytest
(cd "$work" && HOME=$work/home "$work/venv/bin/twohands" demo --out "$work/demo" > /dev/null)
(cd "$work" && venv/bin/python - > "$work/help.txt") <<'PYTHON'
from twohands.cli.main import VERBS, main
failed = [verb for verb in VERBS if main([verb, "--help"]) != 0]
assert len(VERBS) >= 12 and not failed, f"--help fails: {failed}"
PYTHON
OMP_NUM_THREADS=1 "$work/venv/bin/python" -m pytest -q -p no:cacheprovider \
    tests/formats tests/geometry tests/test_plausibility.py tests/test_skeleton.py
