#!/bin/sh
# Generates the synthetic light stage, measures every method on it, and prints the tables of benches/results/field.md.
#   benches/field/run.sh [SIZE [LIGHTS [STACK …]]]      stacks: further folders with pictures and lights
# Needs Python with NumPy, OpenEXR and scikit-learn for the peers ($PYTHON, python3 by default); skips them without.
set -eu
cd "$(dirname "$0")/../.."
size=${1:-512}; lights=${2:-253}
[ $# -gt 2 ] && shift 2 || set --
cargo build --release -q -p bench-field
bench=${CARGO_TARGET_DIR:-target}/release/bench-field
stage=$(mktemp -d); trap 'rm -rf "$stage"' EXIT
echo "Synthetic light stage: $lights lights, $size x $size, half-float EXR; $(nproc) cores, $(date +%F)"; echo
"$bench" generate "$stage" "$size" "$lights"
"$bench" table "$stage"; echo
"$bench" held-out "$stage"; echo
for stack in "$@"; do echo "$stack:"; echo; "$bench" table "$stack"; echo; "$bench" held-out "$stack"; echo; done
echo "| decomposition, 16 terms | seconds | energy left |"; echo "|---|--:|--:|"
"$bench" pca "$stage"
"${PYTHON:-python3}" benches/field/peers.py "$stage" || echo "| peers skipped: no NumPy or OpenEXR | | |"; echo
"$bench" speed "$stage"
