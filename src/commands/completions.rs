use std::error::Error;

use clap::{Args, Command};
use clap_complete::Shell;

use super::output::print;

#[derive(Args, Debug)]
pub(super) struct Completions {
    /// Shell to print the script for.
    #[arg(value_enum)]
    shell: Shell,
}

impl Completions {
    #[expect(clippy::unnecessary_wraps, reason = "as every sub-command")]
    pub(super) fn run(self, program: &mut Command) -> Result<(), Box<dyn Error>> {
        let mut script = Vec::new();
        clap_complete::generate(self.shell, program, "posed", &mut script);
        print(format_args!("{}", String::from_utf8_lossy(&script)));
        Ok(())
    }
}
