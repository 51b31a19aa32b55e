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
