#!/usr/bin/env bash
# The raster renderer draws through EGL, on a GPU or on Mesa's software driver. Sees that they are there: installs them
# where this runs as root on Debian or Ubuntu, names them otherwise. Tracking needs none of this.
set -euo pipefail
packages="libegl1 libgl1 libgl1-mesa-dri"

libraries=$(PATH=$PATH:/sbin:/usr/sbin ldconfig -p 2>/dev/null || true)
missing=
for library in 'libEGL\.so\.1' 'libGL\.so\.1' 'libEGL_[a-z]*\.so'; do
    grep -q "$library" <<<"$libraries" || missing="$missing $library"
done
if command -v dpkg-query >/dev/null && ! grep -q 'libEGL_nvidia' <<<"$libraries"; then
    dpkg-query -W -f '${Status}' libgl1-mesa-dri 2>/dev/null | grep -q 'ok installed' || missing="$missing libgl1-mesa-dri"
fi
[ -n "$missing" ] || exit 0

if [ "$(id -u)" = 0 ] && command -v apt-get >/dev/null; then
    echo "installing $packages"
    export DEBIAN_FRONTEND=noninteractive
    apt-get -qq update
    # shellcheck disable=SC2086
    apt-get -qq install --yes --no-install-recommends $packages >/dev/null
else
    echo "rendering needs EGL and Mesa's drivers; install them once: sudo apt-get install $packages (or your system's" \
        "equivalents: libglvnd with EGL, and mesa's DRI drivers)" >&2
fi
