//! The whole corpus, with what was found before, is read within the fuzzer's bounds.

use std::process::Command;
use translume_fuzz::input::Input;
use translume_fuzz::targets::{TARGETS, Target};
use translume_fuzz::worker::{corpus, read};

#[test]
fn the_corpus_is_read_within_bounds() {
    let folder = tempfile::tempdir().unwrap();
    let current = folder.path().join("current");
    for target in &TARGETS {
        let seeds = corpus(target).unwrap();
        assert!(!seeds.is_empty(), "fuzz/corpus/{} has files", target.name);
        let mut accepted = 0;
        for (path, input) in seeds {
            // A bound of time or memory ends the process: what it was reading stands before.
            println!("{}", path.display());
            input.write(&current).unwrap();
            let said = read(target, &current, &input).unwrap_or_else(|why| panic!("{}: {why}", path.display()));
            accepted += usize::from(said.accepted);
        }
        assert!(accepted > 0 || target.name == "program", "{}: none of the seeds is sound", target.name);
    }
}

#[test]
fn every_kind_of_fault_is_noticed() {
    let folder = tempfile::tempdir().unwrap();
    let said = |asked: &str| {
        let path = folder.path().join("asked.txt");
        std::fs::write(&path, asked).unwrap();
        let out = Command::new(env!("CARGO_BIN_EXE_translume-fuzz")).args(["check", "self-test"]).arg(path).output();
        let out = out.unwrap();
        (out.status.success(), String::from_utf8_lossy(&out.stderr).into_owned())
    };
    for (asked, expected) in [
        ("panic", "fuzz: panic at "),
        ("other thread", "fuzz: panic at "),
        ("memory", "fuzz: memory: "),
        ("stack", "overflowed its stack"),
        ("time", "fuzz: time: "),
    ] {
        let (fine, text) = said(asked);
        assert!(!fine && text.contains(expected), "{asked}: {text}");
    }
    assert!(said("nothing").0);
}

#[test]
fn a_seed_gives_the_same_inputs() {
    let target = Target::named("mesh").unwrap();
    let pool: Vec<Input> = corpus(target).unwrap().into_iter().map(|c| c.1).collect();
    let mutants = |seed| {
        let mut rng = translume_core::rng::Pcg32::new(seed, 0);
        let mut inputs = pool.clone();
        inputs.iter_mut().for_each(|input| translume_fuzz::mutate::input(input, &pool[0], &mut rng));
        inputs
    };
    assert!(mutants(1) == mutants(1) && mutants(1) != mutants(2) && mutants(1) != pool);
}
