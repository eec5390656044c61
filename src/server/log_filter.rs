//! Filters of the log: levels, for all or for a part of the program. What would silence it by a slip is refused.

use tracing_subscriber::EnvFilter;

/// What writes to the log.
const TARGETS: [&str; 12] = [
    "axum",
    "h2",
    "hyper",
    "hyper_util",
    "ort",
    "posed",
    "posed_core",
    "rustls",
    "tokio",
    "tonic",
    "tower",
    "tower_http",
];
/// The parts of `posed` that a filter may name.
const PARTS: [&str; 5] = ["commands", "estimator", "model", "server", "vision"];
const LEVELS: [&str; 6] = ["off", "error", "warn", "info", "debug", "trace"];
const MAX_BYTES: usize = 1024;

/// Reads a filter such as `info,posed=debug`.
pub(super) fn parse(text: &str) -> Result<EnvFilter, String> {
    if text.len() > MAX_BYTES {
        return Err(format!("the filter has more than {MAX_BYTES} bytes"));
    }
    text.split(',').try_for_each(check)?;
    EnvFilter::try_new(text).map_err(|error| format!("{text:?} is not a log filter: {error}"))
}

fn check(part: &str) -> Result<(), String> {
    let level = match part.split_once('=') {
        None => part,
        Some((target, level)) => {
            let known = target.split("::").next().unwrap_or_default();
            if !TARGETS.contains(&known) {
                return Err(format!("unknown target {target:?}; use one of {}", TARGETS.join(", ")));
            }
            let part = target.strip_prefix("posed::").and_then(|path| path.split("::").next());
            if part.is_some_and(|part| !PARTS.contains(&part)) {
                return Err(format!("unknown target {target:?}; posed has the parts {}", PARTS.join(", ")));
            }
            level
        }
    };
    if LEVELS.iter().any(|known| known.eq_ignore_ascii_case(level)) {
        Ok(())
    } else {
        let levels = LEVELS.join(", ");
        Err(format!("{level:?} is not a level; use one of {levels}, for all ('info') or a target ('posed=debug')"))
    }
}

#[cfg(test)]
mod tests {
    use super::parse;

    #[test]
    fn slips_are_refused() {
        for good in ["info", "OFF", "info,ort=warn", "warn,posed::estimator=debug,hyper=trace"] {
            assert!(parse(good).is_ok(), "{good}");
        }
        let long = "info,".repeat(300);
        for (bad, words) in [
            ("debgu", "\"debgu\" is not a level"),
            ("", "\"\" is not a level"),
            ("info,posd=debug", "unknown target \"posd\""),
            ("info,posed::nonsense::x=debug", "unknown target \"posed::nonsense::x\""),
            ("posed=loud", "\"loud\" is not a level"),
            ("info,", "\"\" is not a level"),
            ("[request{id=\"(a+)+$\"}]=trace", "unknown target"),
            ("info\nposed=debug", "unknown target"),
            (&long, "more than 1024 bytes"),
        ] {
            let said = parse(bad).unwrap_err();
            assert!(said.contains(words), "{bad}: {said}");
        }
    }
}
