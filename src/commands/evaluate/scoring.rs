use std::collections::BTreeSet;
use std::error::Error;
use std::path::{Path, PathBuf};

use super::answers::{Object, Source, solvers};
use super::options::Asked;
use super::output::Written;
use super::plan::{Plan, Selection, Task};
use super::pool::in_parallel;
use super::problems::Problems;
use super::study::{self, SolvedView, StudyRow};
use super::work::{ImageResult, Known, score};
use crate::evaluation::{Boxes, ModelPoints, ObjectMesh, ObjectRecords, Targets, read_poses};
use crate::model::{ObjectModel, References};
use crate::vision::box_corners;
use posed_core::calibration::Offset;

/// Everything that is loaded before the first image.
pub(super) struct Scoring<'a> {
    asked: &'a Asked,
    targets: Option<Targets>,
    pub(super) known: Vec<Known>,
    source: Source,
    /// Whether files for the BOP toolkit are made.
    writes_results: bool,
}

/// What became of one split.
pub(super) struct ScoredSplit {
    pub(super) path: PathBuf,
    pub(super) tasks: Vec<Task>,
    /// One for each object, in their order.
    pub(super) objects: Vec<ObjectRecords>,
    pub(super) written: Written,
    pub(super) problems: Problems,
}

impl<'a> Scoring<'a> {
    pub(super) fn new(asked: &'a Asked, writes_results: bool) -> Result<Self, Box<dyn Error>> {
        let targets = asked.splits.targets.as_deref().map(Targets::read).transpose()?;
        let load = |name: &String| ObjectModel::load(&asked.models.models, name);
        let models = asked.objects.iter().map(load).collect::<Result<Vec<_>, _>>()?;
        let known = models.iter().map(|model| known(asked, model)).collect::<Result<Vec<_>, _>>()?;
        let source = source(asked, models, &known)?;
        Ok(Self { asked, targets, known, source, writes_results })
    }

    /// Answers all images of a split, and scores the answers.
    pub(super) fn score(&self, split: &Path) -> Result<ScoredSplit, Box<dyn Error>> {
        let Plan { tasks, mut problems } = self.plan(split)?;
        let answerer = || self.source.answerer();
        let work = &self.asked.work;
        let results = in_parallel(&tasks, work, split.display().to_string(), answerer, |answerer, task| {
            score(&self.known, answerer, task)
        })?;
        let mut objects: Vec<_> = (0..self.known.len()).map(|object| self.no_records(object, split)).collect();
        let mut written = Written::default();
        for result in problems.taken_from(results) {
            add(&mut objects, &mut written, result);
        }
        problems.settle(work)?;
        Ok(ScoredSplit { path: split.into(), tasks, objects, written, problems })
    }

    fn plan(&self, split: &Path) -> Result<Plan, Box<dyn Error>> {
        let asked = self.asked;
        let obj_ids: Vec<_> = self.known.iter().map(|known| known.obj_id).collect();
        let selection = Selection {
            obj_ids: &obj_ids,
            visible: &asked.splits.visible(),
            targets: self.targets.as_ref(),
            empty_images: asked.splits.detector,
            whole: asked.splits.splits.len() == 1,
        };
        let plan = Plan::of(split, &asked.dataset.options()?, &selection)?;
        plan.problems.settle(&asked.work)?;
        let by_number = asked.splits.estimates.is_some() || self.writes_results;
        if let Some(task) = plan.tasks.iter().find(|task| by_number && task.scene_id.is_none()) {
            let (split, scene) = (split.display(), &task.scene);
            return Err(
                format!("{split}: scene folder {scene:?} is no number; files of results name scenes by one").into()
            );
        }
        Ok(plan)
    }

    fn no_records(&self, object: usize, split: &Path) -> ObjectRecords {
        ObjectRecords {
            split: split.display().to_string(),
            object: self.asked.objects[object].clone(),
            diameter_m: self.known[object].points.diameter_m(),
            records: Vec::new(),
            unmatched: Vec::new(),
            matchings: Vec::new(),
        }
    }

