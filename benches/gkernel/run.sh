#!/usr/bin/env bash
# Methods of light transport at equal time on the many-light floor, and their bias: prints the tables and writes
# benches/results/gkernel.md, .csv and .png. Options go to bench.py (--help tells them; the whole run takes two hours).
set -euo pipefail
cd "$(dirname "$0")/../.."

python=${PYTHON:-python3}
if ! "$python" -c 'import mitsuba, OpenEXR, matplotlib' 2>/dev/null; then
    venv=${CARGO_TARGET_DIR:-target}/bench-gkernel
    python=$venv/bin/python
    if ! "$python" -c 'import mitsuba, OpenEXR, matplotlib' 2>/dev/null; then
        echo "setting up $venv" >&2
        if ! { python3 -m venv "$venv" && "$python" -m pip install --quiet mitsuba OpenEXR matplotlib numpy; }; then
            echo "skipped: mitsuba, OpenEXR and matplotlib cannot be installed" >&2
            exit 0
        fi
    fi
fi
cargo build --release --locked
exec "$python" benches/gkernel/bench.py "$@"
