# What the legs that install share.

# find_python 3.12: prints an interpreter of that version, from PATH or from pyenv; fails where there is none.
find_python() {
    local candidate
    for candidate in "python$1" "${PYENV_ROOT:-$HOME/.pyenv}/versions/$1."*/bin/python; do
        # A shim of pyenv may be there without its Python.
        if [ "$("$candidate" -c 'import sys; print("%d.%d" % sys.version_info[:2])' 2> /dev/null)" = "$1" ]; then
            command -v "$candidate"
            return
        fi
    done
    return 1
}

# wheel_in FOLDER: prints the package's wheel, built there; or WHEEL, where somebody has built it already.
wheel_in() {
    [ -n "${WHEEL:-}" ] || .venv/bin/python -m pip wheel --quiet --no-deps --wheel-dir "$1" . >&2
    ls "${WHEEL:-$(echo "$1"/twohands-*.whl)}"
}

# install FOLDER WHAT...: into that environment; a module is compiled when it is first imported, and most never are.
install() {
    local folder=$1
    shift
    "$folder/bin/python" -m pip install --quiet --no-compile --disable-pip-version-check "$@"
}
