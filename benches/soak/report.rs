//! The tables.

use std::fmt::Write as _;
use std::time::Duration;

use crate::book::Book;
use crate::numbers::spread;
use crate::process::Memory;
use crate::trend::Trend;
use crate::watch::{Probed, Sample};

const MARKS: Duration = Duration::from_mins(5);

/// The server while nobody asks it anything.
#[derive(Clone, Copy)]
pub struct Quiet {
    pub sockets: usize,
    pub threads: usize,
    pub mib: f64,
    /// Images in its queue, and bytes of bodies that it holds.
    pub images: u64,
    pub body_bytes: u64,
}

pub struct Report {
    pub warm_up: Duration,
    pub soak: Duration,
    pub book: std::sync::Arc<Book>,
    /// `None` where the server is dead.
    pub warm: Option<Quiet>,
    pub end: Option<Quiet>,
    pub memory: Vec<Sample>,
    pub peak: Option<Memory>,
    pub bound_mib: f64,
    pub probed: Probed,
}

impl Report {
    /// Why the run is no proof of anything good.
    pub fn failures(&self) -> Vec<String> {
        let mut failures = Vec::new();
        let (lost, losses) = self.book.lost();
        if lost > 0 {
            failures.push(format!("{lost} requests were lost; the first of them:"));
            failures.extend(losses);
        }
        match self.peak {
            Some(peak) if peak.peak > self.bound_mib => {
                failures.push(format!("{:.0} MiB were resident, above the bound of {:.0}", peak.peak, self.bound_mib));
            }
            Some(_) => {}
            None => failures.push("the server died".into()),
        }
        failures
    }

    pub fn text(&self) -> String {
        let mut text = format!(
            "# Soak\n\n`make soak`: the real server, with a minute for each request and otherwise default settings, and good, bad, slow, leaving and hostile clients at \
             once, on the same {} cores. {:.0} s of warm-up and {:.0} s of soak. A good or slow client must get the right answer, \
             the same as when it was alone, or a refusal that says when to come again; all else is a lost request.\n\n",
            std::thread::available_parallelism().map_or(0, usize::from),
            self.warm_up.as_secs_f64(),
            self.soak.as_secs_f64()
        );
        let failures = self.failures();
        if !failures.is_empty() {
            writeln!(text, "**Failed.**\n").unwrap();
            for failure in failures {
                writeln!(text, "- {failure}").unwrap();
            }
            text.push('\n');
        }
        self.overview(&mut text);
        self.marks(&mut text);
        self.clients(&mut text);
        text
    }

    fn overview(&self, text: &mut String) {
        text.push_str("| | |\n|---|---|\n");
        let mut line = |name: &str, value: String| writeln!(text, "| {name} | {value} |").unwrap();
        line("lost requests", format!("**{}**", self.book.lost().0));
        let trend = Trend::of(&self.memory);
        let Trend { mib_per_hour, standard_error, means, block_s } = trend;
        line(
            &format!("resident memory after warm-up: slope ± standard error, MiB/h ({means} means of {block_s:.0} s)"),
            format!("**{mib_per_hour:.1} ± {standard_error:.1}**"),
        );
        let peak = self.peak.map_or("dead".into(), |peak| format!("{:.0}", peak.peak));
        line("resident memory: most, and the bound in `/v1/limits`, MiB", format!("{peak} / {:.0}", self.bound_mib));
        let probed = &self.probed;
        line("probes, each with its own connection", probed.milliseconds.len().to_string());
        line("probes: p50 / p99 / most, ms (goal: 100)", spread(&probed.milliseconds));
        line("probes: not ready, not answered", format!("{}, {}", probed.not_ready, probed.failed));
        let (Some(warm), Some(end)) = (self.warm, self.end) else { return };
        let mut both = |name: &str, of: fn(&Quiet) -> f64| {
            line(&format!("{name}: after warm-up, at the end"), format!("{:.0}, {:.0}", of(&warm), of(&end)));
        };
        text_of_quiet(&mut both);
    }

    fn marks(&self, text: &mut String) {
        let time = self.warm_up + self.soak;
        let step = MARKS.min(time / 4);
        text.push_str("\n| minute | resident memory, MiB |\n|---|---|\n");
        let mut mark = step;
        // Samples begin after the warm-up.
        while self.memory.first().is_some_and(|sample| sample.at > mark) {
            mark += step;
        }
        while let Some(sample) = self.memory.iter().find(|sample| sample.at >= mark) {
            writeln!(text, "| {:.1} | {:.0} |", mark.as_secs_f64() / 60.0, sample.mib).unwrap();
            mark += step;
        }
    }

    fn clients(&self, text: &mut String) {
        text.push_str("\n| clients | what they do | how often, and what came of it |\n|---|---|---|\n");
        for ((group, what), outcomes) in self.book.rows() {
            let mut outcomes: Vec<_> = outcomes.into_iter().collect();
            outcomes.sort_by_key(|(_, count)| std::cmp::Reverse(*count));
            let outcomes: Vec<_> = outcomes.iter().map(|(outcome, count)| format!("{count} × {outcome}")).collect();
            writeln!(text, "| {group} | {what} | {} |", outcomes.join(", ")).unwrap();
        }
    }
}

fn text_of_quiet(both: &mut impl FnMut(&str, fn(&Quiet) -> f64)) {
    both("open sockets, without clients", |quiet| quiet.sockets as f64);
    both("threads, without clients", |quiet| quiet.threads as f64);
    both("resident memory without clients, MiB", |quiet| quiet.mib);
    both("images in the queue, without clients", |quiet| quiet.images as f64);
    both("bytes of bodies held, without clients", |quiet| quiet.body_bytes as f64);
}
