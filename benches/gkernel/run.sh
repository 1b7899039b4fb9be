#!/usr/bin/env bash
# Methods of light transport at equal time on the many-light floor, and their bias: prints the tables and writes
# benches/results/gkernel.md, .csv and .png. Options go to bench.py (--help tells them; the whole run takes two hours).
set -euo pipefail
cd "$(dirname "$0")/../.."

. benches/python.sh
python_with bench-gkernel 'mitsuba, OpenEXR, matplotlib' mitsuba OpenEXR matplotlib numpy
cargo build --release --locked
exec "$python" benches/gkernel/bench.py "$@"
