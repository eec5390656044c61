use std::error::Error;
use std::time::Duration;

use clap::Args;
use ureq::Agent;

#[derive(Args, Debug)]
pub(super) struct Healthcheck {
    /// Admin address of the server.
    #[arg(long, env = "POSED_ADMIN", default_value = "127.0.0.1:8081")]
    admin: String,
}

const TIMEOUT: Duration = Duration::from_secs(3);

impl Healthcheck {
    pub(super) fn run(self) -> Result<(), Box<dyn Error>> {
        // The address that the server listens on may stand for every interface.
        let address = self.admin.replace("0.0.0.0", "127.0.0.1").replace("[::]", "[::1]");
        let agent: Agent =
            Agent::config_builder().timeout_global(Some(TIMEOUT)).http_status_as_error(false).build().into();
        let mut response = agent.get(format!("http://{address}/readyz")).call().map_err(|error| {
            format!("no answer from {address}: {error}; is the server running, and is this its admin address?")
        })?;
        let body = response.body_mut().read_to_string().unwrap_or_default();
        if response.status().is_success() { Ok(()) } else { Err(format!("not ready: {}", body.trim()).into()) }
    }
}
