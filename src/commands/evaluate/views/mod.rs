//! Accuracy of poses that several views of a scene agree in.

mod instances;
mod score;
mod spoil;
mod table;

use std::error::Error;
use std::path::Path;

use fastrand::Rng;

use super::answers::new_estimator;
use super::options::{Asked, OutputArgs};
use super::pool::in_parallel;
use super::shots::{Shot, Shots};
use crate::commands::output::print;
use crate::estimator::{Estimate, Frame, PosedCamera, Selection, fuse};
use crate::evaluation::{ModelPoints, ObjectMesh};
use crate::model::Library;
use crate::vision::{DecodeOptions, read_image};
use instances::Instance;
use posed_core::geometry::Covariance6;
use score::{Outcome, Row};

/// The same subsets every time.
const SEED: u64 = 24;

/// What to evaluate.
pub(super) struct SeveralViews<'a> {
    pub(super) asked: &'a Asked,
    pub(super) split: &'a Path,
    pub(super) output: &'a OutputArgs,
}

/// An image with its answer.
struct Answered {
    shot: Shot,
    estimate: Estimate,
}

impl SeveralViews<'_> {
    pub(super) fn run(&self) -> Result<(), Box<dyn Error>> {
        let Asked { objects: names, work, dataset, models, splits, .. } = self.asked;
        let (library, references) = models.library()?;
        let classes = names.iter().map(|name| class(name, &library)).collect::<Result<Vec<_>, _>>()?;
        let meshes = splits.meshes.as_deref().ok_or("--meshes is missing")?;
        let points = |class: &usize| {
            let model = library.objects[*class].as_ref().ok_or("an object has no model")?;
            Ok::<_, Box<dyn Error>>(ModelPoints::new(&ObjectMesh::read(meshes, model.manifest.obj_id)?)?)
        };
        let points = classes.iter().map(points).collect::<Result<Vec<_>, _>>()?;
        let Shots { shots, mut problems, .. } = Shots::of(self.split, &dataset.options()?)?;
        problems.settle(work)?;
        let runtime = models.runtime_for(usize::from(work.jobs))?;
        let selection = Selection { objects: Some(names.clone()), ..Selection::ALL };
        let estimator = || new_estimator(&library, &references, &runtime);
        let results = in_parallel(&shots, work, names.join(", "), estimator, |estimator, shot| {
            let wrong = |error: &dyn std::fmt::Display| format!("{}: {error}", shot.image.display());
            let image = read_image(&shot.image, &DecodeOptions::default()).map_err(|error| wrong(&error))?;
            let frame = Frame { selection: &selection, ..Frame::new(&image, &shot.camera) };
            let estimate = estimator.estimate_frame(&frame).map_err(|error| wrong(&error))?;
            Ok(Answered { shot: shot.clone(), estimate })
        })?;
        let answered = problems.taken_from(results);
        problems.settle(work)?;
        let study = Study { library: &library, answered: &answered };
        let mut rows = Vec::new();
        for count in &splits.views {
            let mut all = Vec::new();
            for ((name, class), points) in names.iter().zip(&classes).zip(&points) {
                let outcomes = study.outcomes(*class, points, *count, self.asked);
                rows.push(Row::of(name, *count, &outcomes));
                all.extend(outcomes);
            }
            if names.len() > 1 {
                rows.push(Row::of("all", *count, &all));
            }
        }
        problems.report();
        self.output.write_json(&rows)?;
        if rows.iter().all(|row| row.poses == 0) {
            return Err("no object is seen by so many views with known camera poses; see --visible".into());
        }
        print(format_args!("{}", table::table(&rows, splits.wrong_views)));
        Ok(())
    }
}

/// All images, answered, from which subsets are drawn.
struct Study<'a> {
    library: &'a Library,
    answered: &'a [Answered],
}

impl Study<'_> {
    fn outcomes(&self, class: usize, points: &ModelPoints, count: usize, asked: &Asked) -> Vec<Outcome> {
        let Some(model) = &self.library.objects[class] else { return Vec::new() };
        let ranges = asked.splits.visible_in_views();
        let shots: Vec<&Shot> = self.answered.iter().map(|one| &one.shot).collect();
        let mut random = Rng::with_seed(SEED + count as u64);
        let mut outcomes = Vec::new();
        for instance in Instance::all_of(&shots, model.manifest.obj_id, &ranges) {
            if instance.views.len() < count {
                continue;
            }
            let draws = if instance.views.len() == count { 1 } else { asked.splits.draws };
            for _ in 0..draws {
                let chosen = random.choose_multiple(instance.views.iter().copied(), count);
                let mut estimates: Vec<Estimate> =
                    chosen.iter().map(|index| self.answered[*index].estimate.clone()).collect();
                let mut wrong = Vec::new();
                for (view, estimate) in estimates.iter_mut().enumerate().take(asked.splits.wrong_views) {
                    if spoil::flip(estimate, class, model, &mut random) {
                        wrong.push(view);
                    }
                }
                let camera = |index: &usize| PosedCamera {
                    world_from_camera: self.answered[*index].shot.world_from_camera,
                    covariance: asked.splits.exact_cameras.then(Covariance6::zeros),
                };
                let cameras: Vec<PosedCamera> = chosen.iter().map(camera).collect();
                let estimates: Vec<&Estimate> = estimates.iter().collect();
                let fused = fuse(&cameras, &estimates);
                outcomes.push(Outcome::of(model, points, &instance.world_from_object, &cameras, &fused, &wrong));
            }
        }
        outcomes
    }
}

fn class(name: &str, library: &Library) -> Result<usize, String> {
    library.place_of(name).ok_or_else(|| format!("object {name:?} has no model"))
}
