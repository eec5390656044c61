//! Where the answers come from that are scored: networks, or a file.

use std::collections::{BTreeMap, BTreeSet};
use std::sync::Arc;
use std::time::Instant;

use super::plan::Task;
use crate::estimator::{Estimator, KeypointSolver, ObjectPose};
use crate::evaluation::{Answer, DetectedBox, PoseResult};
use crate::model::{Library, ObjectModel, References, Runtime};
use crate::vision::{DecodeOptions, read_image};
use posed_core::calibration::Offset;
use posed_core::pnp::Status;

/// An object whose boxes are given.
pub(super) struct Object {
    pub(super) model: ObjectModel,
    pub(super) offset: Offset,
}

/// What all workers share.
pub(super) enum Source {
    /// Each object's network, in the true boxes.
    Boxes(Vec<Object>, Runtime),
    /// Detector and networks. Objects by name.
    Pipeline(Vec<String>, Runtime, Arc<Library>, Arc<References>),
    /// Poses that some method wrote down.
    File(FileAnswers),
}

/// A file of results, by scene and image.
pub(super) struct FileAnswers {
    by_image: BTreeMap<(u32, u32), Vec<FileAnswer>>,
    others: usize,
}

/// A line of a file of results.
pub(super) struct FileAnswer {
    object: usize,
    answer: Answer,
    time_s: f64,
}

/// One worker's networks.
pub(super) enum Answerer<'a> {
    Boxes(&'a [Object], Vec<KeypointSolver<'a>>),
    Pipeline(&'a [String], Box<Estimator>),
    File(&'a FileAnswers),
}

/// What was said of one image.
pub(super) struct Said {
    /// One for each instance that counts, in their order; empty where it is not known which instance an answer means.
    pub(super) of_instances: Vec<Option<Answer>>,
    /// Object and answer, wherever in the image.
    pub(super) anywhere: Vec<(usize, Answer)>,
    /// Whether these have boxes, to tell which instances they mean.
    pub(super) by_detector: bool,
    /// Of the image, pixels.
    pub(super) width_px: u32,
    /// For the whole image, without reading it, seconds; -1 if it is not known.
    pub(super) time_s: f64,
}

impl FileAnswers {
    /// How many lines are of images that were scored, and how many are not, or are of other objects.
    pub(super) fn used(&self, scored: &BTreeSet<(u32, u32)>) -> (usize, usize) {
        let lines = |used: bool| -> usize {
            let images = self.by_image.iter().filter(|(image, _)| scored.contains(image) == used);
            images.map(|(_, lines)| lines.len()).sum()
        };
        (lines(true), lines(false) + self.others)
    }
}

/// One worker's pipeline.
pub(super) fn new_estimator(
    library: &Arc<Library>,
    references: &Arc<References>,
    runtime: &Runtime,
) -> Result<Estimator, String> {
    Estimator::new(Arc::clone(library), Arc::clone(references), runtime).map_err(|error| error.to_string())
}

/// A network for each object.
pub(super) fn solvers<'a>(objects: &'a [Object], runtime: &Runtime) -> Result<Vec<KeypointSolver<'a>>, String> {
    let solvers = objects.iter().map(|object| KeypointSolver::new(&object.model, runtime));
    solvers.collect::<Result<_, _>>().map_err(|error| error.to_string())
}

impl Source {
    pub(super) fn file(mut results: Vec<PoseResult>, obj_ids: &[u32]) -> Self {
        // The surest first: of several poses it chooses first which instance it means.
        results.sort_by(|a, b| b.score.total_cmp(&a.score));
        let (mut by_image, mut others) = (BTreeMap::<_, Vec<_>>::new(), 0);
        for result in results {
            let Some(object) = obj_ids.iter().position(|obj_id| *obj_id == result.obj_id) else {
                others += 1;
                continue;
            };
            let answer = Answer {
                pose: Some(result.camera_from_object),
                alternatives: Vec::new(),
                covariance: None,
                image_covariance: None,
                evidence: None,
                confidence: result.score,
                status: Status::Ok,
                reasons: Vec::new(),
                detection: None,
            };
            let answer = FileAnswer { object, answer, time_s: result.time_s };
            by_image.entry((result.scene_id, result.image_id)).or_default().push(answer);
        }
        Self::File(FileAnswers { by_image, others })
    }

