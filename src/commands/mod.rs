//! One file for each sub-command.

mod boxes;
mod calibrate;
mod check;
mod clicks;
mod completions;
mod dataset;
mod estimate;
mod evaluate;
mod healthcheck;
mod known;
mod models;
mod objects;
mod output;
mod serve;

use std::error::Error;

use clap::{CommandFactory as _, FromArgMatches as _, Parser, Subcommand};

use crate::server::{LogFormat, SettingsFile, init_logs};

/// Estimates the 6D poses of known rigid objects in RGB images.
///
/// Exit codes: 0 success; 1 failure, with the reason in one line on stderr; 2 wrong usage.
#[derive(Debug, Parser)]
#[command(name = "posed", version)]
pub struct Cli {
    #[command(subcommand)]
    command: Command,
}

#[derive(Debug, Subcommand)]
enum Command {
    /// Run the server (HTTP and gRPC).
    Serve(serve::Serve),
    /// Estimate poses in image files, without a server.
    Estimate(estimate::Estimate),
    /// Calibrate an object: measure its offset in reference images.
    Calibrate(calibrate::Calibrate),
    /// Check an installation: load all models, and compare the poses in the samples with the known ones.
    Check(check::Check),
    /// Add, remove and list the objects of a models folder. Without a server: one that runs on this folder takes changes up with
    /// --watch, else at its next start.
    Objects(objects::Objects),
    /// Evaluate the accuracy of objects on a dataset (BOP or LINEMOD).
    Evaluate(evaluate::Evaluate),
    /// Check that a running server is ready. For containers without a shell.
    Healthcheck(healthcheck::Healthcheck),
    /// Print a shell completion script.
    Completions(completions::Completions),
}

impl Cli {
    /// Reads the command line and the environment. If they name a settings file, reads them a second time with the file
    /// in place of the defaults. Exits if they are invalid or ask for help.
    ///
    /// # Errors
    /// When the settings file cannot be used.
    pub fn read() -> Result<Self, Box<dyn Error>> {
        let cli = Self::parse();
        let Command::Serve(serve::Serve { config: Some(path), print_config: false, .. }) = &cli.command else {
            return Ok(cli);
        };
        let file = SettingsFile::read(path)?;
        let command = Self::command().mut_subcommand("serve", |serve| file.in_place_of_defaults(serve));
        Ok(Self::from_arg_matches(&command.get_matches())?)
    }

    /// Runs the chosen sub-command.
    ///
    /// # Errors
    /// The reason why it failed, for its user.
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
            Command::Objects(command) => command.run(),
            Command::Evaluate(command) => command.run(),
            Command::Healthcheck(command) => command.run(),
            Command::Completions(command) => command.run(&mut Self::command()),
        }
    }
}
