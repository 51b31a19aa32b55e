#!/usr/bin/env bash
# Installs the built package without any extra into an empty environment, and tracks there.
set -euo pipefail
cd "$(dirname "$0")/.."
work=$(mktemp -d)
trap 'rm -rf "$work"' EXIT
"${PYTHON:-.venv/bin/python}" -m venv "$work/venv"
"$work/venv/bin/python" -m pip install --quiet --constraint constraints.txt .
check=$PWD/.ci/check_core_install.py
cd "$work" # away from the sources: what counts is what was installed
"$work/venv/bin/python" "$check"
