use std::error::Error;
use std::path::PathBuf;

use clap::Args;

use super::output::print;
use crate::server::{self, Config, init_logs};

#[derive(Args, Debug)]
pub(super) struct Serve {
    /// Settings file. Flags and POSED_... variables take precedence over it.
    #[arg(long, env = "POSED_CONFIG", value_name = "posed.toml")]
    pub(super) config: Option<PathBuf>,
    /// Print a settings file with the defaults and comments, and exit.
    #[arg(long)]
    pub(super) print_config: bool,
    #[command(flatten)]
    settings: Config,
}

impl Serve {
    pub(super) fn run(self) -> Result<(), Box<dyn Error>> {
        if self.print_config {
            print(format_args!("{}", server::default_settings()));
            return Ok(());
        }
        let config = self.settings;
        config.check()?;
        let logs = init_logs(&config.log, config.log_format)?;
        for problem in server::unknown_variables(std::env::vars_os().filter_map(|(name, _)| name.into_string().ok())) {
            tracing::warn!("{problem}");
        }
        let runtime = tokio::runtime::Builder::new_multi_thread().worker_threads(2).enable_all().build()?;
        let served = runtime.block_on(server::run(config, logs));
        // Drops what is left of the connections; what was accepted is answered, or its time is over.
        runtime.shutdown_background();
        Ok(served?)
    }
}
