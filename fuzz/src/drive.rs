//! The parent: a worker for each target, again and again until the time is up; what ended one is kept and made smaller.

use crate::bounds::MARK;
use crate::input::Input;
use crate::minimise::minimise;
use crate::targets::{TARGETS, Target};
use crate::worker::{Count, root};
use std::collections::HashMap;
use std::io::{Error, Result};
use std::path::{Path, PathBuf};
use std::process::{Command, ExitStatus, Stdio};
use std::sync::Mutex;
use std::time::{Duration, Instant};

/// Findings of one cause that are kept.
const MOST_ALIKE: usize = 3;

/// What to run.
#[derive(Clone, Debug)]
pub struct Plan {
    /// Which; all when there are none.
    pub targets: Vec<String>,
    /// Seconds altogether.
    pub seconds: u64,
    /// Of the random numbers.
    pub seed: u64,
    /// Targets at a time.
    pub jobs: usize,
}

/// An input that broke a promise.
#[derive(Clone, Debug)]
pub struct Finding {
    /// The target's name.
    pub target: &'static str,
    /// Which promise, and where.
    pub why: String,
    /// The input.
    pub path: PathBuf,
}

/// Runs the plan and prints a line for each target; the findings.
///
/// # Errors
/// Of files and processes; an unknown target.
pub fn run(plan: &Plan) -> Result<Vec<Finding>> {
    let chosen: Vec<&'static Target> = match plan.targets.is_empty() {
        true => TARGETS.iter().collect(),
        false => {
            let named = |n: &String| {
                Target::named(n).ok_or_else(|| Error::other(format!("no target {n:?}; there are {}", names())))
            };
            plan.targets.iter().map(named).collect::<Result<_>>()?
        }
    };
    let jobs = plan.jobs.clamp(1, chosen.len());
    let time = Duration::from_secs_f64(plan.seconds as f64 * jobs as f64 / chosen.len() as f64);
    let (todo, findings) = (Mutex::new(chosen.into_iter()), Mutex::new(Vec::new()));
    let next = || todo.lock().unwrap_or_else(std::sync::PoisonError::into_inner).next();
    std::thread::scope(|scope| {
        let one = || -> Result<()> {
            while let Some(target) = next() {
                let found = hunt(target, plan.seed, time)?;
                findings.lock().unwrap_or_else(std::sync::PoisonError::into_inner).extend(found);
            }
            Ok(())
        };
        let threads: Vec<_> = (0..jobs).map(|_| scope.spawn(one)).collect();
        threads.into_iter().try_for_each(|t| t.join().unwrap_or_else(|_| Err(Error::other("the driver failed"))))
    })?;
    Ok(findings.into_inner().unwrap_or_default())
}

/// The targets' names.
pub fn names() -> String {
    TARGETS.map(|t| t.name).join(", ")
}

fn hunt(target: &'static Target, seed: u64, time: Duration) -> Result<Vec<Finding>> {
    // In memory where the system offers that: every input is written.
    let memory = Path::new("/dev/shm");
    let state = if memory.is_dir() { tempfile::tempdir_in(memory)? } else { tempfile::tempdir()? };
    let end = Instant::now() + time;
    let (mut findings, mut alike, mut round) = (Vec::new(), HashMap::<String, usize>::new(), 0u64);
    loop {
        let left = end.saturating_duration_since(Instant::now());
        if left.is_zero() {
            break;
        }
        let Some(why) = worker(target, seed, round, left, state.path())? else { break };
        round += 1;
        let input = Input::load(&state.path().join("current"))?;
        let times = alike.entry(cause(&why)).or_insert(0);
        *times += 1;
        if *times <= MOST_ALIKE {
            let input = minimise(target, input, &why, end.max(Instant::now() + Duration::from_secs(5)));
            let name = format!("{}-{:08x}", why.split([':', ' ']).next().unwrap_or("bad"), input.hash() as u32);
            let path = input.save(&root().join("fuzz/findings").join(target.name), &name)?;
            println!("{}: {why}\n    {}", target.name, path.display());
            findings.push(Finding { target: target.name, why, path });
        }
        // A cause that everything meets would do nothing but start workers.
        if *times > 200 {
            break;
        }
    }
    let Count { runs, accepted, kinds } = Count::load(state.path());
    let rate = runs as f64 / time.as_secs_f64().max(1e-3);
    let found: usize = alike.values().sum();
    println!(
        "{:<12}{runs:>9} inputs ({rate:.0}/s), {:.0} % accepted, {kinds} different answers, {found} findings of {} causes",
        target.name,
        100.0 * accepted as f64 / runs.max(1) as f64,
        alike.len()
    );
    Ok(findings)
}

/// Runs one worker; why it ended before its time.
fn worker(target: &Target, seed: u64, round: u64, time: Duration, state: &Path) -> Result<Option<String>> {
    let told = state.join("stderr");
    let status = own()?
        .args(["worker", target.name, &seed.to_string(), &round.to_string(), &time.as_millis().to_string()])
        .arg(state)
        .stdin(Stdio::null())
        .stderr(std::fs::File::create(&told)?)
        .status()?;
    reason(status, &std::fs::read_to_string(&told).unwrap_or_default())
}

/// This program again.
pub(crate) fn own() -> Result<Command> {
    let mut command = Command::new(std::env::current_exe()?);
    // The same for all machines, and two targets at a time have a core each.
    command.env("RAYON_NUM_THREADS", "2");
    Ok(command)
}

/// Why a worker ended: `None` if its time was up.
///
/// # Errors
/// What it said when it could not work at all.
pub(crate) fn reason(status: ExitStatus, told: &str) -> Result<Option<String>> {
    if status.success() {
        return Ok(None);
    }
    if let Some(line) = told.lines().rev().find_map(|l| l.strip_prefix(MARK)) {
        return Ok(Some(line.to_owned()));
    }
    if told.contains("has overflowed its stack") {
        return Ok(Some("stack: it overflows".into()));
    }
    if status.code() == Some(2) {
        return Err(Error::other(told.trim().to_owned()));
    }
    Ok(Some(format!("abort: {status}: {}", told.lines().last().unwrap_or_default())))
}

/// What findings with one cause have in common: the place of a panic and its words without numbers.
pub(crate) fn cause(why: &str) -> String {
    match why.strip_prefix("panic at ") {
        Some(place) => {
            let at = place.find(": ").unwrap_or(place.len());
            let words = place[at..].chars().filter(|c| !c.is_ascii_digit()).take(60);
            place[..at].chars().chain(words).collect()
        }
        None => why.split(':').next().unwrap_or_default().to_owned(),
    }
}
