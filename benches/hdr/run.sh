#!/usr/bin/env bash
# Brackets with a known truth through translume and through OpenCV: prints the table, writes benches/results/hdr.csv and
# hdr.md. Options go to bench.py (--quick: few cases, --docs: also the table and pictures of docs/hdr.md).
# Scenes: the one built into the program, and those of TRANSLUME_DATA, if it is set.
set -euo pipefail
cd "$(dirname "$0")/../.."

. benches/python.sh
python_with bench-hdr 'cv2, numpy, OpenEXR' numpy OpenEXR opencv-python-headless
cargo build --release --locked
exec "$python" benches/hdr/bench.py "$@"
