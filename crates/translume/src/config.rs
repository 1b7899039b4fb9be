//! `--config` and `--print-config`, for every verb alike: what options there are is read off the clap definition.
//!
//! A configuration file is TOML. A key is the long name of an option (dashes or underscores) or the name of a
//! positional argument; it stands at the top level or in the table of its verb, `[image.tonemap]` for a nested one, and
//! the table of the verb wins. An array gives several values, `true` sets a flag. Tables of other verbs are left alone,
//! so that one file can serve a whole chain of runs.
//!
//! The values become arguments of the command line, where the user's own take precedence; so types, limits and
//! conflicts are checked in one place. An option of the file that conflicts with one on the command line yields to it.

use crate::cli::Usage;
use crate::output;
use anyhow::{Context as _, Result};
use clap::error::ErrorKind;
use clap::parser::ValueSource;
use clap::{Arg, ArgAction, ArgMatches, Command};
use std::collections::BTreeMap;
use std::ffi::OsString;
use std::fmt::Write as _;
use std::path::Path;
use toml::{Table, Value};

/// What the arguments ask for.
pub(crate) enum Request {
    /// To run a verb.
    Run {
        /// All options, those of the configuration file among them.
        matches: ArgMatches,
        /// The arguments these came from.
        argv: Vec<OsString>,
    },
    /// To print this text and stop.
    Print(String),
}

/// Parses `argv` with the help of the configuration file that it names, if any.
///
/// # Errors
/// A [`clap::Error`] (help and version among them) or [`Usage`] for what the user can mend in the command line or the
/// file; an I/O error for a file that cannot be read.
pub(crate) fn resolve(mut command: Command, mut argv: Vec<OsString>) -> Result<Request> {
    // What is still missing may be in the file: look without judging first.
    let lenient = command.clone().ignore_errors(true);
    command.build();
    let given = lenient.clone().try_get_matches_from(&argv)?;
    let verb = Chosen::find(&command, &given);
    let file = verb.matches.get_one::<std::path::PathBuf>("config");
    if let Some(file) = file {
        let table = read(file)?;
        let values = verb.select(&table).with_context(|| file.display().to_string())?;
        verb.add_arguments(&values, &mut argv).with_context(|| file.display().to_string())?;
    }
    let strict = command.clone().try_get_matches_from(&argv);
    if verb.matches.get_flag("print_config") {
        let all = match strict {
            // A file to be filled in: the required options are among those without a value.
            Err(e) if e.kind() == ErrorKind::MissingRequiredArgument => lenient.try_get_matches_from(&argv)?,
            strict => strict?,
        };
        return Ok(Request::Print(Chosen::find(&command, &all).print()?));
    }
    match strict {
        Ok(matches) => Ok(Request::Run { matches, argv }),
        Err(e) => match file {
            // The mistake may be in the file: name it. Help is no mistake.
            Some(file) if e.use_stderr() && e.kind() != ErrorKind::DisplayHelpOnMissingArgumentOrSubcommand => {
                Err(Usage(format!("{}, with {}", output::usage_line(&e, &full_name(&verb.path)), file.display()))
                    .into())
            }
            _ => Err(e.into()),
        },
    }
}

/// The program's name and the verb that `argv` is about, as far as it says one: whose help to ask for.
pub(crate) fn verb_name(root: &Command, argv: &[OsString]) -> String {
    let (mut command, mut name) = (root, root.get_name().to_owned());
    for word in argv.iter().skip(1).take_while(|w| *w != "--") {
        if let Some(below) = command.find_subcommand(word) {
            command = below;
            name = format!("{name} {}", below.get_name());
        }
    }
    name
}

/// The arguments of `matches` that are names of files.
pub(crate) fn paths(root: &Command, matches: &ArgMatches) -> Vec<OsString> {
    let mut root = root.clone();
    root.build();
    let chosen = Chosen::find(&root, matches);
    let path = std::any::TypeId::of::<std::path::PathBuf>();
    let arguments = chosen.command().get_arguments().filter(|a| a.get_value_parser().type_id() == path);
    let values = arguments.filter_map(|a| chosen.matches.get_raw(a.get_id().as_str())).flatten();
    values.map(ToOwned::to_owned).collect()
}

