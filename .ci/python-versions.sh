#!/usr/bin/env bash
# Installs the built package without any extra into an empty environment of every Python that is supported and here,
# and tracks the examples there: from another folder, with no home. Those that are not here are named; TRIED, which
# another leg has tried, is left out.
set -euo pipefail
cd "$(dirname "$0")/.."
. .ci/installing.sh
work=$(mktemp -d)
trap 'rm -rf "$work"' EXIT
wheel=$(wheel_in "$work")
absent=""
for version in 3.10 3.11 3.12 3.13 3.14; do
    [ "$version" != "${TRIED:-}" ] || continue
    python=$(find_python "$version") || { absent="$absent $version"; continue; }
    "$python" -m venv "$work/$version"
    install "$work/$version" --constraint constraints.txt "$wheel"
    (cd / && env -u XDG_CACHE_HOME HOME=/nonexistent TMPDIR="$work" \
        "$work/$version/bin/twohands" demo --out "$work/demo-$version" > /dev/null)
    "$work/$version/bin/python" .ci/check_examples.py "$work/demo-$version/hands.json"
    rm -rf "${work:?}/$version"
done
[ -z "$absent" ] || echo "not here, not tried: Python$absent"
