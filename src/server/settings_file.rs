//! The settings as a file: printing it with the defaults, and reading it. Both follow the arguments of [`Config`].

use std::any::TypeId;
use std::error::Error as _;
use std::path::{Path, PathBuf};

use clap::builder::Resettable;
use clap::error::{ContextKind, ContextValue};
use clap::{Arg, Args as _, Command};
use thiserror::Error;
use toml::Value;

use super::settings::Config;

const HEAD: &str = "\
# Settings of `posed serve`. Each is also a flag (`--queue 32`) and an environment variable (`POSED_QUEUE=32`).
# Flags take precedence over the environment, the environment over this file. The values below are the defaults.
";

/// A settings file that cannot be used.
#[derive(Debug, Error)]
pub enum SettingsFileError {
    #[error("cannot read {}: {source}", path.display())]
    Read { path: PathBuf, source: std::io::Error },
    #[error("{}: {source}", path.display())]
    Syntax { path: PathBuf, source: Box<toml::de::Error> },
    #[error("{}: unknown setting '{setting}'{hint}", path.display())]
    Unknown { path: PathBuf, setting: String, hint: String },
    #[error("{}: setting '{setting}' is {value}: {reason}", path.display())]
    Value { path: PathBuf, setting: String, value: Value, reason: String },
}

/// The settings of a file, with valid values.
#[derive(Debug)]
pub struct SettingsFile(Vec<(String, String)>);

impl SettingsFile {
    /// # Errors
    /// When the file cannot be read, or has an unknown setting or an invalid value. The error names it.
    pub fn read(path: &Path) -> Result<Self, SettingsFileError> {
        let text =
            std::fs::read_to_string(path).map_err(|source| SettingsFileError::Read { path: path.into(), source })?;
        let table: toml::Table =
            text.parse().map_err(|source| SettingsFileError::Syntax { path: path.into(), source: Box::new(source) })?;
        let command = settings();
        let read = |(setting, value): (String, Value)| {
            let Some(argument) = command.get_arguments().find(|argument| argument.get_id() == setting.as_str()) else {
                let hint =
                    similar(&command, &setting).map(|name| format!("; did you mean '{name}'?")).unwrap_or_default();
                return Err(SettingsFileError::Unknown { path: path.into(), setting, hint });
            };
            match parse(argument, &value) {
                Ok(text) => Ok((setting, text)),
                Err(reason) => Err(SettingsFileError::Value { path: path.into(), setting, value, reason }),
            }
        };
        table.into_iter().map(read).collect::<Result<_, _>>().map(Self)
    }

    /// The command with this file in place of its defaults. Flags and environment take precedence.
    #[must_use]
    pub fn in_place_of_defaults(self, command: Command) -> Command {
        let Self(values) = self;
        values.into_iter().fold(command, |command, (setting, value)| {
            command.mut_arg(setting, |argument| argument.default_value(value))
        })
    }
}

/// The settings file with the defaults and comments.
#[must_use]
pub fn default_settings() -> String {
    let mut lines = vec![HEAD.to_owned()];
    let mut section = None;
    for argument in settings().get_arguments() {
        let heading = argument.get_help_heading().map(str::to_owned);
        if section != heading {
            lines.extend(heading.iter().map(|heading| format!("\n# --- {heading} ---\n\n")));
            section = heading;
        }
        lines.extend(argument.get_help().map(|help| format!("# {help}.\n")));
        lines.extend(choices(argument).map(|choices| format!("# One of {choices}.\n")));
        lines.push(line(argument));
    }
    lines.concat()
}

/// A setting with its default, or commented out if it has none.
fn line(argument: &Arg) -> String {
    let name = argument.get_id();
    let default = argument.get_default_values().first().map(|default| default.to_string_lossy().into_owned());
    match (default, is_text(argument)) {
        (Some(default), true) => format!("{name} = {}\n", Value::String(default)),
        (Some(default), false) => format!("{name} = {default}\n"),
        (None, true) => format!("# {name} = \"...\"\n"),
        (None, false) => format!("# {name} = ...\n"),
    }
}

