#!/bin/sh
# Renders the light stage of docs/examples, measures every method on it and on further stacks, and prints the tables of
# benches/results/field.md.
#   benches/field/run.sh [STACK …]        stacks: folders with pictures and lights
# $STAGE: folder for the rendered stack; pictures that are there stay (default: a temporary one). $SIZE: its edge (512).
# $PYTHON: a Python with NumPy, OpenEXR and scikit-learn for the peers (python3); they are skipped, and that is said, without.
set -eu
cd "$(dirname "$0")/../.."
size=${SIZE:-512}
cargo build --release -q -p bench-field -p translume
bin=${CARGO_TARGET_DIR:-target}/release
bench=$bin/bench-field
scratch=$(mktemp -d); trap 'rm -rf "$scratch"' EXIT
stage=${STAGE:-$scratch/stage}
echo "$(date +%F), $(nproc) cores of $(sed -n 's/model name.*: //p' /proc/cpuinfo | head -1), load $(cut -d' ' -f1 /proc/loadavg)"
echo; echo "## Rendered light stage: 253 lamps of 2°, $size × $size, half-float EXR"; echo
"$bin/translume" --quiet capture light-stage docs/examples/light-stage/scene.xml -o "$stage" --spp 32 --clamp 1 --size "${size}x$size"
echo
"$bench" table "$stage"; echo
"$bench" held-out "$stage"; echo
for stack in "$@"; do
    echo "## $(basename "$stack")"; echo; "$bench" table "$stack"; echo; "$bench" held-out "$stack"; echo
done
echo "## Decomposition, rendered light stage, 16 terms of log light"; echo
echo "| | seconds | energy left |"; echo "|---|--:|--:|"
"$bench" pca "$stage"
"${PYTHON:-python3}" benches/field/peers.py "$stage" || echo "| peers skipped: no NumPy or OpenEXR | | |"; echo
echo "## Time and memory: 253 pictures of 1024 × 1024"; echo
"$bench" generate "$scratch/large" 1024 253
"$bench" cost "$scratch/large"; echo
"$bench" speed "$scratch/large"
