//! What a run says: results on standard output, messages and progress on standard error and in the log file.

use crate::cli::{FAILED, GlobalOptions, Usage, WRONG_USAGE};
use crate::signals;
use anyhow::Context as _;
use indicatif::{MultiProgress, ProgressBar, ProgressDrawTarget, ProgressFinish, ProgressStyle};
use std::collections::HashMap;
use std::ffi::OsString;
use std::fmt::Display;
use std::fs::File;
use std::io::{self, ErrorKind, IsTerminal, Read, Write};
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex, OnceLock, PoisonError};
use std::time::Instant;
use translume_image::atomic::{self, FileId, Place, Stream};
use translume_image::limits::RAISE_LIMIT;

/// What a verb gets besides its own arguments.
pub(crate) struct Context {
    /// One JSON object on standard output is wanted, and no text.
    pub(crate) json: bool,
    /// Neither notes nor progress are wanted.
    pub(crate) quiet: bool,
    /// How many `-v` were given.
    pub(crate) verbosity: u8,
    /// The command line, quoted for a shell, with what a configuration file added and without directories: provenance of
    /// the results. Only the program's name with `--no-provenance`.
    pub(crate) command_line: String,
    messages: Arc<Messages>,
    json_emitted: AtomicBool,
    /// The configuration file and the log file, which no output may replace.
    own_files: Vec<PathBuf>,
    /// An output goes to standard output, so that nothing else may.
    stdout_is_output: AtomicBool,
    /// A signal ended the work before all that was asked for was there.
    cut_short: AtomicBool,
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
    /// The context of a run with `options`, called with the arguments `argv`, of which `paths` are names of files.
    ///
    /// # Errors
    /// The log file cannot be opened, or is none.
    pub(crate) fn new(options: &GlobalOptions, argv: &[OsString], paths: &[OsString]) -> anyhow::Result<Self> {
        let hidden = options.quiet || !io::stderr().is_terminal();
        let messages = Arc::new(Messages {
            quiet: options.quiet,
            verbosity: options.verbose,
            bars: MultiProgress::with_draw_target(match hidden {
                true => ProgressDrawTarget::hidden(),
                false => ProgressDrawTarget::stderr(),
            }),
            log: options.log_file.as_deref().map(open_log).transpose()?.map(Mutex::new),
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
            command_line: if options.no_provenance { "translume".into() } else { quote(argv, paths) },
            messages,
            json_emitted: AtomicBool::new(false),
            own_files: [&options.config, &options.log_file].into_iter().flatten().cloned().collect(),
            stdout_is_output: AtomicBool::new(false),
            cut_short: AtomicBool::new(false),
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
        if self.stdout_is_output.load(Ordering::Relaxed) {
            self.note(text);
            return Ok(());
        }
        if self.json { Ok(()) } else { print(&format!("{text}\n")) }
    }

    /// Before the work: every one of `outputs` can be written, none of them is one of `inputs` (or within one that is a
    /// folder), and no two of them are one file.
    ///
    /// # Errors
    /// Says which.
    pub(crate) fn claim(&self, inputs: &[&Path], outputs: &[&Path]) -> anyhow::Result<()> {
        self.protect(inputs, outputs)?;
        for output in outputs {
            match atomic::place(output)? {
                Place::Stream(Stream::Stdout) if self.json => {
                    return Err(Usage(format!("{}: --json needs standard output itself", output.display())).into());
                }
                Place::Stream(Stream::Stdout) => self.stdout_is_output.store(true, Ordering::Relaxed),
                _ => atomic::check_writable(output)?,
            }
        }
        Ok(())
    }

    /// Before the work: none of `outputs`, files or folders, is one of `inputs` or within one that is a folder, and no two
    /// of them are one.
    ///
    /// # Errors
    /// Says which.
    pub(crate) fn protect(&self, inputs: &[&Path], outputs: &[&Path]) -> anyhow::Result<()> {
        let inputs: Vec<&Path> = inputs.iter().copied().chain(self.own_files.iter().map(PathBuf::as_path)).collect();
        // Each name is looked up once: a batch has thousands of both.
        let id = |path| FileId::of(path).ok_or(path);
        let read: HashMap<_, &Path> = inputs.iter().map(|i| (id(*i), *i)).collect();
        let folders: Vec<(PathBuf, &Path)> =
            inputs.iter().filter(|i| i.is_dir()).filter_map(|i| Some((i.canonicalize().ok()?, *i))).collect();
        let mut written: HashMap<_, &Path> = HashMap::new();
        for output in outputs {
            let id = id(*output);
            let input = read.get(&id).filter(|_| !atomic::is_stream(output));
            let real = || if folders.is_empty() { None } else { output.canonicalize().ok() };
            let within = || real().and_then(|o| folders.iter().find(|(f, _)| o.starts_with(f)).map(|(_, f)| f));
            if let Some(input) = input.or_else(within) {
                let which = if output == input { String::new() } else { format!(" ({})", input.display()) };
                let what = "it is also read, and would be lost; give another output";
                return Err(Usage(format!("{}{which}: {what}", output.display())).into());
            }
            if let Some(other) = written.insert(id, output) {
                let (a, b) = (other.display(), output.display());
                return Err(Usage(format!("{a} and {b} are one file, but two outputs")).into());
            }
        }
        Ok(())
    }

    /// Says that a signal ended the work before all that was asked for was there, though what there was is kept.
    pub(crate) fn cut_short(&self) {
        self.cut_short.store(true, Ordering::Relaxed);
    }

    /// Exit status of a run without an error.
    pub(crate) fn exit_status(&self) -> u8 {
        if self.cut_short.load(Ordering::Relaxed) { signals::status().unwrap_or(FAILED) } else { 0 }
    }

    /// Whether the result of `--json` is out.
    pub(crate) fn has_emitted(&self) -> bool {
        self.json_emitted.load(Ordering::Relaxed)
    }

    /// Ends a verb that wrote something, in one line of one form for all: `OUTPUT: what it is`, on standard output. Nothing
    /// with `--quiet`.
    pub(crate) fn done(&self, output: &Path, what: impl Display) -> anyhow::Result<()> {
        let line = format!("{}: {what}", output.display());
        self.log("result", &line);
        if self.quiet { Ok(()) } else { self.text(line) }
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

/// Opens a log file to append to. Anything else that is there is not a log, and stays as it is.
fn open_log(path: &Path) -> anyhow::Result<File> {
    let cannot = || format!("cannot write the log file {}", path.display());
    if std::fs::metadata(path).is_ok_and(|m| m.is_file()) {
        let mut start = [0; 64];
        let read = File::open(path).and_then(|mut f| f.read(&mut start)).with_context(cannot)?;
        let start = start[..read].trim_ascii_start();
        let time = start.iter().take_while(|b| b.is_ascii_digit() || **b == b'.').count();
        if !start.is_empty() && (time == 0 || start.get(time) != Some(&b' ')) {
            return Err(Usage(format!("{}: it exists and is no log file", path.display())).into());
        }
    }
    File::options().create(true).append(true).open(path).with_context(cannot)
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
            let message = flatten_lines(message);
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

/// Writes `text` to standard output at once.
pub(crate) fn print(text: &str) -> anyhow::Result<()> {
    let mut out = io::stdout().lock();
    out.write_all(text.as_bytes()).and_then(|()| out.flush()).context("cannot write to standard output")
}

/// Tells why the run ended, in one line on standard error (help that was asked for: on standard output) and, with `json`, in
/// an object on standard output, and returns the exit status. A reader of our output that went away, as `head` does, is no
/// failure.
pub(crate) fn report(error: &anyhow::Error, verb: &str, json: bool) -> u8 {
    let causes = || error.chain();
    if causes().any(|c| c.downcast_ref::<io::Error>().is_some_and(|e| e.kind() == ErrorKind::BrokenPipe)) {
        return 0;
    }
    let (message, status) = match error.downcast_ref::<clap::Error>() {
        Some(error) if is_help(error) => return print_help(error),
        Some(error) => (usage_line(error, verb), WRONG_USAGE),
        None if causes().any(|c| c.is::<Usage>()) => (one_line(error), WRONG_USAGE),
        None => (one_line(error), signals::status().unwrap_or(FAILED)),
    };
    complain(&message);
    if json {
        let warnings = MESSAGES.get().map(|m| m.warnings.lock().unwrap_or_else(PoisonError::into_inner).clone());
        let object =
            serde_json::json!({ "error": message, "status": status, "warnings": warnings.unwrap_or_default() });
        // The line on standard error has said it all.
        let _ = print(&format!("{object}\n"));
    }
    status
}

/// Whether clap answers with help or the version, asked for or for want of a verb.
fn is_help(error: &clap::Error) -> bool {
    !error.use_stderr() || error.kind() == clap::error::ErrorKind::DisplayHelpOnMissingArgumentOrSubcommand
}

fn print_help(error: &clap::Error) -> u8 {
    match error.print() {
        Err(e) if e.kind() != ErrorKind::BrokenPipe => FAILED,
        _ if error.use_stderr() => WRONG_USAGE,
        _ => 0,
    }
}

/// clap's description of a mistake in one line, with the verb to ask for help.
pub(crate) fn usage_line(error: &clap::Error, verb: &str) -> String {
    let rendered = error.render().to_string();
    let (message, _) = rendered.split_once("\n\nUsage: ").unwrap_or((&rendered, ""));
    let (message, _) = message.split_once("\n\nFor more information").unwrap_or((message, ""));
    // A tip is a paragraph of its own.
    let parts: Vec<_> = message.trim_start_matches("error: ").split("\n\n").map(flatten).collect();
    let message = NUMBER_WORDS.iter().fold(parts.join("; "), |text, (theirs, ours)| text.replace(theirs, ours));
    format!("{message} (see {verb} --help)")
}

/// What the standard library says of text that is no number, and what it means.
const NUMBER_WORDS: [(&str, &str); 6] = [
    ("invalid digit found in string", "a whole number is wanted, without sign or fraction"),
    ("invalid float literal", "a number is wanted"),
    ("number too large to fit in target type", "the number is too large"),
    ("number too small to fit in target type", "the number is too small"),
    ("cannot parse integer from empty string", "a whole number is wanted"),
    ("cannot parse float from empty string", "a number is wanted"),
];

fn complain(message: &str) {
    // Nobody is left to tell when standard error is closed.
    let _ = writeln!(io::stderr(), "translume: error: {message}");
}

/// An error and its causes in one line, without what a message repeats of its cause.
pub(crate) fn one_line(error: &anyhow::Error) -> String {
    let mut line = String::new();
    for cause in error.chain() {
        let cause = flatten(&cause.to_string());
        let cause = cause.replace(RAISE_LIMIT, &format!("{RAISE_LIMIT}, with --max-image-memory"));
        if line.is_empty() {
            line = cause;
        } else if !line.ends_with(&cause) {
            line = format!("{line}: {cause}");
        }
    }
    line
}

/// `text` with every run of white space, line ends included, as one space, and without what a terminal would obey: names of
/// files and words in them are not ours.
fn flatten(text: &str) -> String {
    let shown: String =
        text.chars().map(|c| if c.is_control() && !c.is_whitespace() { '\u{fffd}' } else { c }).collect();
    shown.split_whitespace().collect::<Vec<_>>().join(" ")
}

/// The same line by line.
fn flatten_lines(text: &str) -> String {
    let clean = |c: char| if c.is_control() && c != '\n' && c != '\t' { '\u{fffd}' } else { c };
    text.chars().map(clean).collect()
}

/// The arguments as a shell would take them, the program by its bare name and `paths` without their directories, which are
/// nobody's business where a result goes.
fn quote(argv: &[OsString], paths: &[OsString]) -> String {
    let plain = |c: char| c.is_alphanumeric() || "-_./=:,+@%".contains(c);
    let quoted = argv.iter().skip(1).map(|argument| {
        let argument = without_directories(&argument.to_string_lossy(), paths);
        match !argument.is_empty() && argument.chars().all(plain) {
            true => argument,
            false => format!("'{}'", argument.replace('\'', r"'\''")),
        }
    });
    std::iter::once("translume".to_owned()).chain(quoted).collect::<Vec<_>>().join(" ")
}

/// An argument, `--option=VALUE` or `-oVALUE` too, whose value is one of `paths`.
fn without_directories(argument: &str, paths: &[OsString]) -> String {
    let path = paths.iter().filter_map(|p| p.to_str()).filter(|p| !p.is_empty() && argument.ends_with(*p));
    let Some(path) = path.max_by_key(|p| p.len()) else { return argument.to_owned() };
    let name = Path::new(path).file_name().map_or(path.into(), |n| n.to_string_lossy());
    format!("{}{name}", &argument[..argument.len() - path.len()])
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
        assert_eq!(quote(&argv, &[]), r"translume man 'a b' 'it'\''s' '' --x=1.5");
    }

    #[test]
    fn provenance_names_files_without_directories() {
        let argv = ["translume", "hdr", "/home/me/a.jpg", "--list=b/c.txt", "-oout/x.exr", "--exposures", "1/60,1/15"];
        let paths = ["/home/me/a.jpg", "b/c.txt", "out/x.exr"].map(OsString::from);
        let wanted = "translume hdr a.jpg --list=c.txt -ox.exr --exposures 1/60,1/15";
        assert_eq!(quote(&argv.map(OsString::from), &paths), wanted);
    }
}
