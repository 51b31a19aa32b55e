#!/usr/bin/env bash
# Makes the view's bundle again from its sources and compares: what ships is what the sources say. Without npm, or where
# no registry can be reached, it says so; that the bundle names its sources' hash is tested anyway.
set -euo pipefail
root=$(cd "$(dirname "$0")/.." && pwd)
cd "$root/view"
if ! command -v npm > /dev/null || ! timeout 20 npm ping > /dev/null 2>&1; then
    echo "view: not made again, no npm or no registry"
    exit 0
fi
work=$(mktemp -d)
trap 'rm -rf "$work"' EXIT
cp -r package.json package-lock.json tsconfig.json build.mjs src "$work"
cd "$work"
npm ci --omit=dev --ignore-scripts --no-audit --no-fund --loglevel=error > /dev/null
node build.mjs "$work/view.js"
cmp "$work/view.js" "$root/src/twohands/visualization/view/view.js" || {
    echo "view.js is not what its sources give: npm ci && npm run build in view/, and commit it" >&2
    exit 1
}
echo "view: the bundle is what its sources give"
