#!/usr/bin/env bash
# Objects of heterogeneous media, captured, fitted and relit by light that was never captured, beside the truth: prints the table and writes
# benches/results/scatter-relit.md, .csv and .png. Some ten minutes for each medium on two cores. Options go to relit.py (--help).
set -euo pipefail
cd "$(dirname "$0")/../.."

needs='import numpy, OpenEXR, PIL'
python=${PYTHON:-python3}
if ! "$python" -c "$needs" 2>/dev/null; then
    venv=${CARGO_TARGET_DIR:-target}/bench-relit
    python=$venv/bin/python
    if ! "$python" -c "$needs" 2>/dev/null; then
        echo "setting up $venv" >&2
        if ! { python3 -m venv "$venv" && "$python" -m pip install --quiet numpy OpenEXR pillow; }; then
            echo "skipped: numpy, OpenEXR and pillow cannot be installed" >&2
            exit 0
        fi
    fi
fi
[ -n "${PROGRAM:-}" ] || cargo build --release --locked
exec "$python" benches/scatter/relit.py "$@"