/// Whether a setting is a string in the file. Numbers and booleans are not.
fn is_text(argument: &Arg) -> bool {
    let read = argument.get_value_parser().type_id();
    ![TypeId::of::<bool>(), TypeId::of::<usize>(), TypeId::of::<u32>(), TypeId::of::<u64>()]
        .iter()
        .any(|bare| read == *bare)
}

/// What is wrong with the names of these environment variables. Kubernetes sets some of its own for a service that is
/// called `posed`, so that none of them is an error.
pub fn unknown_variables(names: impl Iterator<Item = String>) -> Vec<String> {
    let with_variables = Config::augment_args(Command::new("posed"));
    let known = |name: &str| {
        name == "POSED_CONFIG" || with_variables.get_arguments().any(|one| one.get_env().is_some_and(|env| env == name))
    };
    let command = settings();
    let strange = |name: &String| {
        let of_kubernetes = name.starts_with("POSED_PORT") || name.starts_with("POSED_SERVICE_");
        name.starts_with("POSED_") && !of_kubernetes && !known(name)
    };
    let in_words = |name: String| {
        let setting = name.trim_start_matches("POSED_").to_lowercase();
        let hint = similar(&command, &setting).map(|near| format!("; did you mean POSED_{}?", near.to_uppercase()));
        format!("the environment variable {name} is no setting, and does nothing{}", hint.unwrap_or_default())
    };
    names.filter(strange).map(in_words).collect()
}

/// The settings, without the environment.
fn settings() -> Command {
    let command = Command::new("posed.toml").no_binary_name(true).disable_help_flag(true);
    Config::augment_args(command).mut_args(|argument| argument.env(Resettable::Reset))
}

/// Converts a value of the file to the text of its flag.
fn parse(argument: &Arg, value: &Value) -> Result<String, String> {
    let text = match (is_text(argument), value.as_str()) {
        (true, Some(text)) => text.to_owned(),
        (true, None) => return Err("it must be a string in quotes".to_owned()),
        // A string keeps its quotes here, and so is neither a number nor a boolean.
        (false, _) => value.to_string(),
    };
    let flag = format!("--{}={text}", argument.get_long().unwrap_or_default());
    let command = Command::new("posed.toml").no_binary_name(true).arg(argument);
    let Err(error) = command.try_get_matches_from([flag]) else { return Ok(text) };
    Err(match (choices(argument), error.source()) {
        (Some(choices), _) => format!("it must be one of {choices}"),
        (None, Some(source)) => source.to_string(),
        (None, None) => "it must not be empty".to_owned(),
    })
}

/// The possible values of a setting, if they can be listed.
fn choices(argument: &Arg) -> Option<String> {
    let values = argument.get_possible_values();
    let names: Vec<&str> = values.iter().map(clap::builder::PossibleValue::get_name).collect();
    (!names.is_empty()).then(|| names.join(", "))
}

/// A known setting with a similar name.
fn similar(command: &Command, setting: &str) -> Option<String> {
    let flag = format!("--{}", setting.replace('_', "-"));
    let error = command.clone().try_get_matches_from([flag]).err()?;
    let Some(ContextValue::String(flag)) = error.get(ContextKind::SuggestedArg) else { return None };
    Some(flag.trim_start_matches('-').replace('-', "_"))
}

#[cfg(test)]
mod tests {
    use clap::FromArgMatches as _;

    use super::*;

    fn read(text: &str) -> Result<SettingsFile, SettingsFileError> {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("posed.toml");
        std::fs::write(&path, text).unwrap();
        SettingsFile::read(&path)
    }

    fn config(file: &str, flags: &[&str]) -> Config {
        let command = read(file).unwrap().in_place_of_defaults(settings());
        Config::from_arg_matches(&command.get_matches_from(flags)).unwrap()
    }

