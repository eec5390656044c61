use std::path::PathBuf;

use clap::Args;
use clap::builder::TypedValueParser as _;

use super::super::dataset::DatasetArgs;
use super::super::models::ModelArgs;
use crate::evaluation::{Boxes, VisibleRange};

/// What is evaluated, and how.
#[derive(Args, Clone, Debug)]
pub(super) struct Asked {
    /// Names of the objects. Each has a folder in the models folder.
    #[arg(required = true)]
    pub(super) objects: Vec<String>,
    #[command(flatten)]
    pub(super) splits: SplitArgs,
    #[command(flatten)]
    pub(super) work: WorkArgs,
    #[command(flatten)]
    pub(super) dataset: DatasetArgs,
    #[command(flatten)]
    pub(super) models: ModelArgs,
}

/// How images are worked through.
#[derive(Args, Clone, Debug)]
pub(super) struct WorkArgs {
    /// Skip scenes and images that cannot be read, and report them at the end, instead of failing.
    #[arg(long)]
    pub(super) keep_going: bool,
    /// Number of images to process in parallel. Each job loads its own networks.
    #[arg(long, value_name = "N", default_value_t = 1, value_parser = clap::value_parser!(u16).range(1..=256))]
    pub(super) jobs: u16,
}

/// Images and boxes.
#[derive(Args, Clone, Debug)]
#[allow(clippy::struct_excessive_bools, reason = "flags of a command line")]
pub(super) struct SplitArgs {
    /// BOP split or LINEMOD data folder: scene folders with their ground truth. Or one scene folder. Repeat it for several.
    #[arg(long = "split", value_name = "DIR", required = true)]
    pub(super) splits: Vec<PathBuf>,
    /// Models folder of the dataset (meshes and `models_info.json`), or the dataset folder. Only the scores need it.
    #[arg(long, value_name = "DIR", required_unless_present = "without_truth")]
    pub(super) meshes: Option<PathBuf>,
    /// BOP list of targets (`test_targets_bop19.json`): evaluate only these, and of each object the most visible instances.
    #[arg(long, value_name = "FILE.json")]
    pub(super) targets: Option<PathBuf>,
    /// Ranges of the visible fraction, each reported on its own. Views outside of all of them are not scored.
    /// [default: 0.7..1 and 0.3..0.7; 0..1 with --targets]
    #[arg(long = "visible", value_name = "LOW..HIGH")]
    visible: Vec<VisibleRange>,
    /// Use the boxes of the detector instead of the ground truth. A view without a pose counts as wrong.
    #[arg(long)]
    pub(super) detector: bool,
    /// Score the poses in a BOP file of results, of this or any other method, instead of estimating them.
    #[arg(long, value_name = "FILE.csv", conflicts_with = "detector")]
    pub(super) estimates: Option<PathBuf>,
    /// Instead of the accuracy with the references that are in use, report the accuracy with 1, 3, 10 and all views of this split
    /// as references, drawn ten times, averaged in both modes: the plot of the paper over the number of pose labels.
    #[arg(long, value_name = "DIR", conflicts_with_all = ["detector", "estimates", "bop", "html"])]
    pub(super) references_study: Option<PathBuf>,
    /// Compare the poses with each other instead of ground truth: of still scenes, photographed from known camera poses
    /// (`cam_R_w2c` and `cam_t_w2c` in `scene_camera.json`). Uses the whole pipeline, with the detector.
    #[arg(long, conflicts_with_all = [
        "meshes", "targets", "visible", "detector", "camera", "estimates", "references_study", "html", "bop",
    ])]
    pub(super) without_truth: bool,
    /// Fuse the poses of N views of a scene, whose camera poses must be known (`cam_R_w2c` and `cam_t_w2c` in `scene_camera.json`):
    /// of each object, random subsets of the views that show enough of it, the same every time. Repeat it for a row each. Uses
    /// the whole pipeline, with the detector.
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u16).range(1..=64).map(usize::from), conflicts_with_all = [
        "without_truth", "targets", "estimates", "references_study", "html", "bop",
    ])]
    pub(super) views: Vec<usize>,
    /// In so many of the views the object is made to look turned by half a turn: are they found out?
    #[arg(long, value_name = "K", requires = "views", default_value_t = 0, hide_default_value = true)]
    pub(super) wrong_views: usize,
    /// With `--views`: the cameras' poses are exact, as in renderings. Without this they count as known to 1 mm and 0.1 degrees.
    #[arg(long, requires = "views")]
    pub(super) exact_cameras: bool,
    /// With `--views`: subsets that are drawn of the views of each object.
    #[arg(long, value_name = "N", requires = "views", default_value_t = 10, value_parser = clap::value_parser!(u32).range(1..=10_000))]
    pub(super) draws: u32,
    /// Replay the images of each scene in their order as a stream that tracks, and compare it with single images: rate, spread,
    /// identity switches, errors. Uses the whole pipeline, with the detector.
    #[arg(long, conflicts_with_all = ["targets", "detector", "estimates", "references_study", "without_truth", "html", "bop", "views"])]
    pub(super) stream: bool,
    /// With `--stream`: images a second. An image's time is its number divided by this.
    #[arg(long, value_name = "RATE", requires = "stream", default_value_t = 30.0, value_parser = rate)]
    pub(super) fps: f64,
    /// With `--stream`: run the detector on every n-th image.
    #[arg(long, value_name = "N", requires = "stream", default_value_t = 10, value_parser = clap::value_parser!(u32).range(1..=1000))]
    pub(super) detect_every: u32,
}

