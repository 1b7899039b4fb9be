#!/usr/bin/env bash
# A capture larger than memory: makes one (4 GiB unpacked), fits it with one GiB of address space, and checks the fit
# against the fall-off that it was made with. Some minutes.
#   GIGABYTES=4  size of the frames      LIMIT_KB=1048576  limit of the address space      WORK=FOLDER  keeps the files
set -euo pipefail
cd "$(dirname "$0")/../.."
[ -n "${PROGRAM:-}" ] || cargo build --release --locked
program=$(realpath "${PROGRAM:-${CARGO_TARGET_DIR:-target}/release/translume}")
work=${WORK:-$(mktemp -d)}
[ -n "${WORK:-}" ] || trap 'rm -rf "$work"' EXIT
[ -d "$work/capture" ] || python3 benches/scatter/large_capture.py "$work/capture" "${GIGABYTES:-4}"
(
    ulimit -v "${LIMIT_KB:-1048576}"
    TIMEFORMAT='%R s, of the processors %U s'
    time nice "$program" scatter fit "$work/capture" --terms 1 -o "$work/model"
)
python3 - "$work/model/model.json" <<'PY'
import json, sys
points = json.load(open(sys.argv[1]))["points"]
rates = [f["segments"][0]["d"][0] for p in points for f in p["fall_off"]]
assert len(rates) == 3 * len(points) and all(abs(r + 1.2) < 0.01 for r in rates), (min(rates), max(rates))
print(f"{len(points)} points; all rates within {max(abs(r + 1.2) for r in rates):.1e} of the truth")
PY
