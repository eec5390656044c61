//! The `posed` program: parse, run the sub-command, exit code.
#![forbid(unsafe_code)]

use std::process::ExitCode;

use clap::Parser as _;

fn main() -> ExitCode {
    match posed::commands::Cli::parse().run() {
        Ok(()) => ExitCode::SUCCESS,
        Err(error) => {
            eprintln!("posed: {error}");
            ExitCode::FAILURE
        }
    }
}
