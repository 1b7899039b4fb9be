#!/usr/bin/env bash
# The table of errors on the virtual media: captures each, fits, reports, and writes benches/results/scatter-media.csv.
# MEDIA="marble wax" chooses some; PHOTONS=N changes the noise (the default takes some minutes for each medium on two cores).
set -euo pipefail
cd "$(dirname "$0")/../.."
cargo build --release --locked
program=${CARGO_TARGET_DIR:-target}/release/translume
work=$(mktemp -d)
trap 'rm -rf "$work"' EXIT
out=benches/results/scatter-media.csv
printf 'medium,model,ln_e_red,ln_e_green,ln_e_blue,e_red,e_green,e_blue\n' > "$out"
for medium in ${MEDIA:-marble apple sponge wax stone}; do
    "$program" scatter simulate "$medium" --spots 6 --spacing 1.5 --thickness 8 --photons "${PHOTONS:-200000}" -o "$work/$medium"
    "$program" scatter fit "$work/$medium" --segments 8 -o "$work/$medium-model"
    "$program" scatter report "$work/$medium" "$work/$medium-model" -o "$work/$medium-report" --quiet
    tail -n +3 "$work/$medium-report/errors.csv" | sed "s/^/$medium,/" >> "$out"
done