    /// Accuracy against the number of references.
    pub(super) fn study(&self, references: &Path) -> Result<Vec<StudyRow>, Box<dyn Error>> {
        let Source::Boxes(objects, runtime) = &self.source else { return Err("the study needs true boxes".into()) };
        let work = &self.asked.work;
        let solve = |split: &Path| -> Result<Vec<SolvedView>, Box<dyn Error>> {
            let Plan { tasks, mut problems } = self.plan(split)?;
            let title = split.display().to_string();
            let solvers = || solvers(objects, runtime);
            let solved = in_parallel(&tasks, work, title, solvers, |solvers, task| study::solve(solvers, task))?;
            let views = problems.taken_from(solved).into_iter().flatten().collect();
            problems.settle(work)?;
            problems.report();
            Ok(views)
        };
        let references = solve(references)?;
        let mut views = Vec::new();
        for split in &self.asked.splits.splits {
            views.extend(solve(split)?);
        }
        let mut rows = Vec::new();
        for (object, (known, Object { model, .. })) in self.known.iter().zip(objects).enumerate() {
            let of_object = |view: &&SolvedView| view.object == object;
            let views: Vec<_> = views.iter().filter(of_object).collect();
            if views.is_empty() {
                return Err(format!("no view of {} can be scored; see --visible", model.manifest.name).into());
            }
            let references: Vec<_> = references.iter().filter(of_object).collect();
            rows.extend(study::study(model, &known.points, &references, &views)?);
        }
        Ok(rows)
    }

    pub(super) fn keeps_going(&self) -> bool {
        self.asked.work.keep_going
    }

    /// An error if there are objects without any view, or a file of results of which no line counts.
    pub(super) fn check_seen(&self, scored: &[ScoredSplit]) -> Result<(), String> {
        let splits = || scored.iter().map(|split| split.path.display().to_string()).collect::<Vec<_>>().join(", ");
        let unseen = |object: &usize| scored.iter().all(|split| split.objects[*object].records.is_empty());
        let names: Vec<_> =
            (0..self.known.len()).filter(unseen).map(|object| self.asked.objects[object].as_str()).collect();
        if !names.is_empty() {
            return Err(format!(
                "{}: no view of {} was scored; see --visible and --targets",
                splits(),
                names.join(", ")
            ));
        }
        if let (Source::File(answers), Some(path)) = (&self.source, &self.asked.splits.estimates) {
            let images: BTreeSet<_> =
                scored.iter().flat_map(|split| split.tasks.iter().filter_map(Task::key)).collect();
            let (used, unused) = answers.used(&images);
            if used == 0 {
                return Err(format!(
                    "{}: none of its {unused} lines is of these objects in {}",
                    path.display(),
                    splits()
                ));
            }
            if unused > 0 {
                eprintln!("{}: {unused} lines are of other objects or images", path.display());
            }
        }
        Ok(())
    }
}

pub(super) fn known(asked: &Asked, model: &ObjectModel) -> Result<Known, Box<dyn Error>> {
    let folder = asked.splits.meshes.as_deref().ok_or("--meshes is missing")?;
    let mesh = ObjectMesh::read(folder, model.manifest.obj_id)?;
    let points = ModelPoints::new(&mesh)?;
    Ok(Known { obj_id: model.manifest.obj_id, points, corners: box_corners(&mesh.vertices) })
}

fn source(asked: &Asked, models: Vec<ObjectModel>, known: &[Known]) -> Result<Source, Box<dyn Error>> {
    let runtime = || asked.models.runtime_for(usize::from(asked.work.jobs));
    match (asked.splits.boxes(), &asked.splits.estimates) {
        (Boxes::File, Some(path)) => {
            let obj_ids: Vec<_> = known.iter().map(|known| known.obj_id).collect();
            Ok(Source::file(read_poses(path)?, &obj_ids))
        }
        (Boxes::Detector, _) => {
            let (library, references) = asked.models.library()?;
            Ok(Source::Pipeline(asked.objects.clone(), runtime()?, library, references))
        }
        _ => {
            let object = |model: ObjectModel| {
                let offset = offset(asked, &model)?;
                Ok::<_, Box<dyn Error>>(Object { model, offset })
            };
            Ok(Source::Boxes(models.into_iter().map(object).collect::<Result<_, _>>()?, runtime()?))
        }
    }
}

fn offset(asked: &Asked, model: &ObjectModel) -> Result<Offset, Box<dyn Error>> {
    let name = &model.manifest.name;
    let reference = References::read(&asked.models.reference, model)?;
    Ok(reference.ok_or_else(|| format!("object {name:?} is not calibrated; run `posed calibrate {name}`"))?.offset)
}

fn add(objects: &mut [ObjectRecords], written: &mut Written, result: ImageResult) {
    for (object, record) in result.records {
        objects[object].records.push(record);
    }
    for (object, unmatched) in result.unmatched {
        objects[object].unmatched.push(unmatched);
    }
    for (of_object, matching) in objects.iter_mut().zip(result.matchings) {
        of_object.matchings.push(matching);
    }
    written.poses.extend(result.poses);
    written.boxes.extend(result.boxes);
}
