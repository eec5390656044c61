//! One file for each sub-command.

mod calibrate;
mod check;
mod completions;
mod estimate;
mod evaluate;
mod healthcheck;
mod models;
mod serve;

use std::error::Error;

use clap::{CommandFactory as _, FromArgMatches as _, Parser, Subcommand};

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
            Command::Completions(command) => command.run(&mut Self::command()),
        }
    }
}
