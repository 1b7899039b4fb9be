#!/usr/bin/env bash
# Sums of exponentials fitted by translume and by SciPy's least_squares to the same samples: prints the table and writes
# benches/results/scatter-fit.csv and scatter-fit.md. Options go to bench.py (--points N).
set -euo pipefail
cd "$(dirname "$0")/../.."

. benches/python.sh
python_with bench-scatter 'numpy, scipy' numpy scipy
cargo build --release --locked
exec "$python" benches/scatter/bench.py "$@"
