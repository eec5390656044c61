//! The `posed` program: parse, run the sub-command, exit code.
#![forbid(unsafe_code)]

use std::process::ExitCode;

use posed::commands::Cli;

fn main() -> ExitCode {
    match Cli::read().and_then(Cli::run) {
        Ok(()) => ExitCode::SUCCESS,
        Err(error) => {
            eprintln!("posed: {error}");
            ExitCode::FAILURE
        }
    }
}
