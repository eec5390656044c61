//! `x-request-timeout-ms`: how long a caller waits.

use std::time::{Duration, Instant};

use axum::http::HeaderMap;

use crate::server::service::{Failure, Service};

const TIMEOUT: &str = "x-request-timeout-ms";

/// When the request's time is over.
pub(super) fn deadline(service: &Service, headers: &HeaderMap) -> Result<Instant, Failure> {
    Ok(service.deadline(asked(headers)?))
}

/// The same for what may take as long as anything.
pub(super) fn long_deadline(service: &Service, headers: &HeaderMap) -> Result<Instant, Failure> {
    Ok(service.deadline(Some(asked(headers)?.unwrap_or(Duration::MAX))))
}

fn asked(headers: &HeaderMap) -> Result<Option<Duration>, Failure> {
    let asked = headers.get(TIMEOUT).map(|value| {
        let milliseconds = value.to_str().ok().and_then(|text| text.parse::<u64>().ok()).filter(|ms| *ms > 0);
        let message =
            || Failure::invalid(format!("header '{TIMEOUT}' must be a whole number of milliseconds, at least 1"));
        milliseconds.ok_or_else(message)
    });
    Ok(asked.transpose()?.map(Duration::from_millis))
}
