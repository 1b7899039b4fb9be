//! What a run says: results on standard output, messages and progress on standard error and in the log file.

use crate::cli::{FAILED, GlobalOptions, Usage, WRONG_USAGE};
use anyhow::Context as _;
use indicatif::{MultiProgress, ProgressBar, ProgressDrawTarget, ProgressFinish, ProgressStyle};
use std::ffi::OsString;
use std::fmt::Display;
use std::fs::File;
use std::io::{self, ErrorKind, IsTerminal, Write};
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex, OnceLock, PoisonError};
use std::time::Instant;

/// What a verb gets besides its own arguments.
pub(crate) struct Context {
    /// One JSON object on standard output is wanted, and no text.
    pub(crate) json: bool,
    /// Neither notes nor progress are wanted.
    pub(crate) quiet: bool,
    /// How many `-v` were given.
    pub(crate) verbosity: u8,
    /// The command line, quoted for a shell, with what a configuration file added: provenance of the results.
    pub(crate) command_line: String,
    messages: Arc<Messages>,
    json_emitted: AtomicBool,
}

/// Where messages go: those of the verbs, and those that libraries say through the `log` crate.
struct Messages {
    quiet: bool,
    verbosity: u8,
    bars: MultiProgress,
    log: Option<Mutex<File>>,
    start: Instant,
    /// All warnings of the run, each once, for `--json`.
    warnings: Mutex<Vec<String>>,
}

static MESSAGES: OnceLock<Arc<Messages>> = OnceLock::new();

/// Libraries' words on the way to [`Messages`]: warnings are shown as the verbs' own are.
struct LibraryMessages;

impl log::Log for LibraryMessages {
    fn enabled(&self, metadata: &log::Metadata) -> bool {
        metadata.target().starts_with("translume")
    }

    fn log(&self, record: &log::Record) {
        let Some(messages) = MESSAGES.get().filter(|_| self.enabled(record.metadata())) else { return };
        let text = record.args().to_string();
        match record.level() {
            log::Level::Error | log::Level::Warn => messages.warn(&text),
            log::Level::Info => messages.say("note", !messages.quiet, &text),
            log::Level::Debug => messages.say("detail", messages.verbosity >= 1, &text),
            log::Level::Trace => messages.say("trace", messages.verbosity >= 2, &text),
        }
    }

    fn flush(&self) {}
}

#[allow(dead_code, reason = "what verbs may need, whether or not one needs it now")]
impl Context {
    /// The context of a run with `options`, called with the arguments `argv`.
    ///
    /// # Errors
    /// The log file cannot be opened.
    pub(crate) fn new(options: &GlobalOptions, argv: &[OsString]) -> anyhow::Result<Self> {
        let open = |path: &std::path::PathBuf| {
            let file = File::options().create(true).append(true).open(path);
            file.with_context(|| format!("cannot write the log file {}", path.display()))
        };
        let hidden = options.quiet || !io::stderr().is_terminal();
        let messages = Arc::new(Messages {
            quiet: options.quiet,
            verbosity: options.verbose,
            bars: MultiProgress::with_draw_target(match hidden {
                true => ProgressDrawTarget::hidden(),
                false => ProgressDrawTarget::stderr(),
            }),
            log: options.log_file.as_ref().map(open).transpose()?.map(Mutex::new),
            start: Instant::now(),
            warnings: Mutex::default(),
        });
        if MESSAGES.set(messages.clone()).is_ok() && log::set_logger(&LibraryMessages).is_ok() {
            log::set_max_level(log::LevelFilter::Trace);
        }
        let context = Self {
            json: options.json,
            quiet: options.quiet,
            verbosity: options.verbose,
            command_line: quote(argv),
            messages,
            json_emitted: AtomicBool::new(false),
        };
        context.log("start", &format!("{} ({})", context.command_line, env!("CARGO_PKG_VERSION")));
        Ok(context)
    }

    /// A progress bar of `len` steps, shown on a terminal only and gone when it is dropped.
    pub(crate) fn progress(&self, len: u64, label: &str) -> ProgressBar {
        self.detail(label);
        let style = ProgressStyle::with_template("{msg} {wide_bar} {pos}/{len} {eta}").expect("the template is sound");
        let bar = ProgressBar::new(len).with_style(style).with_message(label.to_owned());
        self.messages.bars.add(bar.with_finish(ProgressFinish::AndClear))
    }

    /// Tells how the run went: on standard error unless `--quiet`.
    pub(crate) fn note(&self, message: impl Display) {
        self.messages.say("note", !self.quiet, &message.to_string());
    }

