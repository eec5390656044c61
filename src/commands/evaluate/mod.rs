//! `posed evaluate`.

mod answers;
mod options;
mod output;
mod plan;
mod pool;
mod problems;
mod scoring;
mod sheets;
mod study;
mod table;
mod without_truth;
mod work;

use std::error::Error;

use clap::Args;

use super::dataset::DatasetArgs;
use super::models::ModelArgs;
use crate::evaluation::{ObjectRecords, Report, page};
use options::{OutputArgs, SplitArgs};
use scoring::Scoring;
use without_truth::StillScenes;

#[derive(Args, Debug)]
pub(super) struct Evaluate {
    /// Names of the objects. Each has a folder in the models folder.
    #[arg(required = true)]
    objects: Vec<String>,
    #[command(flatten)]
    splits: SplitArgs,
    #[command(flatten)]
    output: OutputArgs,
    #[command(flatten)]
    work: WorkArgs,
    #[command(flatten)]
    dataset: DatasetArgs,
    #[command(flatten)]
    models: ModelArgs,
}

/// How images are worked through.
#[derive(Args, Clone, Debug)]
struct WorkArgs {
    /// Skip scenes and images that cannot be read, and report them at the end, instead of failing.
    #[arg(long)]
    keep_going: bool,
    /// Number of images to process in parallel. Each job loads its own networks.
    #[arg(long, value_name = "N", default_value_t = 1, value_parser = clap::value_parser!(u16).range(1..=256))]
    jobs: u16,
}

impl Evaluate {
    pub(super) fn run(self) -> Result<(), Box<dyn Error>> {
        self.output.check()?;
        if self.splits.without_truth {
            return self.compare_views();
        }
        let scoring = Scoring::new(&self)?;
        if let Some(references) = &self.splits.references_study {
            let rows = scoring.study(references)?;
            print!("{}", study::table(&rows));
            self.output.write_json(&rows)?;
            return Ok(self.output.write_plot(&study::plot(&rows))?);
        }
        let mut scored = Vec::new();
        for split in &self.splits.splits {
            let split = scoring.score(split)?;
            self.output.write_bop(&split.path, &split.written)?;
            scored.push(split);
        }
        scoring.check_seen(&scored)?;
        let all: Vec<ObjectRecords> = scored.iter_mut().flat_map(|split| std::mem::take(&mut split.objects)).collect();
        let report = Report::new(self.splits.boxes(), &self.splits.visible, &all);
        print!("{}", table::tables(&report));
        self.output.write_json(&report)?;
        if self.output.html.is_some() {
            let sheets = sheets::sheets(&scoring, &scored, &all)?;
            self.output.write_html(&page(&report, &all, &sheets))?;
        }
        for split in &scored {
            split.problems.report();
        }
        Ok(())
    }

    /// Without ground truth.
    fn compare_views(&self) -> Result<(), Box<dyn Error>> {
        let [split] = &self.splits.splits[..] else {
            return Err("--without-truth takes one --split; its scenes may be many".into());
        };
        let still = StillScenes {
            objects: &self.objects,
            split,
            options: self.dataset.options()?,
            models: &self.models,
            jobs: usize::from(self.work.jobs),
            keep_going: self.work.keep_going,
            output: &self.output,
        };
        still.run()
    }
}
