//! `x-request-timeout-ms`: how long a caller waits.

use std::time::{Duration, Instant};

use axum::http::HeaderMap;

use crate::server::service::{Failure, Service};

const TIMEOUT: &str = "x-request-timeout-ms";

/// When the request's time is over.
pub(super) fn deadline(service: &Service, headers: &HeaderMap) -> Result<Instant, Failure> {
    let asked = headers.get(TIMEOUT).map(|value| {
        let milliseconds = value.to_str().ok().and_then(|text| text.parse::<u64>().ok()).filter(|ms| *ms > 0);
        let message =
            || Failure::invalid(format!("header '{TIMEOUT}' must be a whole number of milliseconds, at least 1"));
        milliseconds.ok_or_else(message)
    });
    Ok(service.deadline(asked.transpose()?.map(Duration::from_millis)))
}
