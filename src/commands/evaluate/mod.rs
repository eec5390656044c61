//! `posed evaluate`.

mod answers;
mod options;
mod output;
mod plan;
mod pool;
mod problems;
mod scoring;
mod sheets;
mod shots;
mod stream;
mod study;
mod table;
mod views;
mod without_truth;
mod work;

use std::error::Error;

use clap::Args;

use super::output::print;
use crate::evaluation::{ObjectRecords, Report, page};
use options::{Asked, OutputArgs};
use scoring::Scoring;
use views::SeveralViews;
use without_truth::StillScenes;

#[derive(Args, Debug)]
pub(super) struct Evaluate {
    #[command(flatten)]
    asked: Asked,
    #[command(flatten)]
    output: OutputArgs,
}

impl Evaluate {
    pub(super) fn run(self) -> Result<(), Box<dyn Error>> {
        self.asked.check()?;
        self.output.check(&self.asked.splits.splits)?;
        if self.asked.splits.without_truth {
            return self.compare_views();
        }
        if !self.asked.splits.views.is_empty() {
            let [split] = &self.asked.splits.splits[..] else {
                return Err("--views takes one --split; its scenes may be many".into());
            };
            return SeveralViews { asked: &self.asked, split, output: &self.output }.run();
        }
        if self.asked.splits.stream {
            return stream::run(&self.asked, &self.output);
        }
        let scoring = Scoring::new(&self.asked, self.output.bop.is_some())?;
        if let Some(references) = &self.asked.splits.references_study {
            let rows = scoring.study(references)?;
            self.output.write_json(&rows)?;
            self.output.write_plot(&study::plot(&rows))?;
            print(format_args!("{}", study::table(&rows)));
            return Ok(());
        }
        let mut scored = Vec::new();
        for split in &self.asked.splits.splits {
            let split = scoring.score(split)?;
            self.output.write_bop(&split.path, &split.written)?;
            scored.push(split);
        }
        let seen = scoring.check_seen(&scored);
        let all: Vec<ObjectRecords> = scored.iter_mut().flat_map(|split| std::mem::take(&mut split.objects)).collect();
        let report = Report::new(self.asked.splits.boxes(), &self.asked.splits.visible(), &all);
        self.output.write_json(&report)?;
        if self.output.html.is_some() {
            let sheets = sheets::sheets(&scoring, &scored, &all)?;
            self.output.write_html(&page(&report, &all, &sheets))?;
        }
        for split in &scored {
            split.problems.report();
        }
        print(format_args!("{}", table::tables(&report)));
        Ok(seen?)
    }

    /// Without ground truth.
    fn compare_views(&self) -> Result<(), Box<dyn Error>> {
        let [split] = &self.asked.splits.splits[..] else {
            return Err("--without-truth takes one --split; its scenes may be many".into());
        };
        StillScenes { asked: &self.asked, split, output: &self.output }.run()
    }
}
