//! The whole command line as one type, and the way from arguments to an exit status.

use crate::commands::Verb;
use crate::config::{self, Request};
use crate::output::{self, Context};
use crate::signals;
use clap::builder::RangedU64ValueParser;
use clap::{CommandFactory, FromArgMatches};
use std::ffi::OsString;
use std::path::PathBuf;

/// Exit status of a run that failed; 0 is a run that did not.
pub(crate) const FAILED: u8 = 1;
/// Exit status of a command line or configuration file that makes no sense.
pub(crate) const WRONG_USAGE: u8 = 2;

const EXAMPLES: &str = "\
Examples:
  List the verbs, then the options of one:
    translume --help
    translume completions --help

  Keep the options of a run in a file and use them again:
    translume man pages/ --print-config > run.toml
    translume man --config run.toml

Exit status: 0 fine, 1 failed, 2 wrong usage; 130 and 143 after SIGINT (Ctrl-C) and SIGTERM, which keep what there is.";

/// Measured appearance, from camera to picture.
///
/// translume turns captured light into compact, editable models and renders them. Every stage is a verb; every result
/// between two stages is a file.
#[derive(Debug, clap::Parser)]
#[command(name = "translume", version, after_long_help = EXAMPLES, max_term_width = 120)]
pub(crate) struct Cli {
    #[command(flatten)]
    pub(crate) global: GlobalOptions,
    #[command(subcommand)]
    pub(crate) verb: Verb,
}

/// Options that every verb takes.
#[derive(Debug, Clone, clap::Args)]
#[command(next_help_heading = "Global options")]
pub(crate) struct GlobalOptions {
    /// Print one JSON object on standard output instead of text
    #[arg(long, global = true)]
    pub(crate) json: bool,
    /// Say more on standard error (-vv: still more)
    #[arg(short, long, global = true, action = clap::ArgAction::Count, conflicts_with = "quiet")]
    pub(crate) verbose: u8,
    /// No progress bars and notes; warnings and errors stay
    #[arg(short, long, global = true)]
    pub(crate) quiet: bool,
    /// Number of threads [default: one per core]
    #[arg(long, global = true, value_name = "N", value_parser = RangedU64ValueParser::<usize>::new().range(1..=1024))]
    pub(crate) threads: Option<usize>,
    /// Take options from a TOML file; those on the command line win
    #[arg(long, global = true, value_name = "FILE.toml")]
    pub(crate) config: Option<PathBuf>,
    /// Print every option with its effective value, as a file for --config, and stop
    #[arg(long, global = true)]
    pub(crate) print_config: bool,
    /// Append all messages, those of -vv included, to a file
    #[arg(long, global = true, value_name = "FILE")]
    pub(crate) log_file: Option<PathBuf>,
    /// Most memory that one picture may take when decoded, such as 8G [default: 2 GiB, or 64 times its file]
    #[arg(long, global = true, value_name = "SIZE", value_parser = parse_bytes)]
    pub(crate) max_image_memory: Option<u64>,
    /// Leave the command line out of the files that are written (it names files without their directories)
    #[arg(long, global = true)]
    pub(crate) no_provenance: bool,
}

/// `500M`, `8G`, `8GiB`, or bytes.
fn parse_bytes(text: &str) -> Result<u64, String> {
    let digits = text.trim_end_matches(|c: char| c.is_ascii_alphabetic());
    let unit = match text[digits.len()..].to_ascii_lowercase().trim_end_matches("ib").trim_end_matches('b') {
        "" => 1.0,
        "k" => 1024.0,
        "m" => 1048576.0,
        "g" => 1073741824.0,
        "t" => 1099511627776.0,
        _ => f64::NAN,
    };
    let bytes = digits.trim().parse::<f64>().ok().map(|n| n * unit).filter(|b| *b >= 1.0 && *b <= 1e18);
    bytes.map(|b| b as u64).ok_or_else(|| "a size such as 500M or 8G is wanted".into())
}

/// A mistake in how the program was called that clap cannot see: reported like any error, but with exit status 2.
#[derive(Debug)]
pub(crate) struct Usage(pub(crate) String);

impl std::fmt::Display for Usage {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.write_str(&self.0)
    }
}

impl std::error::Error for Usage {}

