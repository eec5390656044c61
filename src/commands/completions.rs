use std::error::Error;

use clap::{Args, Command};
use clap_complete::Shell;

#[derive(Args, Debug)]
pub(super) struct Completions {
    /// Shell to print the script for.
    #[arg(value_enum)]
    shell: Shell,
}

impl Completions {
    #[expect(clippy::unnecessary_wraps, reason = "as every sub-command")]
    pub(super) fn run(self, program: &mut Command) -> Result<(), Box<dyn Error>> {
        clap_complete::generate(self.shell, program, "posed", &mut std::io::stdout());
        Ok(())
    }
}
