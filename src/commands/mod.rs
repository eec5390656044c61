//! One file for each sub-command.

mod calibrate;
mod estimate;
mod evaluate;
mod serve;

use std::error::Error;
use std::path::PathBuf;

use clap::{Args, Parser, Subcommand};

use crate::model::{Runtime, RuntimeError, StorePaths};

/// Answers an RGB image with the 6D poses of known rigid objects.
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
    /// Estimate poses in one image, without a server.
    Estimate(estimate::Estimate),
    /// Measure an object's offset on a reference image with a known pose.
    Calibrate(calibrate::Calibrate),
    /// Score objects on a BOP dataset with ground-truth boxes.
    Evaluate(evaluate::Evaluate),
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
    /// Threads that a network runs on [default: the cores this process may use].
    #[arg(long, env = "POSED_THREADS", value_parser = clap::value_parser!(u16).range(1..=256))]
    threads: Option<u16>,
}

impl ModelArgs {
    fn paths(&self) -> StorePaths {
        StorePaths { models: self.models.clone(), reference: self.reference.clone() }
    }

    fn runtime(&self) -> Result<Runtime, RuntimeError> {
        let available = || std::thread::available_parallelism().map_or(1, usize::from);
        Runtime::load(self.threads.map_or_else(available, usize::from))
    }
}

impl Cli {
    /// Runs the chosen sub-command to its end.
    ///
    /// # Errors
    /// Whatever stopped it, in words for its user.
    pub fn run(self) -> Result<(), Box<dyn Error>> {
        match self.command {
            Command::Serve(command) => command.run(),
            Command::Estimate(command) => command.run(),
            Command::Calibrate(command) => command.run(),
            Command::Evaluate(command) => command.run(),
        }
    }
}
