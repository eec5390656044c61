use std::sync::atomic::{AtomicUsize, Ordering};
use std::thread;

use indicatif::ProgressBar;

use super::options::WorkArgs;

/// Works on items on several threads, each with tools of its own, with a bar that shows how far; results in the order of the items.
/// Unless problems are to be skipped, what is after the first error is left undone.
///
/// # Errors
/// When tools cannot be made, or a thread panics.
pub(super) fn in_parallel<T: Sync, R: Send, Tools>(
    items: &[T],
    WorkArgs { keep_going, jobs }: &WorkArgs,
    title: String,
    make: impl Fn() -> Result<Tools, String> + Sync,
    work: impl Fn(&mut Tools, &T) -> Result<R, String> + Sync,
) -> Result<Vec<Result<R, String>>, String> {
    let progress = ProgressBar::new(items.len() as u64).with_message(title);
    let next = AtomicUsize::new(0);
    let stop = || next.store(items.len(), Ordering::Relaxed);
    let worker = || {
        let mut tools = make().inspect_err(|_| stop())?;
        let mut done = Vec::new();
        loop {
            let place = next.fetch_add(1, Ordering::Relaxed);
            let Some(item) = items.get(place) else { return Ok(done) };
            let result = work(&mut tools, item);
            progress.inc(1);
            if !keep_going && result.is_err() {
                stop();
            }
            done.push((place, result));
        }
    };
    let by_thread = thread::scope(|scope| {
        let threads: Vec<_> = (0..usize::from(*jobs).min(items.len())).map(|_| scope.spawn(worker)).collect();
        let joined =
            threads.into_iter().map(|thread| thread.join().unwrap_or_else(|_| Err("a worker panicked".into())));
        joined.collect::<Result<Vec<Vec<_>>, String>>()
    });
    progress.finish_and_clear();
    let mut results: Vec<_> = by_thread?.into_iter().flatten().collect();
    results.sort_by_key(|(place, _)| *place);
    Ok(results.into_iter().map(|(_, result)| result).collect())
}
