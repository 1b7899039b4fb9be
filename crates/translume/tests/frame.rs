//! What every verb shares: exit status, error line, `--json`, `--config`, `--print-config`, completions, man pages.

mod common;

use common::translume;
use std::fs;
use tempfile::tempdir;

#[test]
fn help_and_version_are_fine_and_a_missing_verb_is_not() {
    let dir = tempdir().unwrap();
    assert!(translume(dir.path(), &["--help"]).ok().contains("Examples:"));
    assert!(translume(dir.path(), &["--version"]).ok().starts_with("translume 0."));
    let nothing = translume(dir.path(), &[]);
    assert_eq!(nothing.status, 2);
    assert!(nothing.stderr.contains("Usage:"));
}

#[test]
fn wrong_usage_is_one_line_and_status_2() {
    let dir = tempdir().unwrap();
    let error = translume(dir.path(), &["man", "--colour"]).error(2);
    assert!(error.contains("--colour") && error.contains("translume man --help"), "{error}");
    let error = translume(dir.path(), &["completions"]).error(2);
    assert!(error.contains("<SHELL>"), "{error}");
    let error = translume(dir.path(), &["completions", "cobol"]).error(2);
    assert!(error.contains("bash"), "{error}");
    let error = translume(dir.path(), &["man", "--jsno"]).error(2);
    assert!(error.contains("found; tip: a similar argument exists: '--json'"), "{error}");
    translume(dir.path(), &["man", "--threads", "0"]).error(2);
    translume(dir.path(), &["man", "--threads", "99999999"]).error(2);
    translume(dir.path(), &["man", "-q", "-v"]).error(2);
}

#[test]
fn a_failure_is_one_line_and_status_1() {
    let dir = tempdir().unwrap();
    fs::write(dir.path().join("taken"), "").unwrap();
    let error = translume(dir.path(), &["man", "taken/pages", "--json"]).error(1);
    assert!(error.contains("taken/pages"), "{error}");
    assert!(translume(dir.path(), &["man", "--log-file", "no/folder"]).error(1).contains("no/folder"));
    assert!(translume(dir.path(), &["man", "--config", "none.toml"]).error(1).contains("none.toml"));
}

#[test]
fn completions_for_the_common_shells() {
    let dir = tempdir().unwrap();
    for (shell, mark) in [("bash", "complete -F"), ("zsh", "#compdef"), ("fish", "complete -c")] {
        let script = translume(dir.path(), &["completions", shell]).ok();
        assert!(script.contains(mark) && script.contains("print-config"), "{shell}: {script}");
    }
}

#[test]
fn man_pages_for_every_verb() {
    let dir = tempdir().unwrap();
    let json = translume(dir.path(), &["man", "pages of ours", "--json"]).ok();
    let json: serde_json::Value = serde_json::from_str(&json).unwrap();
    let files = json["files"].as_array().unwrap();
    assert_eq!(files.len(), fs::read_dir(dir.path().join("pages of ours")).unwrap().count());
    for verb in ["translume", "translume-man", "translume-completions"] {
        let page = fs::read_to_string(dir.path().join("pages of ours").join(format!("{verb}.1"))).unwrap();
        assert!(page.contains(".SH NAME") && page.contains("Examples:"), "{verb}: {page}");
    }
}

#[test]
fn messages_are_quiet_or_verbose_and_all_in_the_log() {
    let dir = tempdir().unwrap();
    assert!(translume(dir.path(), &["man", "a"]).stdout.starts_with("a: "));
    let quiet = translume(dir.path(), &["-q", "man", "a", "--log-file", "run.log"]);
    assert_eq!((&quiet.stderr[..], &quiet.stdout[..]), ("", ""));
    let log = fs::read_to_string(dir.path().join("run.log")).unwrap();
    assert!(
        log.contains("a: ") && log.contains(" pages") && log.contains("translume -q man a --log-file run.log"),
        "{log}"
    );
}

#[test]
fn a_reader_that_goes_away_is_no_failure() {
    use std::process::{Command, Stdio};
    let mut child = Command::new(env!("CARGO_BIN_EXE_translume"))
        .args(["completions", "bash"])
        .stdout(Stdio::piped())
        .stderr(Stdio::piped())
        .spawn()
        .unwrap();
    drop(child.stdout.take());
    let out = child.wait_with_output().unwrap();
    assert_eq!((out.status.code(), out.stderr.as_slice()), (Some(0), [].as_slice()));
}

