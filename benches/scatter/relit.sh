#!/usr/bin/env bash
# Objects of heterogeneous media, captured, fitted and relit by light that was never captured, beside the truth: prints the table and writes
# benches/results/scatter-relit.md, .csv and .png. Some ten minutes for each medium on two cores. Options go to relit.py (--help).
set -euo pipefail
cd "$(dirname "$0")/../.."

. benches/python.sh
python_with bench-relit 'numpy, OpenEXR, PIL' numpy OpenEXR pillow
[ -n "${PROGRAM:-}" ] || cargo build --release --locked
exec "$python" benches/scatter/relit.py "$@"
