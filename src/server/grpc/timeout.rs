//! `grpc-timeout`: up to eight digits and a unit.

use std::time::{Duration, Instant};

use axum::http::HeaderMap;

use crate::server::service::Failure;

pub(super) fn grpc_timeout(headers: &HeaderMap) -> Result<Option<Duration>, Failure> {
    let Some(value) = headers.get("grpc-timeout") else { return Ok(None) };
    let parsed = value.to_str().ok().and_then(|text| {
        let (digits, unit) = text.split_at_checked(text.len().checked_sub(1)?)?;
        let amount = digits.parse::<u64>().ok().filter(|_| digits.len() <= 8)?;
        match unit {
            "H" => Some(Duration::from_hours(amount)),
            "M" => Some(Duration::from_mins(amount)),
            "S" => Some(Duration::from_secs(amount)),
            "m" => Some(Duration::from_millis(amount)),
            "u" => Some(Duration::from_micros(amount)),
            "n" => Some(Duration::from_nanos(amount)),
            _ => None,
        }
    });
    parsed.map(Some).ok_or_else(|| {
        Failure::invalid("metadata 'grpc-timeout' is not valid; it must have up to eight digits and a unit")
    })
}

/// Waits until a deadline, where there is one.
pub(super) async fn expired(deadline: Option<Instant>) {
    match deadline {
        Some(deadline) => tokio::time::sleep_until(deadline.into()).await,
        None => std::future::pending().await,
    }
}