#[test]
fn options_come_from_the_file_and_the_command_line_wins() {
    let dir = tempdir().unwrap();
    fs::write(dir.path().join("run.toml"), "quiet = true\nlog-file = 'from file.log'\n[man]\ndir = 'from-file'\n")
        .unwrap();
    assert_eq!(translume(dir.path(), &["man", "--config", "run.toml"]).stderr, "");
    assert!(dir.path().join("from-file/translume.1").exists());
    let log = fs::read_to_string(dir.path().join("from file.log")).unwrap();
    assert!(log.contains("--quiet '--log-file=from file.log' -- from-file"), "{log}");

    // --quiet of the file yields to -v, its folder to the one given.
    let loud = translume(dir.path(), &["man", "--config", "run.toml", "-v", "--log_file=x", "given"]);
    assert_eq!(loud.status, 2, "options have dashes on the command line");
    let loud = translume(dir.path(), &["man", "--config", "run.toml", "-v", "given"]);
    assert!(loud.stdout.starts_with("given: "), "{}", loud.stdout);
}

#[test]
fn a_mistake_in_the_file_is_named() {
    let dir = tempdir().unwrap();
    for (text, mark) in [
        ("colour = 1", "colour"),
        ("[man]\ncolour = 1", "colour"),
        ("[paint]\ncolour = 1", "paint"),
        ("[completions]\nshel = 'bash'", "shel"),
        ("config = 'other.toml'", "config"),
        ("quiet = 3", "quiet"),
        ("threads = 'many'", "many"),
        ("threads = [1, 2]", "threads"),
        ("threads = [[[1]]]", "threads"),
        ("[man]\ndir = ['a', 'b']", "dir"),
        ("quiet = true\nquiet", "run.toml:2"),
    ] {
        fs::write(dir.path().join("run.toml"), text).unwrap();
        let error = translume(dir.path(), &["man", "--config", "run.toml"]).error(2);
        assert!(error.contains(mark) && error.contains("run.toml"), "{text}: {error}");
    }
}

#[test]
fn a_printed_configuration_gives_the_same_run() {
    let dir = tempdir().unwrap();
    let given = ["man", "a \"folder\"", "-q", "--threads", "2", "--print-config"];
    let printed = translume(dir.path(), &given).ok();
    assert!(!dir.path().join("a \"folder\"").exists(), "printing does not run");
    fs::write(dir.path().join("run.toml"), &printed).unwrap();
    let again = translume(dir.path(), &["man", "--config", "run.toml", "--print-config"]).ok();
    assert_eq!(printed, again);
    let run = translume(dir.path(), &["man", "--config", "run.toml"]);
    assert_eq!(run.stderr, "");
    run.ok();
    assert!(dir.path().join("a \"folder\"/translume.1").exists());
}

#[test]
fn a_configuration_can_be_printed_before_the_inputs_are_known() {
    let dir = tempdir().unwrap();
    let printed = translume(dir.path(), &["completions", "--print-config"]).ok();
    assert!(printed.contains("[completions]") && printed.contains("# shell: not set"), "{printed}");
}

#[test]
fn a_wrong_number_gets_an_answer_about_the_number() {
    let dir = tempdir().unwrap();
    let render = |more: &[&str]| translume(dir.path(), &[&["render", "s.xml", "-o", "o.exr"], more].concat()).error(2);
    for (value, answer) in
        [("-5", "without sign"), ("1.5", "a whole number is wanted"), ("99999999999999999999", "too large")]
    {
        let error = render(&["--spp", value]);
        assert!(error.contains("--spp") && error.contains(answer), "{error}");
        assert!(error.ends_with("(see translume render --help)"), "{error}");
    }
    let error = translume(dir.path(), &["image", "convert", "a.exr", "-o", "b.exr", "--ev", "two"]).error(2);
    assert!(error.contains("a number is wanted") && error.ends_with("(see translume image convert --help)"), "{error}");
}

#[test]
fn failures_are_objects_with_json() {
    let dir = tempdir().unwrap();
    for (args, status) in
        [(&["image", "info", "gone.exr", "--json"][..], 1), (&["image", "info", "--nonsense", "--json"], 2)]
    {
        let run = translume(dir.path(), args);
        assert_eq!(run.status, status);
        let object: serde_json::Value = serde_json::from_str(&run.stdout).unwrap();
        assert_eq!(object["status"], status);
        assert!(run.stderr.contains(object["error"].as_str().unwrap()), "{object}");
        assert!(object["warnings"].as_array().unwrap().is_empty());
    }
}

#[test]
fn names_do_not_reach_the_terminal_raw() {
    let dir = tempdir().unwrap();
    let error = translume(dir.path(), &["image", "info", "\u{1b}[31mred.exr"]).error(1);
    assert!(!error.contains('\u{1b}') && error.contains("[31mred.exr"), "{error:?}");
}

#[test]
fn the_memory_of_a_picture_can_be_limited() {
    let dir = tempdir().unwrap();
    image::RgbImage::new(64, 64).save(dir.path().join("a.png")).unwrap();
    let info = |limit: &str| translume(dir.path(), &["image", "info", "a.png", "--max-image-memory", limit]);
    info("48k").ok();
    let error = info("47.9KiB").error(1);
    assert!(error.contains("a.png") && error.contains("--max-image-memory"), "{error}");
    for wrong in ["much", "-5", "0", "3x"] {
        assert!(info(wrong).error(2).contains("a size such as"), "{wrong}");
    }
}
