//! The process that reads mutated inputs until its time is up, or until one ends it.

use crate::bounds::{self, MARK};
use crate::input::Input;
use crate::mutate::{self, below};
use crate::targets::{Said, Target};
use std::collections::HashSet;
use std::io::{Error, Result};
use std::path::{Path, PathBuf};
use std::time::{Duration, Instant};
use translume_core::rng::Pcg32;

/// Most inputs that are kept because they brought something new.
const MOST_NEW: usize = 400;

/// What a worker is told.
#[derive(Clone, Debug)]
pub struct Job {
    /// The reader.
    pub target: &'static Target,
    /// Of the random numbers.
    pub seed: u64,
    /// How many workers of this target and seed went before.
    pub round: u64,
    /// Until when.
    pub time: Duration,
    /// Where the input at hand and those that brought something new are.
    pub state: PathBuf,
}

/// How far a worker came.
#[derive(Clone, Copy, Debug, Default)]
pub struct Count {
    /// Inputs that were read.
    pub runs: u64,
    /// Of those, accepted.
    pub accepted: u64,
    /// Different answers.
    pub kinds: u64,
}

impl Count {
    /// From what `Count::save` wrote; nothing is zero.
    pub fn load(state: &Path) -> Self {
        let text = std::fs::read_to_string(state.join("count")).unwrap_or_default();
        let mut numbers = text.split(' ').map(|n| n.parse().unwrap_or(0));
        let mut next = || numbers.next().unwrap_or(0);
        Self { runs: next(), accepted: next(), kinds: next() }
    }

    fn save(&self, state: &Path) -> Result<()> {
        std::fs::write(state.join("count"), format!("{} {} {}", self.runs, self.accepted, self.kinds))
    }
}

/// The project's root.
pub fn root() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).parent().unwrap_or(Path::new(".")).to_owned()
}

/// The inputs in a folder, in the order of their names; none where there is no folder.
///
/// # Errors
/// Of reading.
pub fn inputs(folder: &Path) -> Result<Vec<(PathBuf, Input)>> {
    let Ok(entries) = std::fs::read_dir(folder) else { return Ok(Vec::new()) };
    let mut paths: Vec<PathBuf> = entries.map(|e| e.map(|e| e.path())).collect::<Result<_>>()?;
    paths.sort();
    paths.into_iter().map(|p| Input::load(&p).map(|i| (p, i))).collect()
}

/// The committed inputs of a target: its own, and files of other crates' tests.
///
/// # Errors
/// Of reading.
pub fn corpus(target: &Target) -> Result<Vec<(PathBuf, Input)>> {
    let mut all = inputs(&root().join("fuzz/corpus").join(target.name))?;
    for folder in target.seeds {
        let files = inputs(&root().join(folder))?.into_iter();
        all.extend(files.filter(|(path, _)| {
            let ending = path.extension().and_then(|e| e.to_str());
            folder.starts_with("fuzz/") || path.is_file() && !matches!(ending, Some("py" | "md" | "txt") | None)
        }));
    }
    Ok(all)
}

/// Reads an input that lies in `folder`, within all bounds.
///
/// # Errors
/// The panic's place and message.
pub fn read(target: &Target, folder: &Path, input: &Input) -> std::result::Result<Said, String> {
    bounds::hold(target.memory(input), || (target.run)(folder, input))
}

/// The worker's work. It ends the process with a line that begins with [`MARK`] when an input breaks a promise.
///
/// # Errors
/// Of files.
pub fn work(job: &Job) -> Result<()> {
    let end = Instant::now() + job.time;
    let (current, new) = (job.state.join("current"), job.state.join("new"));
    std::fs::create_dir_all(&new)?;
    let mut pool: Vec<Input> = corpus(job.target)?.into_iter().map(|c| c.1).collect();
    let committed = pool.len();
    pool.extend(inputs(&new)?.into_iter().map(|c| c.1));
    if pool.is_empty() {
        return Err(Error::other(format!("fuzz/corpus/{} is empty", job.target.name)));
    }
    let stream = job.target.name.bytes().fold(0, |h, b| h * 31 + u64::from(b)) ^ job.round << 32;
    let mut rng = Pcg32::new(job.seed, stream);
    let (mut kinds, mut count) = (HashSet::new(), Count::load(&job.state));
    let mut last = Input::default();
    let mut first = pool.clone().into_iter();
    while Instant::now() < end {
        // The seeds themselves, then what is made of them.
        let seed = first.next();
        let mutated = seed.is_none();
        let input = seed.unwrap_or_else(|| {
            // Half of the time of those that are committed, which later ones would drown.
            let among = if below(2, &mut rng) == 0 { committed.max(1) } else { pool.len() };
            let mut input = pool[below(among.min(pool.len()), &mut rng)].clone();
            let other = below(pool.len(), &mut rng);
            mutate::input(&mut input, &pool[other], &mut rng);
            input
        });
        input.replace(&last, &current)?;
        let said = read(job.target, &current, &input).unwrap_or_else(|why| {
            eprintln!("{MARK}{why}");
            let _ = count.save(&job.state);
            std::process::exit(101)
        });
        count.runs += 1;
        count.accepted += u64::from(said.accepted);
        if kinds.insert(said.kind(&current)) {
            count.kinds = count.kinds.max(kinds.len() as u64);
            if mutated && pool.len() < committed + MOST_NEW {
                input.write(&new.join(format!("{:05}", pool.len() - committed)))?;
                pool.push(input.clone());
            }
        }
        if count.runs.is_multiple_of(64) {
            count.save(&job.state)?;
        }
        last = input;
    }
    count.save(&job.state)
}
