#!/usr/bin/env bash
# Installs the built package without any extra into an empty environment of every Python that is supported and here,
# and tracks the examples there: from another folder, with no home. Those that are not here are named.
set -euo pipefail
cd "$(dirname "$0")/.."
. .ci/find-python.sh
work=$(mktemp -d)
trap 'rm -rf "$work"' EXIT
.venv/bin/python -m pip wheel --quiet --no-deps --wheel-dir "$work" .
constraints=$PWD/constraints.txt
absent=""
for version in ${VERSIONS:-3.10 3.11 3.12 3.13 3.14}; do
    python=$(find_python "$version") || { absent="$absent $version"; continue; }
    "$python" -m venv "$work/$version"
    "$work/$version/bin/python" -m pip install --quiet --constraint "$constraints" "$work"/twohands-*.whl
    (cd / && env -u XDG_CACHE_HOME HOME=/nonexistent TMPDIR="$work" \
        "$work/$version/bin/twohands" demo --out "$work/demo-$version" > /dev/null)
    "$work/$version/bin/python" - "$work/demo-$version/hands.json" <<'PYTHON'
import json, platform, sys
frames = json.load(open(sys.argv[1]))["frames"]
ranges = [hand["range_m"] for frame in frames for hand in frame["hands"].values() if hand["present"]]
assert len(frames) == 4 and len(ranges) >= 6, f"{len(ranges)} hands in {len(frames)} examples"
print(f"Python {platform.python_version()}: {len(ranges)} hands, ranges of {100 * sum(ranges) / len(ranges):.2f} cm on average")
PYTHON
    rm -rf "${work:?}/$version"
done
[ -z "$absent" ] || echo "not here, not tried: Python$absent"
