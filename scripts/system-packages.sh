#!/usr/bin/env bash
# The raster renderer draws through EGL, on a GPU or on Mesa's software driver. Sees that they are there: installs them
# where this runs as root on Debian or Ubuntu, names them otherwise. Tracking needs none of this.
#
# usage: scripts/system-packages.sh [blender|browser]        with such a word, what the Blender renderer, or the tests of
# pages in a browser, need instead
set -euo pipefail

libraries=$(PATH=$PATH:/sbin:/usr/sbin ldconfig -p 2>/dev/null || true)
missing=
if [ "${1:-}" = blender ]; then
    packages="libgl1 libgomp1 libsm6 libxfixes3 libxi6 libxkbcommon0 libxrender1 libxxf86vm1"
    wanted="libGL\.so\.1 libgomp\.so\.1 libSM\.so\.6 libXfixes\.so\.3 libXi\.so\.6 libxkbcommon\.so\.0 libXrender\.so\.1
        libXxf86vm\.so\.1"
    why="Blender needs some libraries of a desktop; install them once: sudo apt-get install $packages (or your system's \
equivalents)"
elif [ "${1:-}" = browser ]; then
    packages="chromium"
    wanted=
    command -v chromium chromium-browser >/dev/null || missing=" chromium"
    why="tests of pages want a browser and are skipped without; install it once: sudo apt-get install $packages (or your \
system's equivalent)"
else
    packages="libegl1 libgl1 libgl1-mesa-dri"
    wanted="libEGL\.so\.1 libGL\.so\.1 libEGL_[a-z]*\.so"
    why="rendering needs EGL and Mesa's drivers; install them once: sudo apt-get install $packages (or your system's \
equivalents: libglvnd with EGL, and mesa's DRI drivers)"
    if command -v dpkg-query >/dev/null && ! grep -q 'libEGL_nvidia' <<<"$libraries"; then
        dpkg-query -W -f '${Status}' libgl1-mesa-dri 2>/dev/null | grep -q 'ok installed' || missing=" libgl1-mesa-dri"
    fi
fi
for library in $wanted; do
    grep -q "$library" <<<"$libraries" || missing="$missing $library"
done
[ -n "$missing" ] || exit 0

if [ "$(id -u)" = 0 ] && command -v apt-get >/dev/null; then
    echo "installing $packages"
    export DEBIAN_FRONTEND=noninteractive
    apt-get -qq update
    # shellcheck disable=SC2086
    apt-get -qq install --yes --no-install-recommends $packages >/dev/null
else
    echo "$why" >&2
fi
