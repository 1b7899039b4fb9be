#!/usr/bin/env bash
# The table of errors on the virtual media, as Table 1 of Fuchs et al. 2005: captures each, fits, reports, and writes
# benches/results/scatter-media.csv and .md. Some minutes for each medium on two cores.
#   MEDIA="marble wax"   only these
#   WORK=FOLDER          keeps captures and reports there, and uses captures that are there already
set -euo pipefail
cd "$(dirname "$0")/../.."
[ -n "${PROGRAM:-}" ] || cargo build --release --locked
program=${PROGRAM:-${CARGO_TARGET_DIR:-target}/release/translume}
work=${WORK:-$(mktemp -d)}
[ -n "${WORK:-}" ] || trap 'rm -rf "$work"' EXIT
csv=benches/results/scatter-media.csv
md=benches/results/scatter-media.md
printf 'medium,model,ln_e_red,ln_e_green,ln_e_blue,e_red,e_green,e_blue\n' > "$csv"
for medium in ${MEDIA:-marble apple sponge wax stone}; do
    # Stone swallows most of its light: it needs more photons, and they end sooner.
    photons=8000
    [ "$medium" = stone ] && photons=30000
    if [ ! -d "$work/$medium" ]; then
        nice "$program" scatter simulate "$medium" --spots 5 --spacing 2 --thickness 8 --field 18 --pixels 36 \
            --photons "$photons" -o "$work/$medium"
    fi
    nice "$program" scatter fit "$work/$medium" --segments 8 -o "$work/$medium-model"
    nice "$program" scatter report "$work/$medium" "$work/$medium-model" -o "$work/$medium-report" --quiet > "$work/$medium.txt"
    tail -n +3 "$work/$medium-report/errors.csv" | sed "s/^/$medium,/" >> "$csv"
done
# A table of one channel: its name and its column in the CSV.
table() {
    echo
    echo "## ${1^}"
    echo
    echo "| medium | dipole | dipole, 8 directions | isotropic | 4 | 8 | isotropic, shared | 4, shared | 8, shared | 8/isotropic | shared |"
    echo "|---|---|---|---|---|---|---|---|---|---|---|"
    sed 's/directions, shared/directions shared/; s/isotropic, shared/isotropic shared/; s/dipole, 8/dipole 8/; s/"//g' "$csv" | awk -F, -v c="$2" '
        NR == 1 { next }
        !($1 in seen) { seen[$1] = 1; order[++n] = $1 }
        { e[$1, $2] = $c }
        END {
            for (i = 1; i <= n; i++) {
                m = order[i]
                printf "| %s | %s | %s | %s | %s | %s | %s | %s | %s | %.2f | %.2f |\n", m, e[m, "dipole"], e[m, "dipole 8 directions"],
                    e[m, "isotropic"], e[m, "4 directions"], e[m, "8 directions"], e[m, "isotropic shared"],
                    e[m, "4 directions shared"], e[m, "8 directions shared"],
                    e[m, "8 directions"] / e[m, "isotropic"], e[m, "8 directions shared"] / e[m, "isotropic shared"]
            }
        }'
}
{
    echo "# Planar models of the virtual media"
    echo
    echo "Mean of ln E(x_i) on pixels kept from all fits: 25 laser positions on slabs of 8 mm, frames of 18 mm with 36 × 36 pixels,"
    echo "samples above four times the noise floor. Made by \`benches/scatter/media.sh\`, also as [scatter-media.csv](scatter-media.csv). The last"
    echo "columns are the error of 8 directions over the isotropic one."
    table green 4
    table red 3
    table blue 5
} > "$md"
cat "$md"