    /// Tells what the user must know although the run goes on: on standard error, even with `--quiet`, and in the
    /// `warnings` of `--json`.
    pub(crate) fn warn(&self, message: impl Display) {
        self.messages.warn(&message.to_string());
    }

    /// Tells what one run in ten is interested in: on standard error with `-v`.
    pub(crate) fn detail(&self, message: impl Display) {
        self.messages.say("detail", self.verbosity >= 1, &message.to_string());
    }

    /// Tells what only the search for an error needs: on standard error with `-vv`.
    pub(crate) fn trace(&self, message: impl Display) {
        self.messages.say("trace", self.verbosity >= 2, &message.to_string());
    }

    /// The result as text, on standard output; nothing with `--json`. A final line end is added.
    pub(crate) fn text(&self, text: impl Display) -> anyhow::Result<()> {
        if self.json { Ok(()) } else { print(&format!("{text}\n")) }
    }

    /// The result as one JSON object, on standard output; nothing without `--json`. Called once in a run. The run's
    /// warnings are added to it.
    pub(crate) fn emit_json(&self, mut value: serde_json::Value) -> anyhow::Result<()> {
        debug_assert!(value.is_object(), "--json promises an object");
        if let Some(object) = value.as_object_mut() {
            let listed = object.entry("warnings").or_insert_with(|| serde_json::json!([]));
            if let Some(listed) = listed.as_array_mut() {
                let said = self.messages.warnings.lock().unwrap_or_else(PoisonError::into_inner);
                let new: Vec<_> = said.iter().filter(|w| !listed.iter().any(|l| l == w.as_str())).collect();
                listed.extend(new.into_iter().map(|w| serde_json::json!(w)));
            }
        }
        let earlier = self.json_emitted.swap(true, Ordering::Relaxed);
        debug_assert!(!earlier, "--json promises one object");
        if self.json { print(&format!("{value}\n")) } else { Ok(()) }
    }

    /// Ends a run that went well: `--json` gets an empty object from a verb that has nothing to tell.
    pub(crate) fn finish(&self) -> anyhow::Result<()> {
        self.log("end", "done");
        match self.json_emitted.load(Ordering::Relaxed) {
            true => Ok(()),
            false => self.emit_json(serde_json::json!({})),
        }
    }

    /// A line for the log file alone.
    pub(crate) fn log(&self, level: &str, message: &str) {
        self.messages.log(level, message);
    }
}

impl Messages {
    fn log(&self, level: &str, message: &str) {
        if let Some(log) = &self.log {
            let mut log = log.lock().unwrap_or_else(PoisonError::into_inner);
            // A full disk will show in the results; the log must not end the run.
            let _ = writeln!(log, "{:10.3} {level:7} {message}", self.start.elapsed().as_secs_f64());
        }
    }

    fn say(&self, level: &str, shown: bool, message: &str) {
        self.log(level, message);
        if shown {
            let prefix = if level == "warning" { "translume: warning: " } else { "" };
            self.bars.suspend(|| writeln!(io::stderr(), "{prefix}{message}").ok());
        }
    }

    /// A warning, once however often it comes.
    fn warn(&self, message: &str) {
        let mut warnings = self.warnings.lock().unwrap_or_else(PoisonError::into_inner);
        if warnings.iter().all(|w| w != message) {
            warnings.push(message.to_owned());
            drop(warnings);
            self.say("warning", true, message);
        }
    }
}

/// What Ctrl-C sets, for work to end early and keep what there is; a second Ctrl-C ends the program at once. Once a process.
pub(crate) fn stop_on_ctrl_c() -> anyhow::Result<Arc<AtomicBool>> {
    let stop = Arc::new(AtomicBool::new(false));
    let handler = stop.clone();
    ctrlc::set_handler(move || {
        if handler.swap(true, Ordering::Relaxed) {
            std::process::exit(130);
        }
    })
    .context("cannot listen for Ctrl-C")?;
    Ok(stop)
}

/// Writes `text` to standard output at once.
pub(crate) fn print(text: &str) -> anyhow::Result<()> {
    let mut out = io::stdout().lock();
    out.write_all(text.as_bytes()).and_then(|()| out.flush()).context("cannot write to standard output")
}

