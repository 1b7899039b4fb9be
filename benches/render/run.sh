#!/usr/bin/env bash
# Samples per second and memory of `translume render --integrator path` beside Mitsuba 3 on the scenes of TRANSLUME_DATA:
# prints the table, writes benches/results/render-speed.md and .csv. Options go to bench.py.
set -euo pipefail
cd "$(dirname "$0")/../.."

if [ -z "${TRANSLUME_DATA:-}" ]; then
    echo "skipped: TRANSLUME_DATA does not say where the scenes are" >&2
    exit 0
fi
needs='import mitsuba'
python=${PYTHON:-python3}
if ! "$python" -c "$needs" 2>/dev/null; then
    venv=${CARGO_TARGET_DIR:-target}/bench-render
    python=$venv/bin/python
    if ! "$python" -c "$needs" 2>/dev/null; then
        echo "setting up $venv" >&2
        if ! { python3 -m venv "$venv" && "$python" -m pip install --quiet mitsuba; }; then
            echo "skipped: mitsuba cannot be installed" >&2
            exit 0
        fi
    fi
fi
cargo build --release --locked
exec "$python" benches/render/bench.py "$@"
