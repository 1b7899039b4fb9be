//! Two builds of the program on the same work: their outputs must be the same to the bit, as moves and renames promise.
//!
//! Compared is what was computed, not what is told about it: pixels of pictures, numbers of models; versions, command lines
//! and times are left out. Inputs are the folder that `translume demo` of the old build fills.

use serde_json::Value;
use std::path::{Path, PathBuf};
use std::process::Command;

pub(crate) const HELP: &str = "\
Usage: cargo xtask same-bits OLD NEW [--full] [--demo DIR]

  OLD, NEW    two programs, such as the one of the commit before a move and target/release/translume
  --full      larger pictures and more samples, and the models of the demo beside
  --demo DIR  inputs: a folder that `translume demo DIR` made; without it OLD makes one";

const METHODS: [&str; 4] = ["path", "bdpt", "photonmap", "gkernel"];

/// Keys of JSON files that tell about the run instead of its result.
const ABOUT_THE_RUN: [&str; 4] = ["generator", "command", "seconds", "software"];

/// A capture of a flat sample, for which the demo has none.
const SLAB: [&str; 9] = ["scatter", "simulate", "marble", "--spots", "4", "--photons", "1000", "--evenness", "0.5"];

/// One run of a program: what it is called in the table, its arguments in pieces, its output.
struct Job {
    name: String,
    arguments: Vec<String>,
    output: &'static str,
}

struct Options {
    old: PathBuf,
    new: PathBuf,
    full: bool,
    demo: Option<PathBuf>,
}

/// Runs both programs and prints a table of what they wrote.
///
/// # Errors
/// The outputs that differ, or the run that failed.
pub(crate) fn run(words: &[&str]) -> Result<(), String> {
    let options = parse(words)?;
    let folder = std::env::temp_dir().join(format!("translume-same-bits-{}", std::process::id()));
    let outcome = compare(&options, &folder);
    // Kept when something differs, so that it can be looked at.
    match &outcome {
        Ok(()) => drop(std::fs::remove_dir_all(&folder)),
        Err(_) => eprintln!("the files are in {}", folder.display()),
    }
    outcome
}

fn parse(words: &[&str]) -> Result<Options, String> {
    let (mut programs, mut full, mut demo) = (Vec::new(), false, None);
    let mut words = words.iter();
    while let Some(word) = words.next() {
        match *word {
            "--full" => full = true,
            "--demo" => demo = Some(PathBuf::from(words.next().ok_or("--demo needs a folder")?)),
            other if other.starts_with('-') => return Err(format!("unknown option {other}\n\n{HELP}")),
            program => programs.push(std::path::absolute(program).map_err(|e| format!("{program}: {e}"))?),
        }
    }
    let [old, new] = <[PathBuf; 2]>::try_from(programs).map_err(|_| format!("two programs are needed\n\n{HELP}"))?;
    Ok(Options { old, new, full, demo })
}

fn compare(options: &Options, folder: &Path) -> Result<(), String> {
    std::fs::create_dir_all(folder).map_err(|e| format!("{}: {e}", folder.display()))?;
    let demo = match &options.demo {
        Some(demo) => std::path::absolute(demo).map_err(|e| format!("{}: {e}", demo.display()))?,
        None => {
            let demo = folder.join("demo");
            eprintln!("making the inputs with {} demo", options.old.display());
            translume(&options.old, &["demo".into(), text(&demo)])?;
            demo
        }
    };
    let slab = folder.join("slab");
    translume(&options.old, &[&SLAB.map(str::to_owned)[..], &["-o".into(), text(&slab)]].concat())?;
    println!("{:<36} {:<16}  {:<16}  same", "output", "old", "new");
    let mut different = Vec::new();
    for job in jobs(&demo, &slab, options.full) {
        let results = [("old", &options.old), ("new", &options.new)].map(|(side, program)| {
            let dir = folder.join(side).join(job.name.replace([' ', '/'], "-"));
            std::fs::create_dir_all(&dir).map_err(|e| format!("{}: {e}", dir.display()))?;
            run_job(&job, program, &dir)?;
            contents(&dir.join(job.output), &options.old)
        });
        let [old, new] = results;
        let (old, new) = (old?, new?);
        let same = old == new;
        println!("{:<36} {:016x}  {:016x}  {}", job.name, hash(&old), hash(&new), if same { "yes" } else { "NO" });
        if !same {
            different.push(job.name);
        }
    }
    if different.is_empty() { Ok(()) } else { Err(format!("different: {}", different.join(", "))) }
}

