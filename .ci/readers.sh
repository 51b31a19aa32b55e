#!/usr/bin/env bash
# Fetches the programs by which tests read our glTF files back: Khronos' validator and three.js. Without npm, or where no
# registry can be reached, it says so, and those tests are skipped.
set -euo pipefail
cd "$(dirname "$0")/../tests/motion/node"
if ! command -v npm > /dev/null || ! timeout 20 npm ping > /dev/null 2>&1; then
    echo "readers of glTF: not fetched, no npm or no registry; their tests are skipped"
    exit 0
fi
npm ci --ignore-scripts --no-audit --no-fund --loglevel=error > /dev/null
