#!/usr/bin/env bash
# Sums of exponentials fitted by translume and by SciPy's least_squares to the same samples: prints the table and writes
# benches/results/scatter-fit.csv and scatter-fit.md. Options go to bench.py (--points N).
set -euo pipefail
cd "$(dirname "$0")/../.."

needs='import numpy, scipy'
python=${PYTHON:-python3}
if ! "$python" -c "$needs" 2>/dev/null; then
    venv=${CARGO_TARGET_DIR:-target}/bench-scatter
    python=$venv/bin/python
    if ! "$python" -c "$needs" 2>/dev/null; then
        echo "setting up $venv" >&2
        if ! { python3 -m venv "$venv" && "$python" -m pip install --quiet numpy scipy; }; then
            echo "skipped: numpy and scipy cannot be installed" >&2
            exit 0
        fi
    fi
fi
cargo build --release --locked
exec "$python" benches/scatter/bench.py "$@"