/// All the work, on the files of a demo and the capture of a slab.
fn jobs(demo: &Path, slab: &Path, full: bool) -> Vec<Job> {
    let mut jobs = renders(demo, full);
    let mut add = |name: &str, arguments: &[&str], output| {
        let arguments =
            arguments.iter().map(|word| word.replace("DEMO", &text(demo)).replace("SLAB", &text(slab))).collect();
        jobs.push(Job { name: name.to_owned(), arguments, output });
    };
    let shots = ["hdr", "DEMO/hdr/shot1.png", "DEMO/hdr/shot2.png", "DEMO/hdr/shot3.png"];
    let shots = [&shots[..], &["--list", "DEMO/hdr/exposures.txt", "--precision", "float", "-o", "OUT/a.exr"]].concat();
    add("hdr", &shots, "a.exr");
    add("hdr, weights by variance", &[&shots[..], &["--weights", "variance"]].concat(), "a.exr");
    let compress = ["field", "compress", "DEMO/field/stack", "-o", "OUT/a.glb"];
    add("field compress", &[&compress[..], &["--terms", "8"]].concat(), "a.glb");
    add("field compress, log-pca", &[&compress[..], &["--terms", "8", "--model", "log-pca"]].concat(), "a.glb");
    add("field compress, ptm", &[&compress[..], &["--model", "ptm"]].concat(), "a.glb");
    let relight = ["field", "relight", "DEMO/field/scene.glb", "--light", "-0.5,0.35,0.8", "-o", "OUT/a.exr"];
    add("field relight", &relight, "a.exr");
    add("scatter simulate, slab", &[&SLAB[..], &["--seed", "3", "-o", "OUT/a"]].concat(), "a");
    let object = ["scatter", "simulate", "marble", "--mesh", "DEMO/scatter/object.ply", "--spacing", "4"];
    add("scatter simulate, object", &[&object[..], &["--photons", "100", "-o", "OUT/a"]].concat(), "a");
    let fit = ["scatter", "fit", "DEMO/scatter/capture", "-o", "OUT/a"];
    add("scatter fit, by vertex", &fit, "a");
    add("scatter fit, dipole", &[&fit[..], &["--model", "dipole", "--uniform"]].concat(), "a");
    if full {
        add("scatter fit, hierarchical", &[&fit[..], &["--model", "hierarchical"]].concat(), "a");
    }
    let fit = ["scatter", "fit", "SLAB", "-o", "OUT/a"];
    add("scatter fit, planar", &fit, "a");
    add("scatter fit, planar, directions", &[&fit[..], &["--segments", "4", "--terms", "2"]].concat(), "a");
    let spot = ["--lights", "DEMO/scatter/spot.json", "-o", "OUT/a.exr"];
    add("scatter relight, hierarchical", &[&["scatter", "relight", "DEMO/scatter/model"], &spot[..]].concat(), "a.exr");
    add("scatter relight, dipole", &[&["scatter", "relight", "DEMO/scatter/dipole"], &spot[..]].concat(), "a.exr");
    jobs
}

fn renders(demo: &Path, full: bool) -> Vec<Job> {
    let ours = Path::new(env!("CARGO_MANIFEST_DIR")).join("..");
    let scenes = [
        ("still life", ours.join("docs/examples/light-stage/scene.xml")),
        ("balls", ours.join("fuzz/corpus/render/balls/scene.xml")),
        ("rooms", demo.join("lights/rooms.xml")),
    ];
    let (size, spp) = if full { ("192x144", "32") } else { ("64x48", "8") };
    let job = |name: String, scene: &Path, method: &str, more: &[&str]| {
        let words = ["render", &text(scene), "--integrator", method, "--size", size, "--spp", spp, "--seed", "5"];
        let words = [&words[..], more, &["-o", "OUT/a.exr"]].concat();
        Job { name, arguments: words.into_iter().map(str::to_owned).collect(), output: "a.exr" }
    };
    let mut jobs = Vec::new();
    for (name, scene) in &scenes {
        for method in METHODS {
            jobs.push(job(format!("{method}, {name}"), scene, method, &[]));
        }
    }
    jobs.push(job("volpath, box with fog".into(), &demo.join("render/box.xml"), "volpath", &["--set", "density=1"]));
    jobs
}

