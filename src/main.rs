//! The `posed` program: parse, run the sub-command, exit code.
#![forbid(unsafe_code)]

use std::process::ExitCode;

use mimalloc::MiMalloc;

use posed::commands::Cli;

/// Gives large bodies and images back to the system once they are gone; glibc keeps them after the first few.
#[global_allocator]
static ALLOCATOR: MiMalloc = MiMalloc;

fn main() -> ExitCode {
    match Cli::read().and_then(Cli::run) {
        Ok(()) => ExitCode::SUCCESS,
        Err(error) => {
            eprintln!("posed: {error}");
            ExitCode::FAILURE
        }
    }
}