/// Runs the program with the arguments `argv` (the first is the program's name) and returns its exit status.
pub(crate) fn run(argv: Vec<OsString>) -> u8 {
    let json = argv.iter().take_while(|a| *a != "--").any(|a| a == "--json");
    let verb = config::verb_name(&command(), &argv);
    match config::resolve(command(), argv) {
        Ok(Request::Print(text)) => {
            output::print(&text).map_or_else(|error| output::report(&error, &verb, json), |()| 0)
        }
        Ok(Request::Run { matches, argv }) => execute(&matches, &argv, &verb),
        Err(error) => output::report(&error, &verb, json),
    }
}

/// The command line as clap has it. A negative number is a value wherever one stands, so that the answer is about the number.
fn command() -> clap::Command {
    fn numbers(command: clap::Command) -> clap::Command {
        command
            .mut_args(|a| if a.get_action().takes_values() { a.allow_negative_numbers(true) } else { a })
            .mut_subcommands(numbers)
    }
    numbers(Cli::command())
}

/// Sets up what all verbs share and calls the one that was asked for.
fn execute(matches: &clap::ArgMatches, argv: &[OsString], verb_name: &str) -> u8 {
    let json = matches.get_flag("json");
    let begun = Cli::from_arg_matches(matches).map_err(anyhow::Error::from).and_then(|cli| {
        let context = Context::new(&cli.global, argv, &config::paths(&command(), matches))?;
        signals::listen()?;
        translume_image::limits::set_max_decoded_bytes(cli.global.max_image_memory);
        if let Some(threads) = cli.global.threads {
            rayon::ThreadPoolBuilder::new().num_threads(threads).build_global()?;
        }
        Ok((cli.verb, context))
    });
    let (verb, context) = match begun {
        Ok(begun) => begun,
        Err(error) => return output::report(&error, verb_name, json),
    };
    match verb.run(&context).and_then(|()| context.finish()) {
        Ok(()) => context.exit_status(),
        Err(error) => {
            context.log("error", &output::one_line(&error));
            output::report(&error, verb_name, json && !context.has_emitted())
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_command_line_is_consistent() {
        Cli::command().debug_assert();
    }

    /// Walks down to every verb that runs something.
    fn leaves(command: &clap::Command, path: &str, visit: &mut dyn FnMut(&clap::Command, &str)) {
        let path = format!("{path} {}", command.get_name());
        if !command.has_subcommands() {
            visit(command, path.trim_start());
        }
        command.get_subcommands().for_each(|below| leaves(below, &path, visit));
    }

    #[test]
    fn every_verb_says_what_it_does_and_gives_an_example() {
        let mut seen = 0;
        leaves(&Cli::command(), "", &mut |command, path| {
            seen += 1;
            let about = command.get_about().map(ToString::to_string).unwrap_or_default();
            assert!(
                !about.is_empty() && !about.ends_with('.'),
                "{path}: one line of help without a full stop: {about}"
            );
            let after = command.get_after_long_help().map(ToString::to_string).unwrap_or_default();
            assert!(after.starts_with("Examples:\n"), "{path}: its long help ends with examples");
            assert!(after.contains(path), "{path}: the examples use it");
        });
        assert!(seen >= 2);
    }

    #[test]
    fn every_option_is_explained() {
        leaves(&Cli::command(), "", &mut |command, path| {
            for arg in command.get_arguments() {
                assert!(
                    arg.get_help().is_some_and(|h| !h.to_string().is_empty()),
                    "{path}: {} has no help",
                    arg.get_id()
                );
            }
        });
    }

    /// The examples are command lines that this program accepts, with the required options and no others.
    #[test]
    fn examples_parse() {
        leaves(&Cli::command(), "", &mut |command, path| {
            let after = command.get_after_long_help().expect("tested above").to_string();
            let joined = after.replace("\\\n", " ");
            for line in joined.lines().filter_map(|l| l.trim().strip_prefix("translume ")) {
                let words = line.split_whitespace().take_while(|w| !["|", ">", "&&", "2>"].contains(w));
                let argv = std::iter::once("translume").chain(words);
                if let Err(e) = Cli::command().try_get_matches_from(argv) {
                    assert!(!e.use_stderr(), "{path}: the example `translume {line}`: {e}");
                }
            }
        });
    }
}