fn run_job(job: &Job, program: &Path, dir: &Path) -> Result<(), String> {
    // A capture or a model of an earlier run would be refused as an output.
    let output = dir.join(job.output);
    if output.exists() {
        return Err(format!("{} is there already", output.display()));
    }
    let arguments: Vec<_> = job.arguments.iter().map(|word| word.replace("OUT", &text(dir))).collect();
    translume(program, &arguments).map_err(|why| format!("{}: {why}", job.name))
}

fn translume(program: &Path, arguments: &[String]) -> Result<(), String> {
    let run = Command::new(program).args(arguments).args(["--no-provenance", "--quiet"]).output();
    let out = run.map_err(|e| format!("cannot run {}: {e}", program.display()))?;
    if out.status.success() {
        return Ok(());
    }
    let why = String::from_utf8_lossy(&out.stderr);
    Err(format!("{} {} failed: {}", program.display(), arguments.join(" "), why.trim()))
}

/// What a file or a folder holds, without what it tells about the run.
fn contents(path: &Path, reader: &Path) -> Result<Vec<u8>, String> {
    if path.is_dir() {
        let entries = std::fs::read_dir(path).map_err(|e| format!("{}: {e}", path.display()))?;
        let mut entries: Vec<_> = entries.filter_map(Result::ok).map(|entry| entry.path()).collect();
        entries.sort();
        let mut all = Vec::new();
        for entry in entries {
            all.extend(entry.file_name().unwrap_or_default().as_encoded_bytes());
            all.push(0);
            all.extend(contents(&entry, reader)?);
        }
        return Ok(all);
    }
    let bytes = std::fs::read(path).map_err(|e| format!("{}: {e}", path.display()))?;
    match path.extension().and_then(|e| e.to_str()) {
        Some("exr") => pixels(path, reader),
        Some("json") => plain(&bytes).ok_or_else(|| format!("{} is no JSON", path.display())),
        Some("glb") => chunks(&bytes).ok_or_else(|| format!("{} is no binary glTF file", path.display())),
        _ => Ok(bytes),
    }
}

/// The samples of a picture as 32-bit floats, without the header. One program reads for both, so that a change of its reader
/// is not taken for one of the picture.
fn pixels(path: &Path, reader: &Path) -> Result<Vec<u8>, String> {
    let raw = path.with_extension("exr.pfm");
    translume(reader, &["image".into(), "convert".into(), text(path), "-o".into(), text(&raw)])?;
    let bytes = std::fs::read(&raw).map_err(|e| format!("{}: {e}", raw.display()))?;
    std::fs::remove_file(&raw).map_err(|e| format!("{}: {e}", raw.display()))?;
    Ok(bytes)
}

/// JSON without the keys of [`ABOUT_THE_RUN`].
fn plain(bytes: &[u8]) -> Option<Vec<u8>> {
    fn strip(value: &mut Value) {
        match value {
            Value::Object(map) => {
                map.retain(|key, _| !ABOUT_THE_RUN.contains(&key.as_str()));
                map.values_mut().for_each(strip);
            }
            Value::Array(list) => list.iter_mut().for_each(strip),
            _ => {}
        }
    }
    let mut value: Value = serde_json::from_slice(bytes).ok()?;
    strip(&mut value);
    serde_json::to_vec(&value).ok()
}

