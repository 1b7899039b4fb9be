//! Ray throughput on one thread, ours beside Embree on the same meshes and rays, in the same run.
//!
//! `cargo run --release -p bench-trace --features embree` prints the table and writes
//! `benches/results/trace-throughput.{csv,md}`. Without the feature, the Embree columns are empty. Scanned meshes are
//! taken from `$TRANSLUME_DATA/meshes`; without the variable only the procedural one is measured.
//!
//! Each mesh stands in a closed room of twelve triangles. Three kinds of rays: `coherent` from a camera, in rows;
//! `diffuse` from the surfaces the camera sees, cosine-distributed; `any-hit` segments from there to random points of the
//! room. Rounds alternate between the contestants; the medians are reported.

#[cfg(feature = "embree")]
mod peer;
mod rays;

use rays::{Kind, RaySet};
use std::fmt::Write as _;
use std::hint::black_box;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::time::Instant;
use translume_mesh::{ReadOptions, TriMesh, read};
use translume_trace::Geometry;

const ROUNDS: usize = 9;

/// Something that answers a set of rays: seconds and number of hits.
type Contestant<'a> = Box<dyn Fn(&RaySet) -> (f64, usize) + 'a>;

fn main() -> anyhow::Result<()> {
    let mut csv = String::from("mesh,triangles,rays,contestant,mrays_per_s,ratio_to_embree,hits\n");
    let mut table = String::from(
        "| mesh | triangles | rays | ours, Mray/s | portable | Embree | ours / Embree |\n|---|---|---|---|---|---|---|\n",
    );
    let (mut log_ratio, mut ratios) = (0.0, 0);
    for (name, mesh) in meshes()? {
        let mesh = Arc::new(rays::in_room(mesh));
        let start = Instant::now();
        let ours = Geometry::from_mesh(mesh.clone())?;
        let (seconds, megabytes) = (start.elapsed().as_secs_f64(), ours.memory() / 1_000_000);
        println!("{name}: {} triangles, built in {seconds:.2} s, tree of {megabytes} MB", mesh.indices.len());
        let portable = Geometry::from_mesh(mesh.clone())?.without_simd();
        #[cfg(feature = "embree")]
        let peer = peer::Embree::new(&mesh);
        #[allow(unused_mut)]
        let mut contestants: Vec<(&str, Contestant)> =
            vec![("ours", Box::new(|set| run(&ours, set))), ("portable", Box::new(|set| run(&portable, set)))];
        #[cfg(feature = "embree")]
        contestants.push(("embree", Box::new(|set| peer.run(set))));
        for kind in [Kind::Coherent, Kind::Diffuse, Kind::AnyHit] {
            let set = RaySet::new(kind, &ours);
            let speeds = race(&contestants, &set);
            let embree = speeds.get(2).map(|s| s.0);
            for ((who, _), (speed, hits)) in contestants.iter().zip(&speeds) {
                let ratio = embree.map_or(String::new(), |e| format!("{:.3}", speed / e));
                let (n, kind) = (mesh.indices.len(), kind.name());
                writeln!(csv, "{name},{n},{kind},{who},{speed:.3},{ratio},{hits}")?;
            }
            let (peer_speed, ratio) = match embree {
                Some(e) => (format!("{e:.2}"), format!("{:.2}", speeds[0].0 / e)),
                None => ("–".into(), "–".into()),
            };
            if let Some(e) = embree {
                log_ratio += (speeds[0].0 / e).ln();
                ratios += 1;
            }
            let row = format!(
                "| {name} | {} | {} | {:.2} | {:.2} | {peer_speed} | {ratio} |",
                mesh.indices.len(),
                kind.name(),
                speeds[0].0,
                speeds[1].0
            );
            println!("{row}  hits {:?}", speeds.iter().map(|s| s.1).collect::<Vec<_>>());
            table += &(row + "\n");
        }
    }
    if ratios > 0 {
        let mean = (log_ratio / f64::from(ratios)).exp();
        println!("geometric mean of ours / Embree: {mean:.3}");
        writeln!(table, "\nGeometric mean of ours / Embree: {mean:.2}.")?;
    }
    save(&csv, &table)
}

fn run(geometry: &Geometry, set: &RaySet) -> (f64, usize) {
    let start = Instant::now();
    let hits = match set.kind {
        Kind::AnyHit => set.rays.iter().filter(|ray| geometry.occluded(ray)).count(),
        _ => set.rays.iter().filter(|ray| black_box(geometry.intersect(ray)).is_some()).count(),
    };
    (start.elapsed().as_secs_f64(), hits)
}

/// Median speed in millions of rays per second, and hits, of each contestant over alternating rounds.
fn race(contestants: &[(&str, Contestant)], set: &RaySet) -> Vec<(f64, usize)> {
    let mut times = vec![Vec::new(); contestants.len()];
    let mut hits = vec![0; contestants.len()];
    for _ in 0..ROUNDS {
        for (i, (_, run)) in contestants.iter().enumerate() {
            let (seconds, n) = run(set);
            times[i].push(seconds);
            hits[i] = n;
        }
    }
    times
        .into_iter()
        .zip(hits)
        .map(|(mut t, hits)| {
            t.sort_by(f64::total_cmp);
            (set.rays.len() as f64 / t[ROUNDS / 2] / 1e6, hits)
        })
        .collect()
}

fn meshes() -> anyhow::Result<Vec<(String, TriMesh)>> {
    let mut meshes = Vec::new();
    match std::env::var_os("TRANSLUME_DATA").map(PathBuf::from) {
        Some(data) => {
            for file in ["armadillo/armadillo.obj", "stanford-dragon-100k/dragon.obj", "igea/igea_triangles.ply"] {
                let path = data.join("meshes").join(file);
                let name = path.parent().and_then(Path::file_name).unwrap_or_default().to_string_lossy().into_owned();
                let mesh = read(&path, &ReadOptions::default())?.merged().unwrap_or_default();
                meshes.push((name, mesh));
            }
        }
        None => eprintln!("TRANSLUME_DATA is not set: the scanned meshes are left out"),
    }
    meshes.push(("bumpy sphere 1M".into(), rays::bumpy_sphere(724)));
    Ok(meshes)
}

fn save(csv: &str, table: &str) -> anyhow::Result<()> {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("../results");
    std::fs::create_dir_all(&folder)?;
    let machine = std::fs::read_to_string("/proc/cpuinfo").unwrap_or_default();
    let model = machine.lines().find_map(|l| l.strip_prefix("model name")?.split_once(": ")).map_or("unknown", |m| m.1);
    let cores = std::thread::available_parallelism().map_or(1, usize::from);
    let head = format!(
        "# Ray throughput on one thread\n\nMachine: {model}, {cores} cores. Medians of {ROUNDS} interleaved rounds:\n\
         absolute figures depend on what else runs, ratios hardly do. “portable” is the same code without AVX2.\n\n"
    );
    std::fs::write(folder.join("trace-throughput.csv"), format!("# {model}; {cores} cores\n{csv}"))?;
    std::fs::write(folder.join("trace-throughput.md"), head + table)?;
    Ok(())
}
