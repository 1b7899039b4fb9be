#!/usr/bin/env bash
# Samples per second and memory of `translume render --integrator path` beside Mitsuba 3 on the scenes of TRANSLUME_DATA:
# prints the table, writes benches/results/render-speed.md and .csv. Options go to bench.py.
set -euo pipefail
cd "$(dirname "$0")/../.."

if [ -z "${TRANSLUME_DATA:-}" ]; then
    echo "skipped: TRANSLUME_DATA does not say where the scenes are" >&2
    exit 0
fi
. benches/python.sh
python_with bench-render 'mitsuba' mitsuba
cargo build --release --locked
exec "$python" benches/render/bench.py "$@"
