#!/usr/bin/env bash
# Brackets with a known truth through translume and through OpenCV: prints the table, writes benches/results/hdr.csv and
# hdr.md. Options go to bench.py (--quick: few cases, --docs: also the table and pictures of docs/hdr.md).
# Scenes: the one built into the program, and those of TRANSLUME_DATA, if it is set.
set -euo pipefail
cd "$(dirname "$0")/../.."

needs='import cv2, numpy, OpenEXR'
python=${PYTHON:-python3}
if ! "$python" -c "$needs" 2>/dev/null; then
    venv=${CARGO_TARGET_DIR:-target}/bench-hdr
    python=$venv/bin/python
    if ! "$python" -c "$needs" 2>/dev/null; then
        echo "setting up $venv" >&2
        if ! { python3 -m venv "$venv" && "$python" -m pip install --quiet numpy OpenEXR opencv-python-headless; }; then
            echo "skipped: numpy, OpenEXR and opencv-python-headless cannot be installed" >&2
            exit 0
        fi
    fi
fi
cargo build --release --locked
exec "$python" benches/hdr/bench.py "$@"
