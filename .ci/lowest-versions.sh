#!/usr/bin/env bash
# Installs the core at the lower bounds that pyproject.toml declares into an empty environment, on Python 3.10 where
# there is one; tracks there, and runs the tests that need nothing more.
set -euo pipefail
cd "$(dirname "$0")/.."
. .ci/find-python.sh
python=${PYTHON:-$(find_python 3.10 || echo "$PWD/.venv/bin/python")}
work=$(mktemp -d)
trap 'rm -rf "$work"' EXIT
sed -n '/^dependencies = \[/,/^\]/s/^ *"\([^"]*\)>=\([^"]*\)",.*/\1==\2/p' pyproject.toml > "$work/bounds.txt"
[ -s "$work/bounds.txt" ] || { echo "no lower bounds found in pyproject.toml" >&2; exit 1; }
echo "lowest versions on $("$python" --version): $(tr '\n' ' ' < "$work/bounds.txt")"
"$python" -m venv "$work/venv"
"$work/venv/bin/python" -m pip install --quiet --requirement "$work/bounds.txt" . pytest
(cd "$work" && HOME=$work/home "$work/venv/bin/twohands" demo --out "$work/demo" > /dev/null)
for verb in track live demo calibrate generate inspect train eval bench export lift export-motion; do
    "$work/venv/bin/twohands" "$verb" --help > /dev/null || { echo "twohands $verb --help fails" >&2; exit 1; }
done
OMP_NUM_THREADS=1 "$work/venv/bin/python" -m pytest -q -p no:cacheprovider \
    tests/formats tests/geometry tests/test_plausibility.py tests/test_skeleton.py