/// The chunks of a binary glTF file, that of JSON as [`plain`] has it.
fn chunks(bytes: &[u8]) -> Option<Vec<u8>> {
    let word = |at: usize| bytes.get(at..at + 4).map(|b| u32::from_le_bytes([b[0], b[1], b[2], b[3]]));
    let (mut at, mut all) = (12, Vec::new());
    if bytes.get(..4)? != b"glTF" {
        return None;
    }
    while at < bytes.len() {
        let (length, kind) = (word(at)? as usize, word(at + 4)?);
        let data = bytes.get(at + 8..at + 8 + length)?;
        match kind {
            0x4e4f_534a => all.extend(plain(data)?),
            _ => all.extend(data),
        }
        at += 8 + length;
    }
    Some(all)
}

/// FNV-1a, for the eye: equality is decided by the bytes.
fn hash(bytes: &[u8]) -> u64 {
    bytes.iter().fold(0xcbf2_9ce4_8422_2325, |hash, byte| (hash ^ u64::from(*byte)).wrapping_mul(0x0100_0000_01b3))
}

fn text(path: &Path) -> String {
    path.to_string_lossy().into_owned()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_tells_about_the_run_does_not_count() {
        let of = |text: &str| plain(text.as_bytes());
        assert_eq!(of(r#"{"command": "a", "x": [1, {"generator": "b"}]}"#), of(r#"{"x": [1, {}], "command": "c"}"#));
        assert_ne!(of(r#"{"x": 1.0}"#), of(r#"{"x": 1.0000001}"#));
        assert_eq!(of("{"), None);
    }

    fn glb(json: &str, data: &[u8]) -> Vec<u8> {
        let mut bytes = b"glTF\x02\0\0\0".to_vec();
        bytes.extend((28 + json.len() + data.len()).to_le_bytes()[..4].iter());
        for (kind, chunk) in [(b"JSON", json.as_bytes()), (b"BIN\0", data)] {
            bytes.extend(&chunk.len().to_le_bytes()[..4]);
            bytes.extend(kind);
            bytes.extend(chunk);
        }
        bytes
    }

    #[test]
    fn fields_are_compared_without_their_generator() {
        let one = chunks(&glb(r#"{"asset":{"generator":"translume 0.1.0"},"n":1}"#, b"abcd"));
        assert!(one.is_some());
        assert_eq!(one, chunks(&glb(r#"{"asset":{"generator":"translume 0.22.0"},"n":1}"#, b"abcd")));
        assert_ne!(one, chunks(&glb(r#"{"asset":{"generator":"translume 0.1.0"},"n":2}"#, b"abcd")));
        assert_ne!(one, chunks(&glb(r#"{"asset":{"generator":"translume 0.1.0"},"n":1}"#, b"abce")));
        assert_eq!(chunks(&glb("{}", b"abcd")[..20]), None);
        assert_eq!(chunks(b"no such file"), None);
    }

    #[test]
    fn hashes_are_those_of_the_definition() {
        assert_eq!(hash(b""), 0xcbf2_9ce4_8422_2325);
        assert_eq!(hash(b"a"), 0xaf63_dc4c_8601_ec8c);
    }

    #[test]
    fn every_method_renders_three_scenes_and_no_output_is_named_twice() {
        for full in [false, true] {
            let jobs = jobs(Path::new("demo"), Path::new("slab"), full);
            for method in METHODS {
                assert_eq!(jobs.iter().filter(|job| job.name.starts_with(&format!("{method},"))).count(), 3);
            }
            let names: std::collections::BTreeSet<_> = jobs.iter().map(|job| &job.name).collect();
            assert_eq!(names.len(), jobs.len());
            assert!(
                jobs.iter().flat_map(|job| &job.arguments).all(|word| !word.contains("DEMO") && !word.contains("SLAB"))
            );
        }
    }

    #[test]
    fn two_programs_no_more_no_less() {
        assert!(parse(&["a", "b", "--full"]).is_ok_and(|o| o.full && o.demo.is_none()));
        assert!(parse(&["a", "b", "--demo", "d"]).is_ok_and(|o| o.demo == Some("d".into())));
        for wrong in [&["a"][..], &["a", "b", "c"], &["a", "b", "--fast"], &["a", "b", "--demo"]] {
            assert!(parse(wrong).is_err(), "{wrong:?}");
        }
    }
}