fn read(path: &Path) -> Result<Table> {
    let text = std::fs::read_to_string(path).with_context(|| format!("cannot read {}", path.display()))?;
    text.parse().map_err(|e: toml::de::Error| {
        let line = e.span().map_or(1, |s| text[..s.start.min(text.len())].matches('\n').count() + 1);
        Usage(format!("{}:{line}: {}", path.display(), e.message())).into()
    })
}

/// The verb that a command line is about, the subverb if it has them.
struct Chosen<'a> {
    /// The commands from the one below the root to the one that runs.
    path: Vec<&'a Command>,
    root: &'a Command,
    matches: &'a ArgMatches,
}

impl<'a> Chosen<'a> {
    fn find(root: &'a Command, mut matches: &'a ArgMatches) -> Self {
        let mut path = Vec::new();
        let mut command = root;
        while let Some((name, below)) = matches.subcommand() {
            command = command.find_subcommand(name).expect("clap matched a command it knows");
            matches = below;
            path.push(command);
        }
        Self { path, root, matches }
    }

    fn command(&self) -> &'a Command {
        self.path.last().unwrap_or(&self.root)
    }

    /// The values that `file` holds for this verb, by the id of the argument.
    fn select<'t>(&self, file: &'t Table) -> Result<BTreeMap<&'a str, &'t Value>> {
        let mut values = BTreeMap::new();
        let mut tables = vec![(self.root, file)];
        for &command in &self.path {
            let (_, table) = tables.last().expect("starts with one");
            match table.get(command.get_name()) {
                Some(Value::Table(table)) => tables.push((command, table)),
                _ => break,
            }
        }
        for (owner, table) in tables {
            for (key, value) in table {
                if let Value::Table(inner) = value {
                    check_table(owner, key, inner)?;
                } else if let Some(arg) = find(self.command(), key) {
                    values.insert(arg.get_id().as_str(), value);
                } else {
                    let name = full_name(&self.path);
                    return Err(Usage(format!("unknown key '{key}': {name} has no such option")).into());
                }
            }
        }
        Ok(values)
    }

    /// Appends `values` to `argv`, but for what the command line gives or excludes.
    fn add_arguments(&self, values: &BTreeMap<&str, &Value>, argv: &mut Vec<OsString>) -> Result<()> {
        let command = self.command();
        let given: Vec<_> = command.get_arguments().filter(|a| is_given(self.matches, a)).collect();
        let yields = |arg: &Arg| given.iter().any(|g| g.get_id() == arg.get_id() || conflict(command, arg, g));
        let mut options = Vec::new();
        for arg in command.get_arguments().filter(|a| !a.is_positional() && !yields(a)) {
            if let Some(value) = values.get(arg.get_id().as_str()) {
                options.extend(option_arguments(arg, value)?);
            }
        }
        let mut positionals: Vec<String> = Vec::new();
        let mut skipped = None;
        for arg in command.get_positionals() {
            match values.get(arg.get_id().as_str()) {
                _ if given.contains(&arg) => {}
                None => skipped = Some(arg),
                Some(_) if yields(arg) => skipped = Some(arg),
                Some(value) => {
                    if let Some(before) = skipped {
                        return Err(Usage(format!("'{}' without '{}'", arg.get_id(), before.get_id())).into());
                    }
                    positionals.extend(occurrences(arg, value)?.into_iter().flatten());
                }
            }
        }
        // Options go before the `--` that ends them, positionals after it so that none is taken for an option.
        let end = argv.iter().position(|a| a == "--").unwrap_or(argv.len());
        if end == argv.len() && !positionals.is_empty() {
            argv.push("--".into());
        }
        argv.splice(end..end, options.into_iter().map(OsString::from));
        argv.extend(positionals.into_iter().map(OsString::from));
        Ok(())
    }

    /// All options with their effective values, as a file for `--config`.
    fn print(&self) -> Result<String> {
        let command = self.command();
        let name = full_name(&self.path);
        let (global, own): (Vec<_>, Vec<_>) =
            command.get_arguments().filter(|a| is_configurable(a)).partition(|a| a.is_global_set());
        let mut text = format!("# {name}, version {}\n", env!("CARGO_PKG_VERSION"));
        for arg in global {
            self.print_argument(&mut text, arg)?;
        }
        let table: Vec<_> = self.path.iter().map(|c| c.get_name()).collect();
        let _ = writeln!(text, "\n[{}]", table.join("."));
        for arg in own {
            self.print_argument(&mut text, arg)?;
        }
        Ok(text)
    }

    fn print_argument(&self, text: &mut String, arg: &Arg) -> Result<()> {
        let key = key(arg);
        let help = arg.get_help().map(ToString::to_string).unwrap_or_default();
        let _ = writeln!(text, "# {}", help.lines().next().unwrap_or_default());
        // A default that a given option excludes would, read back, be a contradiction.
        let default_and_excluded = arg.get_action().takes_values()
            && !is_given(self.matches, arg)
            && self.command().get_arguments().any(|a| is_given(self.matches, a) && conflict(self.command(), arg, a));
        let _ = match effective_value(self.matches, arg)? {
            Some(value) if default_and_excluded => writeln!(text, "# {key} = {value}"),
            Some(value) => writeln!(text, "{key} = {value}"),
            None => writeln!(text, "# {key}: not set"),
        };
        Ok(())
    }
}