fn rate(text: &str) -> Result<f64, String> {
    let rate = text.parse().ok().filter(|rate| (0.01..=1000.0).contains(rate));
    rate.ok_or_else(|| "must be a number from 0.01 to 1000".into())
}

impl Asked {
    /// Refuses what is given twice: it would be counted twice.
    pub(super) fn check(&self) -> Result<(), String> {
        let splits: Vec<_> =
            self.splits.splits.iter().map(|split| split.canonicalize().unwrap_or(split.clone())).collect();
        let ranges: Vec<_> = self.splits.visible.iter().map(VisibleRange::to_string).collect();
        for (what, twice) in [
            ("object", first_twice(&self.objects)),
            ("--split", first_twice(&splits).map(|path| path.display().to_string())),
            ("--visible", first_twice(&ranges)),
            ("--views", first_twice(&self.splits.views).map(|views| views.to_string())),
        ] {
            if let Some(twice) = twice {
                return Err(format!("{what} {twice} is given twice"));
            }
        }
        let wrong = self.splits.wrong_views;
        match self.splits.views.iter().find(|views| **views <= wrong) {
            Some(views) => {
                Err(format!("--wrong-views {wrong} of --views {views} leaves none that is right; give fewer"))
            }
            None => Ok(()),
        }
    }
}

pub(super) fn first_twice<T: Clone + PartialEq>(all: &[T]) -> Option<T> {
    (1..all.len()).find(|place| all[..*place].contains(&all[*place])).map(|place| all[place].clone())
}

impl SplitArgs {
    /// Targets count however hidden they are.
    pub(super) fn visible(&self) -> Vec<VisibleRange> {
        match (&self.visible[..], &self.targets) {
            ([], None) => vec![VisibleRange::MOSTLY_VISIBLE, VisibleRange::HALF_HIDDEN],
            ([], Some(_)) => vec![VisibleRange::ALL],
            (ranges, _) => ranges.to_vec(),
        }
    }

    /// Of a view that is one of several.
    pub(super) fn visible_in_views(&self) -> Vec<VisibleRange> {
        if self.visible.is_empty() { vec![VisibleRange::MOSTLY_VISIBLE] } else { self.visible.clone() }
    }

    pub(super) fn boxes(&self) -> Boxes {
        match (self.detector, &self.estimates) {
            (true, _) => Boxes::Detector,
            (false, Some(_)) => Boxes::File,
            (false, None) => Boxes::GroundTruth,
        }
    }
}

/// Where the results go, beside the terminal.
#[derive(Args, Clone, Debug)]
pub(super) struct OutputArgs {
    /// Write all figures as JSON.
    #[arg(long, value_name = "FILE.json")]
    pub(super) json: Option<PathBuf>,
    /// Write a report with plots and pictures: one HTML file that loads nothing from elsewhere.
    #[arg(long, value_name = "FILE.html")]
    pub(super) html: Option<PathBuf>,
    /// Write the plot of the study.
    #[arg(long, value_name = "FILE.svg", requires = "references_study")]
    pub(super) plot: Option<PathBuf>,
    /// Write the estimates for the BOP toolkit into this folder: poses as `METHOD_DATASET-SPLIT.csv`, and with `--detector` the
    /// boxes as `METHOD_DATASET-SPLIT_boxes.json`.
    #[arg(long, value_name = "DIR")]
    pub(super) bop: Option<PathBuf>,
    /// Name of the method in these files' names.
    /// Letters, digits and hyphens.
    #[arg(long, value_name = "NAME", default_value = "posed", requires = "bop", value_parser = method_name)]
    pub(super) method: String,
}

/// The toolkit takes files' names apart at underscores.
fn method_name(text: &str) -> Result<String, String> {
    let fits = !text.is_empty() && text.chars().all(|letter| letter.is_ascii_alphanumeric() || letter == '-');
    fits.then(|| text.to_owned()).ok_or_else(|| "must be letters, digits and hyphens".into())
}
