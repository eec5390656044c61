use std::error::Error;
use std::path::PathBuf;

use clap::Args;

use crate::server::{self, Config, DEFAULT_SETTINGS, Settings, init_logs};

#[derive(Args, Debug)]
pub(super) struct Serve {
    /// File of settings; flags and POSED_... variables win over it.
    #[arg(long, env = "POSED_CONFIG", value_name = "posed.toml")]
    config: Option<PathBuf>,
    /// Print the default settings, with comments, and exit.
    #[arg(long)]
    print_config: bool,
    #[command(flatten)]
    settings: Settings,
}

impl Serve {
    pub(super) fn run(self) -> Result<(), Box<dyn Error>> {
        if self.print_config {
            print!("{DEFAULT_SETTINGS}");
            return Ok(());
        }
        let config = Config::new(&self.settings, self.config.as_deref())?;
        let logs = init_logs(&config.log, config.log_format)?;
        let runtime = tokio::runtime::Builder::new_multi_thread().worker_threads(2).enable_all().build()?;
        let served = runtime.block_on(server::run(config, logs));
        // Drops what is left of the connections; what was accepted is answered, or its time is over.
        runtime.shutdown_background();
        Ok(served?)
    }
}
