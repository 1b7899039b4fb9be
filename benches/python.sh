# Sourced by the benches that compare with Python packages, from the root.
#   python_with NAME MODULES PACKAGE…   sets $python to one that imports MODULES: $PYTHON or python3, or else one in a folder NAME of the
#                                       target folder, where it installs the packages; ends the bench where that cannot be done
python_with() {
    local name=$1 needs="import $2"
    shift 2
    python=${PYTHON:-python3}
    "$python" -c "$needs" 2>/dev/null && return
    local venv=${CARGO_TARGET_DIR:-target}/$name
    python=$venv/bin/python
    "$python" -c "$needs" 2>/dev/null && return
    echo "setting up $venv" >&2
    if ! { python3 -m venv "$venv" && "$python" -m pip install --quiet "$@"; }; then
        echo "skipped: $* cannot be installed" >&2
        exit 0
    fi
}