/// Refuses a table that is not that of a verb below `owner`, and keys in it that none of its verbs knows.
fn check_table(owner: &Command, name: &str, table: &Table) -> Result<()> {
    let Some(verb) = owner.get_subcommands().find(|c| c.get_name() == name) else {
        return Err(Usage(format!("unknown key '{name}': {} has no such verb", owner.get_name())).into());
    };
    for (key, value) in table {
        match value {
            Value::Table(inner) => check_table(verb, key, inner)?,
            _ if knows(verb, key) => {}
            _ => return Err(Usage(format!("unknown key '{key}' in [{name}]")).into()),
        }
    }
    Ok(())
}

fn knows(command: &Command, key: &str) -> bool {
    find(command, key).is_some() || command.get_subcommands().any(|c| knows(c, key))
}

fn find<'a>(command: &'a Command, name: &str) -> Option<&'a Arg> {
    let name = name.replace('_', "-");
    command.get_arguments().find(|arg| is_configurable(arg) && key(arg) == name)
}

/// The name of an argument in a file: the long option, or the id of a positional.
fn key(arg: &Arg) -> String {
    arg.get_long().map_or_else(|| arg.get_id().as_str().replace('_', "-"), str::to_owned)
}

/// Not those that would make a file speak of itself, and not those that do something else than the verb.
fn is_configurable(arg: &Arg) -> bool {
    let action =
        !matches!(arg.get_action(), ArgAction::Help | ArgAction::HelpShort | ArgAction::HelpLong | ArgAction::Version);
    action && !["config", "print_config"].contains(&arg.get_id().as_str())
}

fn is_given(matches: &ArgMatches, arg: &Arg) -> bool {
    matches!(matches.value_source(arg.get_id().as_str()), Some(ValueSource::CommandLine | ValueSource::EnvVariable))
}

/// Whether two arguments exclude each other, by themselves or as members of a group for one.
fn conflict(command: &Command, a: &Arg, b: &Arg) -> bool {
    let names = |a: &Arg, b: &Arg| command.get_arg_conflicts_with(a).contains(&b);
    let in_one_group = command.get_groups().any(|group| {
        let members: Vec<_> = group.get_args().collect();
        !group.clone().is_multiple() && members.contains(&a.get_id()) && members.contains(&b.get_id())
    });
    a.get_id() != b.get_id() && (names(a, b) || names(b, a) || in_one_group)
}

