#!/usr/bin/env bash
# Tracks clips from and to a bucket: a local S3 server (moto) and s3fs, in an environment of their own, for both bring
# many packages. Where no registry can be reached it says so.
set -euo pipefail
cd "$(dirname "$0")/.."
. .ci/installing.sh
work=$(mktemp -d)
trap 'rm -rf "$work"' EXIT
python=${PYTHON:-.venv/bin/python}
"$python" -m venv "$work/venv"
wheel=$(wheel_in "$work")
if ! install "$work/venv" --constraint constraints.txt "$wheel[video,remote]" pytest onnx; then
    echo "buckets: not tried, no registry"
    exit 0
fi
install "$work/venv" s3fs "moto[server]" || { echo "buckets: no s3fs or moto"; exit 0; }
OMP_NUM_THREADS=1 "$work/venv/bin/python" -m pytest -q -p no:cacheprovider tests/batch/test_stores.py
