use std::error::Error;

use clap::{Args, CommandFactory as _};
use clap_complete::Shell;

#[derive(Args, Debug)]
pub(super) struct Completions {
    #[arg(value_enum)]
    shell: Shell,
}

impl Completions {
    #[expect(clippy::unnecessary_wraps, reason = "as every sub-command")]
    pub(super) fn run(self) -> Result<(), Box<dyn Error>> {
        clap_complete::generate(self.shell, &mut super::Cli::command(), "posed", &mut std::io::stdout());
        Ok(())
    }
}