    pub(super) fn answerer(&self) -> Result<Answerer<'_>, String> {
        match self {
            Self::Boxes(objects, runtime) => Ok(Answerer::Boxes(objects, solvers(objects, runtime)?)),
            Self::Pipeline(names, runtime, library, references) => {
                Ok(Answerer::Pipeline(names, Box::new(new_estimator(library, references, runtime)?)))
            }
            Self::File(results) => Ok(Answerer::File(results)),
        }
    }
}

impl Answerer<'_> {
    /// # Errors
    /// In words that name the image.
    pub(super) fn answer(&mut self, task: &Task) -> Result<Said, String> {
        let wrong = |error: &dyn std::fmt::Display| format!("{}: {error}", task.image.display());
        let read = || read_image(&task.image, &DecodeOptions::default()).map_err(|error| wrong(&error));
        match self {
            Self::Boxes(objects, solvers) => {
                let image = read()?;
                let start = Instant::now();
                let mut of_instances = Vec::new();
                for instance in task.instances.iter().filter(|instance| instance.counts) {
                    let (solver, object) = (&mut solvers[instance.object], &objects[instance.object]);
                    let found = solver.object_pose(&image, &instance.region, &task.camera, &object.offset);
                    let found = found.map_err(|error| wrong(&error))?;
                    of_instances.push(Some(Answer { detection: None, ..answer(&found) }));
                }
                let time_s = start.elapsed().as_secs_f64();
                Ok(Said { of_instances, anywhere: Vec::new(), by_detector: false, width_px: image.width(), time_s })
            }
            Self::Pipeline(names, estimator) => {
                let image = read()?;
                let start = Instant::now();
                let found = estimator.estimate(&image, &task.camera).map_err(|error| wrong(&error))?;
                let time_s = start.elapsed().as_secs_f64();
                let object =
                    |pose: &ObjectPose| Some((names.iter().position(|name| *name == pose.object)?, answer(pose)));
                let anywhere = found.poses.iter().filter_map(object).collect();
                Ok(Said { of_instances: Vec::new(), anywhere, by_detector: true, width_px: image.width(), time_s })
            }
            Self::File(results) => {
                let (width_px, _) = image::image_dimensions(&task.image).map_err(|error| wrong(&error))?;
                let lines = task.key().and_then(|key| results.by_image.get(&key)).map_or(&[][..], Vec::as_slice);
                let anywhere = lines.iter().map(|line| (line.object, line.answer.clone())).collect();
                let time_s = lines.iter().map(|line| line.time_s).fold(-1.0, f64::max);
                Ok(Said { of_instances: Vec::new(), anywhere, by_detector: false, width_px, time_s })
            }
        }
    }
}

fn answer(found: &ObjectPose) -> Answer {
    Answer {
        pose: found.pose.as_ref().map(|solved| solved.camera_from_object),
        alternatives: found.pose.iter().flat_map(|solved| &solved.alternatives).map(|(pose, _)| *pose).collect(),
        covariance: found.pose.as_ref().map(|solved| solved.covariance),
        image_covariance: found.pose.as_ref().map(|solved| solved.image_covariance),
        evidence: found.pose.as_ref().map(|solved| solved.evidence),
        confidence: found.confidence(),
        status: found.verdict.status,
        reasons: found.verdict.reasons.iter().map(|reason| reason.to_string()).collect(),
        detection: Some(DetectedBox { region: found.detection.bounding_box, score: found.detection.score }),
    }
}
