//! One file for each sub-command.

mod calibrate;
mod check;
mod completions;
mod estimate;
mod evaluate;
mod healthcheck;
mod serve;

use std::error::Error;
use std::path::PathBuf;
use std::sync::Arc;

use clap::{Args, CommandFactory as _, FromArgMatches as _, Parser, Subcommand};

use crate::estimator::Estimator;
use crate::model::{Library, LoadError, Provider, References, Runtime, RuntimeError, available_cores};
use crate::server::{LogFormat, SettingsFile, init_logs};

/// Answers an RGB image with the 6D poses of known rigid objects.
///
/// Exit codes: 0 done; 1 failed, with one line on stderr that says why; 2 wrong usage.
#[derive(Debug, Parser)]
#[command(name = "posed", version)]
pub struct Cli {
    #[command(subcommand)]
    command: Command,
}

#[derive(Debug, Subcommand)]
#[expect(clippy::large_enum_variant, reason = "made once")]
enum Command {
    /// Serve poses over HTTP and gRPC.
    Serve(serve::Serve),
    /// Estimate poses in images, without a server.
    Estimate(estimate::Estimate),
    /// Measure an object's offset on reference images.
    Calibrate(calibrate::Calibrate),
    /// Load everything, estimate the samples, compare with their known poses.
    Check(check::Check),
    /// Score objects on a BOP dataset.
    Evaluate(evaluate::Evaluate),
    /// Ask a running server whether it is ready: for containers without a shell.
    Healthcheck(healthcheck::Healthcheck),
    /// Print a completion script for a shell.
    Completions(completions::Completions),
}

/// Where models lie and how they run.
#[derive(Args, Clone, Debug)]
struct ModelArgs {
    /// Folder with `detector/` and one folder for each object.
    #[arg(long, env = "POSED_MODELS", default_value = "models")]
    models: PathBuf,
    /// Folder with `<object>.json` for each calibrated object.
    #[arg(long, env = "POSED_REFERENCE", default_value = "reference")]
    reference: PathBuf,
    /// What the networks run on.
    #[arg(long, env = "POSED_PROVIDER", value_enum, default_value_t)]
    provider: Provider,
    /// Threads that a network runs on [default: the cores this process may use].
    #[arg(long, env = "POSED_THREADS", value_parser = clap::value_parser!(u16).range(1..=256))]
    threads: Option<u16>,
}

impl ModelArgs {
    fn runtime(&self) -> Result<Runtime, RuntimeError> {
        Runtime::load(self.provider, self.threads.map_or_else(available_cores, usize::from))
    }

    /// The whole pipeline, with its models.
    fn estimator(&self, runtime: &Runtime) -> Result<(Estimator, Arc<Library>), LoadError> {
        let library = Arc::new(Library::load(&self.models)?);
        let references = Arc::new(References::load(&self.reference, &library)?);
        Ok((Estimator::new(Arc::clone(&library), references, runtime)?, library))
    }
}

impl Cli {
    /// Reads the command line and the environment. A file of settings that they name stands in for the defaults, for which
    /// they are read a second time. Leaves the program where they cannot be understood, or ask for help.
    ///
    /// # Errors
    /// When the file is none of settings.
    pub fn read() -> Result<Self, Box<dyn Error>> {
        let cli = Self::parse();
        let Command::Serve(serve::Serve { config: Some(path), print_config: false, .. }) = &cli.command else {
            return Ok(cli);
        };
        let file = SettingsFile::read(path)?;
        let command = Self::command().mut_subcommand("serve", |serve| file.in_place_of_defaults(serve));
        Ok(Self::from_arg_matches(&command.get_matches())?)
    }

    /// Runs the chosen sub-command to its end.
    ///
    /// # Errors
    /// Whatever stopped it, in words for its user.
    pub fn run(self) -> Result<(), Box<dyn Error>> {
        if !matches!(self.command, Command::Serve(_)) {
            // A server's logs are part of its settings.
            init_logs("warn,ort=error", LogFormat::Pretty)?;
        }
        match self.command {
            Command::Serve(command) => command.run(),
            Command::Estimate(command) => command.run(),
            Command::Calibrate(command) => command.run(),
            Command::Check(command) => command.run(),
            Command::Evaluate(command) => command.run(),
            Command::Healthcheck(command) => command.run(),
            Command::Completions(command) => command.run(),
        }
    }
}
