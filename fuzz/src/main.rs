//! `translume-fuzz`: see the library. `cargo xtask fuzz` builds and runs it.

use std::path::{Path, PathBuf};
use std::process::ExitCode;
use std::time::Duration;
use translume_fuzz::bounds::MARK;
use translume_fuzz::drive::{self, Plan};
use translume_fuzz::input::Input;
use translume_fuzz::targets::Target;
use translume_fuzz::worker::{self, Job};
use translume_fuzz::{bounds, seeds};

const USAGE: &str = "\
Usage: cargo xtask fuzz [TARGET…] [--seconds N] [--seed S] [--jobs N]
       cargo xtask fuzz check TARGET FILE|FOLDER…   read these as the fuzzer does, and say what came
       cargo xtask fuzz seeds                       write the generated part of fuzz/corpus anew

Mutates the files of fuzz/corpus and reads them, for N seconds altogether (60 unless said). What breaks a promise is kept in
fuzz/findings. A seed gives the same inputs again.";

fn main() -> ExitCode {
    let words: Vec<String> = std::env::args().skip(1).collect();
    let words: Vec<&str> = words.iter().map(String::as_str).collect();
    let outcome = match &words[..] {
        ["worker", target, seed, round, millis, state] => work(target, [seed, round, millis], state),
        ["check", target, files @ ..] if !files.is_empty() => return check(target, files),
        ["seeds"] => seeds::write(&worker::root().join("fuzz/corpus")).map_err(|e| e.to_string()),
        ["help" | "-h" | "--help"] => {
            println!("{USAGE}");
            Ok(())
        }
        _ => match plan(&words) {
            Ok(plan) => return hunt(&plan),
            Err(why) => Err(format!("{why}\n{USAGE}")),
        },
    };
    match outcome {
        Ok(()) => ExitCode::SUCCESS,
        Err(why) => {
            eprintln!("translume-fuzz: error: {why}");
            ExitCode::from(2)
        }
    }
}

fn plan(words: &[&str]) -> Result<Plan, String> {
    let jobs = std::thread::available_parallelism().map_or(1, |n| n.get());
    let mut plan = Plan { targets: Vec::new(), seconds: 60, seed: 1, jobs };
    let mut words = words.iter();
    while let Some(word) = words.next() {
        let mut number = || words.next().and_then(|n| n.parse::<u64>().ok()).ok_or(format!("{word} wants a number"));
        match *word {
            "--seconds" => plan.seconds = number()?,
            "--seed" => plan.seed = number()?,
            "--jobs" => plan.jobs = number()? as usize,
            name if Target::named(name).is_some() => plan.targets.push(name.to_owned()),
            name => return Err(format!("no target {name:?}; there are {}", drive::names())),
        }
    }
    Ok(plan)
}

fn hunt(plan: &Plan) -> ExitCode {
    match drive::run(plan) {
        Ok(found) if found.is_empty() => {
            println!("nothing found in {} s with seed {}", plan.seconds, plan.seed);
            ExitCode::SUCCESS
        }
        Ok(found) => {
            println!("\n{} findings are in fuzz/findings:", found.len());
            found.iter().for_each(|f| println!("  {}: {}\n    {}", f.target, f.why, f.path.display()));
            ExitCode::FAILURE
        }
        Err(e) => {
            eprintln!("translume-fuzz: error: {e}");
            ExitCode::from(2)
        }
    }
}

fn work(target: &str, [seed, round, millis]: [&str; 3], state: &str) -> Result<(), String> {
    let number = |n: &str| n.parse::<u64>().map_err(|_| format!("{n:?} is no number"));
    let job = Job {
        target: Target::named(target).ok_or_else(|| format!("no target {target:?}"))?,
        seed: number(seed)?,
        round: number(round)?,
        time: Duration::from_millis(number(millis)?),
        state: PathBuf::from(state),
    };
    worker::work(&job).map_err(|e| e.to_string())
}

/// Reads inputs as a worker does; the first that breaks a promise ends it.
fn check(target: &str, files: &[&str]) -> ExitCode {
    let Some(target) = Target::named(target) else {
        eprintln!("translume-fuzz: error: no target {target:?}; there are {}", drive::names());
        return ExitCode::from(2);
    };
    bounds::watch();
    for file in files {
        let folder = tempfile::tempdir().expect("a temporary folder");
        let place = folder.path().join("current");
        let input = Input::load(Path::new(file)).expect("an input that can be read");
        input.write(&place).expect("a temporary folder");
        match worker::read(target, &place, &input) {
            Ok(said) => println!("{file}: {} {}", if said.accepted { "accepted" } else { "refused" }, said.text),
            Err(why) => {
                eprintln!("{MARK}{why}");
                return ExitCode::from(101);
            }
        }
    }
    ExitCode::SUCCESS
}