    #[test]
    fn flags_win_over_the_file_and_the_file_over_the_defaults() {
        let file =
            "queue = 5\nworkers = 2\nrecalibration = true\nhttp = \"[::1]:80\"\nthreads = 3\nprovider = \"cuda\"\n";
        let config = config(file, &["--queue", "7"]);
        assert_eq!((config.queue, config.workers, config.max_batch, config.threads), (7, Some(2), 2, Some(3)));
        assert_eq!((config.http.port(), config.grpc.port(), config.recalibration), (80, 9000, true));
        assert_eq!(config.provider, crate::model::ProviderSetting::Cuda);
    }

    #[test]
    fn the_printed_file_means_the_defaults() {
        let printed = default_settings();
        assert_eq!(format!("{:?}", config(&printed, &[])), format!("{:?}", config("", &[])));
        let table: toml::Table = printed.parse().unwrap();
        for argument in settings().get_arguments() {
            let (name, default) = (argument.get_id().as_str(), argument.get_default_values().first());
            assert_eq!(table.contains_key(name), default.is_some(), "{name}");
            assert!(printed.contains(&format!("{name} = ")), "{name}");
            let bare = default.is_some_and(|default| default.to_str().unwrap().parse::<u64>().is_ok());
            assert!(!bare || table[name].is_integer(), "{name} is a number and stands in quotes");
        }
        assert!(table["recalibration"].is_bool());
    }

    #[test]
    fn unknown_variables_are_named_and_those_of_others_are_not() {
        let names =
            ["POSED_PROVIDR", "POSED_MAX_BATCH", "POSED_CONFIG", "POSED_PORT_8080_TCP", "POSED_SERVICE_HOST", "PATH"];
        let told = unknown_variables(names.into_iter().map(str::to_owned));
        let said =
            "the environment variable POSED_PROVIDR is no setting, and does nothing; did you mean POSED_PROVIDER?";
        assert_eq!(told, [said]);
    }

    #[test]
    fn what_is_wrong_in_a_file_is_named() {
        for (text, words) in [
            ("quue = 5", "unknown setting 'quue'; did you mean 'queue'?"),
            ("max_pixel = 5", "unknown setting 'max_pixel'; did you mean 'max_pixels'?"),
            ("max-batch = 5", "unknown setting 'max-batch'"),
            ("help = true", "unknown setting 'help'"),
            ("zebra = 5", "unknown setting 'zebra'"),
            ("[limits]\nqueue = 5", "unknown setting 'limits'"),
            ("queue = \"many\"", "'queue' is \"many\": it must be a whole number from 1 to 65536"),
            ("queue = \"5\"", "'queue' is \"5\": it must be a whole number from 1 to 65536"),
            ("queue = 0", "'queue' is 0: it must be a whole number from 1 to 65536"),
            ("queue = -1", "'queue' is -1: it must be a whole number from 1 to 65536"),
            ("queue = 5.0", "'queue' is 5.0: it must be a whole number from 1 to 65536"),
            ("recalibration = \"true\"", "'recalibration' is \"true\": it must be one of true, false"),
            ("http = \"nowhere\"", "'http' is \"nowhere\": invalid socket address"),
            ("http = 8080", "'http' is 8080: it must be a string in quotes"),
            ("models = \"\"", "'models' is \"\": it must not be empty"),
            (
                "provider = \"abacus\"",
                "'provider' is \"abacus\": it must be one of auto, cpu, openvino, cuda, tensorrt",
            ),
            ("queue = 5\nqueue = 6", "duplicate key"),
            ("queue", "line 1"),
        ] {
            let message = read(text).unwrap_err().to_string();
            assert!(message.contains(words) && message.contains("posed.toml: "), "{text}: {message}");
        }
        let message = SettingsFile::read(Path::new("nowhere.toml")).unwrap_err().to_string();
        assert!(message.contains("cannot read nowhere.toml"), "{message}");
    }
}