/// `value` as arguments that give the option `arg`.
fn option_arguments(arg: &Arg, value: &Value) -> Result<Vec<String>> {
    let name = match (arg.get_long(), arg.get_short()) {
        (Some(long), _) => format!("--{long}"),
        (None, Some(short)) => format!("-{short}"),
        (None, None) => unreachable!("an option has a name"),
    };
    let wrong = |wanted: &str| Usage(format!("key '{}' wants {wanted}, not {value}", key(arg)));
    match arg.get_action() {
        ArgAction::SetTrue | ArgAction::SetFalse => match value {
            Value::Boolean(set) => Ok(vec![name; usize::from(*set)]),
            _ => Err(wrong("true or false").into()),
        },
        ArgAction::Count => match value {
            Value::Integer(count @ 0..=255) => Ok(vec![name; *count as usize]),
            Value::Boolean(set) => Ok(vec![name; usize::from(*set)]),
            _ => Err(wrong("a count").into()),
        },
        _ => {
            let mut arguments = Vec::new();
            for values in occurrences(arg, value)? {
                match values.as_slice() {
                    [one] => arguments.push(format!("{name}={one}")),
                    several => {
                        arguments.push(name.clone());
                        arguments.extend_from_slice(several);
                    }
                }
            }
            Ok(arguments)
        }
    }
}

/// The values of an argument, grouped as they follow its name: `--at 1 2 --at 3 4` is `[[1, 2], [3, 4]]`.
fn occurrences(arg: &Arg, value: &Value) -> Result<Vec<Vec<String>>> {
    let scalar = |value: &Value| match value {
        Value::String(s) => Ok(s.clone()),
        Value::Array(_) | Value::Table(_) => Err(Usage(format!("key '{}' is nested too deeply", key(arg)))),
        // TOML writes 1.0 where an integer option wants 1, and Rust's own text of a float is the shortest exact one.
        Value::Float(f) => Ok(f.to_string()),
        other => Ok(other.to_string()),
    };
    let list = |value: &Value| -> Result<Vec<String>, Usage> {
        let Value::Array(values) = value else { return Ok(vec![scalar(value)?]) };
        let values = values.iter().map(scalar).collect::<Result<Vec<_>, _>>()?;
        Ok(match arg.get_value_delimiter() {
            Some(delimiter) if !values.is_empty() => vec![values.join(&delimiter.to_string())],
            _ => values,
        })
    };
    let takes_several = arg.get_num_args().is_some_and(|n| n.min_values() > 1);
    let repeats = matches!(arg.get_action(), ArgAction::Append);
    let grouped: Vec<Vec<String>> = match value {
        Value::Array(rows) if rows.iter().all(Value::is_array) => rows.iter().map(list).collect::<Result<_, _>>()?,
        Value::Array(values) if repeats && !takes_several => {
            values.iter().map(|v| Ok(vec![scalar(v)?])).collect::<Result<_, Usage>>()?
        }
        other => vec![list(other)?],
    };
    // Left to clap, one value too many would become the next positional argument.
    let most = arg.get_num_args().map_or(1, |n| n.max_values());
    if grouped.iter().any(|values| values.is_empty() || values.len() > most) {
        return Err(Usage(format!("key '{}' takes {most} value(s), not {value}", key(arg))).into());
    }
    Ok(grouped)
}

