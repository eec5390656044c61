//! File descriptors: each connection takes one, and a process has so many.

use rustix::process::{Resource, Rlimit, getrlimit, setrlimit};

/// For everything that is no connection: libraries, files, threads' own.
const RESERVED: u64 = 32;

/// How many connections each of some ports may have, at most as many as `asked`, beside `others`. Raises the soft limit of
/// the process as far as it is needed and allowed.
pub(super) fn connections(asked: usize, ports: usize, others: usize) -> usize {
    let beside = others as u64 + RESERVED;
    let needed = (asked * ports) as u64 + beside;
    let limit = getrlimit(Resource::Nofile);
    let raised = limit.maximum.map_or(needed, |maximum| maximum.min(needed));
    let mut current = limit.current.unwrap_or(u64::MAX);
    if current < raised && setrlimit(Resource::Nofile, Rlimit { current: Some(raised), ..limit }).is_ok() {
        current = raised;
    }
    let fit = usize::try_from(current.saturating_sub(beside)).unwrap_or(usize::MAX) / ports.max(1);
    if fit >= asked {
        return asked;
    }
    let fit = fit.max(1);
    tracing::warn!(
        "only {fit} connections on each port instead of {asked} ('max_connections'): the process may open {current} files \
         (`ulimit -n`)"
    );
    fit
}