/// Tells why the run ended, in one line on standard error (help that was asked for: on standard output), and returns
/// the exit status. A reader of our output that went away, as `head` does, is no failure.
pub(crate) fn report(error: &anyhow::Error) -> u8 {
    let causes = || error.chain();
    if causes().any(|c| c.downcast_ref::<io::Error>().is_some_and(|e| e.kind() == ErrorKind::BrokenPipe)) {
        return 0;
    }
    if let Some(error) = error.downcast_ref::<clap::Error>() {
        return report_usage(error);
    }
    complain(&one_line(error));
    if causes().any(|c| c.is::<Usage>()) { WRONG_USAGE } else { FAILED }
}

/// clap's answer: help and version as they are, a mistake in one line.
fn report_usage(error: &clap::Error) -> u8 {
    use clap::error::ErrorKind::DisplayHelpOnMissingArgumentOrSubcommand;
    if !error.use_stderr() || error.kind() == DisplayHelpOnMissingArgumentOrSubcommand {
        let printed = error.print();
        return match printed {
            Err(e) if e.kind() != ErrorKind::BrokenPipe => FAILED,
            _ if error.use_stderr() => WRONG_USAGE,
            _ => 0,
        };
    }
    complain(&usage_line(error));
    WRONG_USAGE
}

/// clap's description of a mistake in one line, with the verb to ask for help.
pub(crate) fn usage_line(error: &clap::Error) -> String {
    let rendered = error.render().to_string();
    let (message, usage) = rendered.split_once("\n\nUsage: ").unwrap_or((&rendered, ""));
    let (message, _) = message.split_once("\n\nFor more information").unwrap_or((message, ""));
    let is_name = |word: &&str| word.starts_with(|c: char| c.is_ascii_lowercase());
    let verb = usage.split_whitespace().take_while(is_name).collect::<Vec<_>>().join(" ");
    let verb = if verb.is_empty() { "translume" } else { &verb };
    // A tip is a paragraph of its own.
    let parts: Vec<_> = message.trim_start_matches("error: ").split("\n\n").map(flatten).collect();
    format!("{} (see {verb} --help)", parts.join("; "))
}

fn complain(message: &str) {
    // Nobody is left to tell when standard error is closed.
    let _ = writeln!(io::stderr(), "translume: error: {message}");
}

/// An error and its causes in one line, without what a message repeats of its cause.
pub(crate) fn one_line(error: &anyhow::Error) -> String {
    let mut line = String::new();
    for cause in error.chain() {
        let cause = flatten(&cause.to_string());
        if line.is_empty() {
            line = cause;
        } else if !line.ends_with(&cause) {
            line = format!("{line}: {cause}");
        }
    }
    line
}

/// `text` with every run of white space, line ends included, as one space.
fn flatten(text: &str) -> String {
    text.split_whitespace().collect::<Vec<_>>().join(" ")
}

/// The arguments as a shell would take them, the program by its bare name.
fn quote(argv: &[OsString]) -> String {
    let plain = |c: char| c.is_alphanumeric() || "-_./=:,+@%".contains(c);
    let quoted = argv.iter().skip(1).map(|argument| {
        let argument = argument.to_string_lossy();
        match !argument.is_empty() && argument.chars().all(plain) {
            true => argument.into_owned(),
            false => format!("'{}'", argument.replace('\'', r"'\''")),
        }
    });
    std::iter::once("translume".to_owned()).chain(quoted).collect::<Vec<_>>().join(" ")
}

/// Makes a panic, which is always a bug of this program, one line that asks for a report.
pub(crate) fn install_panic_hook() {
    static TOLD: AtomicBool = AtomicBool::new(false);
    std::panic::set_hook(Box::new(|panic| {
        // Several threads may fall together: the first tells. Under the guard it is a damaged file, no bug of ours.
        if !translume_image::guard::is_active() && !TOLD.swap(true, Ordering::Relaxed) {
            let place = panic.location().map(|l| format!(" at {}:{}", l.file(), l.line())).unwrap_or_default();
            let message = flatten(panic.payload_as_str().unwrap_or("unknown"));
            complain(&format!("internal error{place}: {message}; please report it with the command line"));
        }
    }));
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn causes_are_joined_once() {
        let cause = io::Error::other("disk\nfull");
        let error = anyhow::Error::new(cause).context("a.exr: disk full").context("cannot save");
        assert_eq!(one_line(&error), "cannot save: a.exr: disk full");
    }

    #[test]
    fn arguments_are_quoted_for_a_shell() {
        let argv = ["/usr/bin/translume", "man", "a b", "it's", "", "--x=1.5"].map(OsString::from);
        assert_eq!(quote(&argv), r"translume man 'a b' 'it'\''s' '' --x=1.5");
    }
}