/// The value of `arg` as it stands in a file, `None` where it has none.
fn effective_value(matches: &ArgMatches, arg: &Arg) -> Result<Option<Value>> {
    let id = arg.get_id().as_str();
    Ok(match arg.get_action() {
        ArgAction::SetTrue => Some(matches.get_flag(id).into()),
        // Such a flag takes something away: it is set when it was given.
        ArgAction::SetFalse => Some((!matches.get_flag(id)).into()),
        ArgAction::Count => Some(i64::from(matches.get_count(id)).into()),
        _ => {
            let Some(occurrences) = matches.get_raw_occurrences(id) else { return Ok(None) };
            let mut rows: Vec<Vec<Value>> = Vec::new();
            for values in occurrences {
                let text = |v: &std::ffi::OsStr| v.to_str().map(as_toml);
                let row: Option<Vec<_>> = values.map(text).collect();
                rows.push(
                    row.ok_or_else(|| Usage(format!("'{}' is not UTF-8 and cannot be written as TOML", key(arg))))?,
                );
            }
            let several = arg.get_num_args().is_some_and(|n| n.min_values() > 1);
            let list = matches!(arg.get_action(), ArgAction::Append) || rows.iter().any(|r| r.len() != 1);
            Some(match (list, several && rows.len() > 1) {
                (true, true) => Value::Array(rows.into_iter().map(Value::Array).collect()),
                (true, false) => Value::Array(rows.concat()),
                (false, _) => rows.concat().into_iter().next().unwrap_or_else(|| Value::Array(Vec::new())),
            })
        }
    })
}

/// A number or a truth value where its text says exactly that, else a string.
fn as_toml(text: &str) -> Value {
    if let Some(integer) = text.parse::<i64>().ok().filter(|i| i.to_string() == text) {
        return Value::Integer(integer);
    }
    if let Some(float) = text.parse::<f64>().ok().filter(|f| f.to_string() == text && text.contains('.')) {
        return Value::Float(float);
    }
    text.parse().map_or_else(|_| Value::String(text.to_owned()), Value::Boolean)
}

fn full_name(path: &[&Command]) -> String {
    std::iter::once("translume").chain(path.iter().map(|c| c.get_name())).collect::<Vec<_>>().join(" ")
}

#[cfg(test)]
mod tests {
    use super::*;
    use clap::{ArgGroup, value_parser};

    /// A nested verb with one option of every kind.
    fn command() -> Command {
        let flag = |name| Arg::new(name).long(name).action(ArgAction::SetTrue);
        let number = |name| Arg::new(name).long(name).value_parser(value_parser!(f32)).allow_negative_numbers(true);
        let tone = Command::new("tone").args([
            Arg::new("inputs").required(true).num_args(1..),
            number("gain").default_value("1"),
            flag("auto").conflicts_with("gain"),
            Arg::new("crop").long("crop").num_args(2).action(ArgAction::Append).allow_negative_numbers(true),
            Arg::new("layer_name").long("layer-name").action(ArgAction::Append),
            Arg::new("weights").long("weights").value_delimiter(',').value_parser(value_parser!(f32)),
            Arg::new("keep").long("no-keep").action(ArgAction::SetFalse),
            flag("fast"),
            flag("slow"),
            Arg::new("output").short('o').long("output").required(true),
        ]);
        let tone = tone.group(ArgGroup::new("speed").args(["fast", "slow"]));
        let globals = [
            Arg::new("config").long("config").global(true).value_parser(value_parser!(std::path::PathBuf)),
            flag("print_config").long("print-config").global(true),
            Arg::new("verbose").short('v').action(ArgAction::Count).long("verbose").global(true),
        ];
        Command::new("translume")
            .args(globals)
            .subcommand(Command::new("image").subcommand(tone).subcommand(Command::new("info").arg(flag("long"))))
    }

    fn resolve_with(file: &str, arguments: &str) -> Result<Request> {
        let path = tempfile::NamedTempFile::new().unwrap();
        std::fs::write(&path, file).unwrap();
        let argv = std::iter::once("translume").chain(arguments.split_whitespace()).map(OsString::from);
        let argv = argv.chain(["--config".into(), path.path().into()]).collect();
        resolve(command(), argv)
    }

    /// What the verb gets, as `--print-config` shows it, without the comments.
    fn effective(file: &str, arguments: &str) -> Table {
        match resolve_with(file, &format!("{arguments} --print-config")).unwrap() {
            Request::Print(text) => text.parse().unwrap_or_else(|e| panic!("{e}\n{text}")),
            Request::Run { .. } => panic!("was to print"),
        }
    }

