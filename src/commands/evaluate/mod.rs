mod plan;
mod pool;
mod problems;
mod without_truth;
mod work;

use std::error::Error;
use std::ops::RangeInclusive;
use std::path::PathBuf;

use clap::Args;
use indicatif::ProgressBar;

use super::dataset::DatasetArgs;
use super::models::ModelArgs;
use crate::evaluation::{ObjectMesh, Score, Targets};
use crate::model::{ObjectModel, References};
use plan::{Plan, Selection};
use pool::in_parallel;
use without_truth::StillScenes;
use work::{Object, Setup};

#[derive(Args, Debug)]
pub(super) struct Evaluate {
    /// Names of the objects. Each has a folder in the models folder.
    #[arg(required = true)]
    objects: Vec<String>,
    /// BOP split or LINEMOD data folder: scene folders with their ground truth. Or one scene folder.
    #[arg(long, value_name = "DIR")]
    split: PathBuf,
    /// Models folder of the dataset (meshes and `models_info.json`), or the dataset folder. Only the scores need it.
    #[arg(long, value_name = "DIR", required_unless_present = "without_truth")]
    meshes: Option<PathBuf>,
    /// BOP list of targets (`test_targets_bop19.json`): evaluate only these, and of each object the most visible instances.
    #[arg(long, value_name = "FILE.json")]
    targets: Option<PathBuf>,
    /// Minimum visible fraction of the object in a view.
    #[arg(long, default_value_t = 0.7)]
    min_visible: f64,
    /// Maximum visible fraction of the object in a view.
    #[arg(long, default_value_t = 1.0)]
    max_visible: f64,
    /// Use the boxes of the detector instead of the ground truth. A view without a pose counts as wrong.
    #[arg(long)]
    detector: bool,
    /// Compare the poses with each other instead of ground truth: of still scenes, photographed from known camera poses
    /// (`cam_R_w2c` and `cam_t_w2c` in `scene_camera.json`). Uses the whole pipeline, with the detector.
    #[arg(long, conflicts_with_all = ["meshes", "targets", "min_visible", "max_visible", "detector", "camera"])]
    without_truth: bool,
    /// Write all figures, those of each pose, too, to this file.
    #[arg(long, value_name = "FILE.json", requires = "without_truth", conflicts_with = "meshes")]
    json: Option<PathBuf>,
    /// Skip scenes and images that cannot be read, and report them at the end, instead of failing.
    #[arg(long)]
    keep_going: bool,
    /// Number of images to process in parallel. Each job loads its own networks.
    #[arg(long, value_name = "N", default_value_t = 1, value_parser = clap::value_parser!(u16).range(1..=256))]
    jobs: u16,
    #[command(flatten)]
    dataset: DatasetArgs,
    #[command(flatten)]
    models: ModelArgs,
}

impl Evaluate {
    pub(super) fn run(self) -> Result<(), Box<dyn Error>> {
        if self.without_truth {
            let still = StillScenes {
                objects: &self.objects,
                split: &self.split,
                options: self.dataset.options()?,
                models: &self.models,
                jobs: usize::from(self.jobs),
                keep_going: self.keep_going,
                json: self.json.as_deref(),
            };
            return still.run();
        }
        let boxes = if self.detector { "The detector's boxes" } else { "Ground-truth boxes" };
        let (split, visible) = (self.split.display(), self.visible());
        println!("{boxes} of {split}, visible fraction {} to {}\n", visible.start(), visible.end());
        let objects = self.objects.iter().map(|name| self.object(name)).collect::<Result<Vec<_>, _>>()?;
        let Plan { tasks, mut problems } = self.plan(&objects)?;
        if !self.keep_going {
            problems.none_or_error()?;
        }
        let jobs = usize::from(self.jobs);
        let runtime = self.models.runtime_for(jobs)?;
        let library = if self.detector { Some(self.models.library()?) } else { None };
        let setup = Setup { objects: &objects, runtime: &runtime, library };
        let progress = ProgressBar::new(tasks.len() as u64).with_message(self.objects.join(", "));
        let stop_early = !self.keep_going;
        let results = in_parallel(
            &tasks,
            jobs,
            stop_early,
            || setup.scorer(),
            |scorer, task| {
                let result = scorer.score(task);
                progress.inc(1);
                result
            },
        )?;
        progress.finish_and_clear();
        let mut errors = vec![Vec::new(); objects.len()];
        for result in results {
            match result {
                Ok(scored) => scored.into_iter().for_each(|(object, error)| errors[object].push(error)),
                Err(reason) => problems.push(reason),
            }
        }
        if !self.keep_going {
            problems.none_or_error()?;
        }
        self.all_seen(|object| !errors[object].is_empty()).inspect_err(|_| problems.report())?;
        println!(
            "| object | views | ADD(-S) % | Proj-5 % | 5°5cm % | rotation, median (deg) | translation, median (mm) |"
        );
        println!("|---|---|---|---|---|---|---|");
        for (object, errors) in objects.iter().zip(&errors) {
            print_row(&object.model.manifest.name, &Score::of(errors, &object.mesh));
        }
        problems.report();
        Ok(())
    }

    fn visible(&self) -> RangeInclusive<f64> {
        self.min_visible..=self.max_visible
    }

    fn object(&self, name: &str) -> Result<Object, Box<dyn Error>> {
        let model = ObjectModel::load(&self.models.models, name)?;
        let meshes = self.meshes.as_deref().ok_or("--meshes is missing")?;
        let mesh = ObjectMesh::read(meshes, model.manifest.obj_id)?;
        let offset = if self.detector {
            None
        } else {
            let reference = References::read(&self.models.reference, &model)?;
            Some(
                reference
                    .ok_or_else(|| format!("object {name:?} is not calibrated; run `posed calibrate {name}`"))?
                    .offset,
            )
        };
        Ok(Object { model, mesh, offset })
    }

    fn plan(&self, objects: &[Object]) -> Result<Plan, Box<dyn Error>> {
        let targets = self.targets.as_deref().map(Targets::read).transpose()?;
        let obj_ids: Vec<_> = objects.iter().map(|object| object.model.manifest.obj_id).collect();
        let selection = Selection { obj_ids: &obj_ids, visible: self.visible(), targets: targets.as_ref() };
        let plan = Plan::of(&self.split, &self.dataset.options()?, &selection)?;
        if self.keep_going || plan.problems.is_empty() {
            let planned = |object| plan.tasks.iter().flat_map(|task| &task.instances).any(|one| one.object == object);
            self.all_seen(planned).inspect_err(|_| plan.problems.report())?;
        }
        Ok(plan)
    }

    /// An error if there is an object without any view.
    fn all_seen(&self, is_seen: impl Fn(usize) -> bool) -> Result<(), String> {
        let unseen = (0..).zip(&self.objects).find(|(place, _)| !is_seen(*place));
        unseen.map_or(Ok(()), |(_, name)| {
            Err(format!("{}: no view of {name} lies within --min-visible and --max-visible", self.split.display()))
        })
    }
}

fn print_row(name: &str, score: &Score) {
    println!(
        "| {name} | {} | {:.1} | {:.1} | {:.1} | {:.2} | {:.1} |",
        score.views,
        100.0 * score.add,
        100.0 * score.proj5,
        100.0 * score.deg5_cm5,
        score.median_rotation_deg,
        1e3 * score.median_translation_m,
    );
}
