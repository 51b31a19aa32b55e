#!/usr/bin/env bash
# Makes a virtual environment with this package, editable, and some of its extras, at the versions of constraints.txt.
# Does nothing where that has been done already and neither pyproject.toml nor constraints.txt has changed since.
#
# usage: scripts/environment.sh FOLDER EXTRA[,EXTRA...]        e.g. scripts/environment.sh .venv view
# PYTHON chooses the interpreter; without it, the first one from 3.10 on is taken.
set -euo pipefail
cd "$(dirname "$0")/.."
venv=$1
extras=$2
wanted=$(cat pyproject.toml constraints.txt | cksum)

installed() { # EXTRA: whether it was installed from the files as they are now
    [ -x "$venv/bin/twohands" ] && [ "$(cat "$venv/installed-$1" 2>/dev/null)" = "$wanted" ]
}

missing=no
for extra in ${extras//,/ }; do
    installed "$extra" || missing=yes
done
[ "$missing" = yes ] || exit 0

new_enough() { "$1" -c 'import sys; sys.exit(sys.version_info < (3, 10))' >/dev/null 2>&1; }

if ! { [ -x "$venv/bin/python" ] && new_enough "$venv/bin/python"; }; then
    for python in ${PYTHON:-python3 python python3.14 python3.13 python3.12 python3.11 python3.10}; do
        if new_enough "$python"; then break; fi
        python=
    done
    if [ -z "${python:-}" ]; then
        echo "twohands needs Python 3.10 or newer; none was found${PYTHON:+ as '$PYTHON'}. Set PYTHON=/path/to/python3" >&2
        exit 2
    fi
    echo "making $venv with $("$python" --version)"
    rm -rf "$venv"
    "$python" -m venv "$venv"
fi

echo "installing twohands[$extras] into $venv"
"$venv/bin/python" -m pip install --quiet "pip>=21.3" # older ones cannot install a pyproject.toml editable
"$venv/bin/python" -m pip install --quiet --constraint constraints.txt --editable ".[$extras]"
for extra in ${extras//,/ }; do
    echo "$wanted" > "$venv/installed-$extra"
done