    fn error(file: &str, arguments: &str) -> String {
        match resolve_with(file, arguments) {
            Err(e) => output::one_line(&e),
            Ok(_) => panic!("was to fail: {file}"),
        }
    }

    const FULL: &str = "verbose = 2\n[image.tone]\ninputs = ['-a b', 'c']\ngain = -0.25\ncrop = [[1, -2], [3, 4]]\n\
        layer-name = ['x', '-y']\nweights = [1, 0.5]\nno-keep = true\nfast = true\nslow = false\noutput = 'o p'\n";

    #[test]
    fn every_kind_of_option_goes_round() {
        let first = effective(FULL, "image tone");
        let mut expected: Table = FULL.parse().unwrap();
        expected["image"]["tone"].as_table_mut().unwrap().insert("auto".into(), false.into());
        assert_eq!(first, expected);
        assert_eq!(effective(&first.to_string(), "image tone"), first);
    }

    #[test]
    fn underscores_and_the_table_of_the_verb() {
        let found =
            effective("gain = 2\n[image]\ngain = 3\n[image.tone]\nlayer_name = 'z'\noutput = 'p'", "image tone i");
        assert_eq!(found["image"]["tone"]["gain"], 3.into());
        assert_eq!(found["image"]["tone"]["layer-name"], Value::Array(vec!["z".into()]));
    }

    #[test]
    fn the_command_line_wins_and_excludes() {
        let found = effective(FULL, "image tone d --auto --slow --layer-name=w -v");
        let tone = &found["image"]["tone"];
        assert_eq!(tone["inputs"], Value::Array(vec!["d".into()]));
        assert_eq!(tone["layer-name"], Value::Array(vec!["w".into()]));
        assert_eq!((&tone["auto"], &tone["slow"], &tone["fast"]), (&true.into(), &true.into(), &false.into()));
        // The default of an excluded option is not written down as if it had been asked for.
        assert_eq!(tone.get("gain"), None);
        assert_eq!(found["verbose"], 1.into());
    }

    #[test]
    fn a_verb_runs_on_what_the_file_gives() {
        let Request::Run { matches, argv } = resolve_with(FULL, "image tone").unwrap() else { panic!("was to run") };
        let (_, matches) = matches.subcommand().unwrap();
        let (_, matches) = matches.subcommand().unwrap();
        assert_eq!(matches.get_many::<String>("inputs").unwrap().collect::<Vec<_>>(), ["-a b", "c"]);
        assert_eq!(matches.get_one::<f32>("gain"), Some(&-0.25));
        assert_eq!(argv.last().unwrap(), "c");
    }

    #[test]
    fn mistakes_are_told() {
        assert!(error("", "image tone").contains("<inputs>"));
        assert!(error("[image.tone]\ngain = 'much'", "image tone i -o o").contains("much"));
        assert!(error("[image.tone]\ngain = [1, 2]", "image tone i -o o").contains("gain"));
        assert!(error("[image.tone]\ncrop = [1, 2, 3]", "image tone i -o o").contains("crop"));
        assert!(error("[image.tone]\nfast = 'yes'", "image tone i -o o").contains("fast"));
        assert!(error("[image.tone]\nlong = true", "image tone i -o o").contains("long"));
        assert!(error("[image.tune]\ngain = 1", "image tone i -o o").contains("tune"));
        assert!(error("help = true", "image tone i -o o").contains("help"));
        assert!(error("[image.tone]\nauto = true\ngain = 3", "image tone i -o o").contains("cannot be used with"));
    }

    #[test]
    fn tables_of_other_verbs_are_only_checked() {
        assert_eq!(
            effective("[image.info]\nlong = true\n[image.tone]\ngain = 4", "image tone")["image"]["tone"]["gain"],
            4.into()
        );
        assert!(error("[image.info]\nlang = true", "image tone i -o o").contains("lang"));
    }
}
