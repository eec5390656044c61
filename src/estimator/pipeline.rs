use std::sync::Arc;
use std::time::Duration;

use fast_image_resize::Resizer;
use image::RgbImage;

use super::answer::{Estimate, EstimateError, MeasureError, ObjectPose, Selection, Timings};
use super::cores::Cores;
use super::detect::Wanted;
use super::doubts;
use super::expected::{Expected, Found, look_at};
use super::frame::Frame;
use super::hints::Outcome;
use super::job::Located;
use super::keypoints;
use super::look::Eyes;
use super::objects::{Scene, Solved, Sought, solve_all};
use super::twins::leave_out_twins;
use super::update::{Update, warm_up};
use super::watchdog::Activity;
use crate::model::{Backend, Catalogue, Library, Networks, ObjectModel, References, RuntimeError};
use crate::vision::BoundingBox;
use posed_core::geometry::Camera;
use posed_core::pnp::Status;

/// The whole pipeline on one thread: it owns its networks.
pub struct Estimator {
    catalogue: Arc<Catalogue>,
    networks: Networks,
    resizer: Resizer,
    /// For whoever watches: which network runs.
    pub(super) activity: Arc<Activity>,
    /// Idle ones look at objects, too.
    pub(super) cores: Arc<Cores>,
}

/// An image on its way through the stages.
struct Progress {
    camera: Camera,
    found: Vec<Found>,
    /// Whether detectors looked, or the caller gave boxes.
    looked: bool,
    truncated: bool,
    /// Objects that were seen where another one was seen more clearly.
    covered: Vec<usize>,
    poses: Vec<ObjectPose>,
    timings: Timings,
}

impl Estimator {
    /// Makes a library's networks.
    ///
    /// # Errors
    /// When one of them cannot be run.
    pub fn new(
        library: Arc<Library>,
        references: Arc<References>,
        backend: &dyn Backend,
    ) -> Result<Self, RuntimeError> {
        Self::of(Arc::new(Catalogue { library, references }), backend)
    }

    /// As [`Estimator::new`].
    ///
    /// # Errors
    /// As there.
    pub fn of(catalogue: Arc<Catalogue>, backend: &dyn Backend) -> Result<Self, RuntimeError> {
        let networks = Networks::load(&catalogue.library, backend)?;
        Ok(Self {
            catalogue,
            networks,
            resizer: Resizer::new(),
            activity: Arc::default(),
            cores: Arc::new(Cores::new(0)),
        })
    }

    /// Goes on with another catalogue. One that is older than its own changes nothing: it has been loaded anew meanwhile.
    pub(super) fn adopt(&mut self, update: Update) {
        let Update { catalogue, networks } = update;
        if catalogue.library.generation() <= self.catalogue.library.generation() {
            return;
        }
        let none = Networks { detectors: Vec::new(), keypoints: Vec::new() };
        let old = std::mem::replace(&mut self.networks, none);
        self.networks = old.renewed(&self.catalogue.library, &catalogue.library, networks);
        self.catalogue = catalogue;
    }

    /// Finds all calibrated objects in one image, the most trusted poses first.
    ///
    /// # Errors
    /// When the camera belongs to another image, or a network fails.
    pub fn estimate(&mut self, image: &RgbImage, camera: &Camera) -> Result<Estimate, EstimateError> {
        self.estimate_frame(&Frame::new(image, camera))
    }

    /// As [`Estimator::estimate`], with what the frame asks for.
    ///
    /// # Errors
    /// As there.
    pub fn estimate_frame(&mut self, frame: &Frame<'_>) -> Result<Estimate, EstimateError> {
        // One frame, one answer.
        self.estimate_all(std::slice::from_ref(frame)).swap_remove(0)
    }

    /// Answers several images, their crops through each keypoint net together. One answer for each frame, in order; a
    /// frame's failure is its own.
    pub fn estimate_all(&mut self, frames: &[Frame<'_>]) -> Vec<Result<Estimate, EstimateError>> {
        let mut progress: Vec<Result<Progress, EstimateError>> =
            frames.iter().map(|frame| self.look_for_objects(frame, &self.wanted(frame.selection))).collect();
        self.solve_objects(frames, &mut progress);
        let catalogue = Arc::clone(&self.catalogue);
        let answers = frames.iter().zip(progress);
        answers.map(|(frame, progress)| progress.map(|progress| progress.finish(frame, &catalogue))).collect()
    }

    /// Solves one object's virtual keypoints, scaled, in a reference image (`camera_from_keypoints`): within a box, or within
    /// the only one that the detector sees.
    ///
    /// # Errors
    /// [`MeasureError`] says what the image lacks.
    pub fn measure(
        &mut self,
        object: &str,
        image: &RgbImage,
        camera: &Camera,
        region: Option<BoundingBox>,
    ) -> Result<Located, MeasureError> {
        let library = Arc::clone(&self.catalogue.library);
        let place = library.place_of(object);
        let found = place.and_then(|place| Some((place, library.objects[place].as_ref()?)));
        let (index, model) = found.ok_or_else(|| MeasureError::UnknownObject(object.into()))?;
        let camera = &camera.for_image(image.width(), image.height()).map_err(EstimateError::from)?;
        doubts::fit_to_measure(image, camera)?;
        let whole = BoundingBox { x: 0.0, y: 0.0, width: image.width().into(), height: image.height().into() };
        let region = match region {
            Some(region) if region.overlap(&whole) > 0.0 => region,
            Some(region) => return Err(MeasureError::BoxOutside(region.into())),
            None if library.detector_of(index).is_none() => return Err(MeasureError::NoLabel),
            None => {
                let objects = (0..library.objects.len()).map(|place| place == index).collect();
                let wanted = Wanted { objects, least_score: 0.0 };
                the_only_box(&self.look_for_objects(&Frame::new(image, camera), &wanted)?.found, index)?
            }
        };
        let network = self.networks.keypoints[index].as_mut();
        let network = network.ok_or_else(|| MeasureError::UnknownObject(object.into()))?;
        let _running = self.activity.runs(&format!("the keypoint net of object {object}"));
        let manifest = &model.manifest;
        let found = keypoints::locate_within(manifest, network, &mut self.resizer, image, &region)?;
        let solution = keypoints::solve_judged(manifest, &found, image, &region, camera)?;
        Ok(Located { region, prediction: found, solution })
    }

    /// Runs every network once: the first run of a session allocates, and a network that cannot run is found before
    /// anybody waits for it.
    ///
    /// # Errors
    /// When a network fails.
    pub fn warm_up(&mut self) -> Result<(), EstimateError> {
        let Networks { detectors, keypoints } = &mut self.networks;
        let library = &self.catalogue.library;
        let detectors = library.detectors.iter().zip(detectors.iter_mut());
        let keypoints = library.objects.iter().zip(keypoints).filter_map(|(o, net)| o.as_deref().zip(net.as_mut()));
        warm_up(detectors.map(|(looking, network)| (looking, network.as_mut())), keypoints)
    }

    /// Of the calibrated objects those that are selected.
    fn wanted(&self, selection: &Selection) -> Wanted {
        let Catalogue { library, references } = &*self.catalogue;
        let wanted = |model: &Option<Arc<ObjectModel>>| {
            let name = model.as_ref().map(|model| model.manifest.name.as_str());
            name.is_some_and(|name| selection.wants(name) && references.get(name).is_some())
        };
        // Detections with a lower score have no pose that is wanted. A probability is not bound by the score.
        let states_probability =
            |model: &Arc<ObjectModel>| model.manifest.trust.as_ref().is_some_and(|trust| trust.probability.is_some());
        let by_score = !library.known().any(states_probability);
        let least_score = if by_score { selection.min_confidence } else { 0.0 };
        Wanted { objects: library.objects.iter().map(wanted).collect(), least_score }
    }

    fn look_for_objects(&mut self, frame: &Frame<'_>, wanted: &Wanted) -> Result<Progress, EstimateError> {
        (frame.abandoned)()?;
        let (width, height) = frame.image.dimensions();
        let camera = if frame.selection.allow_resize {
            frame.camera.for_resized(width, height)?
        } else {
            frame.camera.for_image(width, height).map_err(EstimateError::OtherSize)?
        };
        let guide = frame.guide.filter(|guide| guide.generation == self.catalogue.library.generation());
        let expected = guide.map_or(&[][..], |guide| &guide.expected);
        let library = &self.catalogue.library;
        let place = |one: &Expected| {
            let model = library.objects.get(one.object)?.as_ref().filter(|_| wanted.object(one.object))?;
            one.found(&model.manifest, &camera, (width, height))
        };
        let expected: Vec<Found> = expected.iter().filter_map(place).collect();
        let boxes = frame.selection.boxes.as_deref();
        let looked = boxes.is_some() || guide.is_none_or(|guide| guide.detect);
        let seen = if looked {
            let detectors = &mut self.networks.detectors[..];
            let mut eyes = Eyes { library, detectors, resizer: &mut self.resizer, activity: &self.activity };
            Some(eyes.look(frame.image, boxes, wanted)?)
        } else {
            None
        };
        let least_score = |object: usize| library.least_score(object).max(wanted.least_score);
        let timings =
            Timings { detect: seen.as_ref().map_or(Duration::ZERO, |seen| seen.elapsed), ..Timings::default() };
        let truncated = seen.as_ref().is_some_and(|seen| seen.truncated);
        let (detections, covered) = seen.map(|seen| (seen.detections, seen.covered)).unzip();
        let found = look_at(expected, detections, least_score);
        let covered = covered.unwrap_or_default();
        Ok(Progress { camera, found, looked, truncated, covered, poses: Vec::new(), timings })
    }

    /// The poses of all objects in all frames.
    fn solve_objects(&mut self, frames: &[Frame<'_>], progress: &mut [Result<Progress, EstimateError>]) {
        let catalogue = Arc::clone(&self.catalogue);
        let mut scenes: Vec<Scene<'_>> = Vec::with_capacity(frames.len());
        for (place, (frame, progress)) in frames.iter().zip(&*progress).enumerate() {
            if let Ok(Progress { camera, found, .. }) = progress {
                scenes.push(Scene { place, frame, camera, found });
            }
        }
        let is_shown = |index: usize| scenes.iter().flat_map(|scene| scene.found).any(|f| f.detection.object == index);
        let calibrated = |model: &Arc<ObjectModel>| catalogue.references.get(&model.manifest.name);
        let objects =
            catalogue.library.objects.iter().map(|model| model.as_ref().zip(model.as_ref().and_then(calibrated)));
        let objects: Vec<_> = objects.collect();
        let networks = objects.iter().zip(&mut self.networks.keypoints).enumerate();
        let sought = networks.filter_map(|(index, (object, network))| {
            let ((model, in_force), network) = object.as_ref().zip(network.as_mut()).filter(|_| is_shown(index))?;
            Some(Sought { index, model, offset: &in_force.reference.offset, network })
        });
        let solved = solve_all(sought.collect(), &scenes, &self.cores, &mut self.resizer, &self.activity);
        for Solved { place, pose, keypoints, pnp, .. } in solved {
            let Ok(of_frame) = &mut progress[place] else { continue };
            of_frame.timings.keypoints += keypoints;
            of_frame.timings.pnp += pnp;
            match pose {
                Ok(pose) => of_frame.poses.push(pose),
                Err(error) => progress[place] = Err(error),
            }
        }
    }
}

fn the_only_box(found: &[Found], object: usize) -> Result<BoundingBox, MeasureError> {
    let mut boxes = found.iter().map(|one| one.detection).filter(|d| d.object == object).map(|d| d.bounding_box);
    match (boxes.next(), boxes.next()) {
        (Some(region), None) => Ok(region),
        (None, _) => Err(MeasureError::NotSeen),
        (Some(_), Some(_)) => Err(MeasureError::SeveralSeen),
    }
}

/// At most so many of each object: those that are expected first, since who follows one would lose it, then the most trusted.
fn limit_instances(poses: &mut Vec<ObjectPose>, limit: usize) {
    let mut left: Vec<usize> = (0..poses.len()).collect();
    left.sort_by_key(|at| poses[*at].track.is_none());
    let mut kept = vec![false; poses.len()];
    let mut seen: Vec<usize> = Vec::new();
    for at in left {
        let object = poses[at].detection.object;
        seen.push(object);
        kept[at] = seen.iter().filter(|other| **other == object).count() <= limit;
    }
    let mut kept = kept.into_iter();
    poses.retain(|_| kept.next().unwrap_or_default());
}

impl Progress {
    /// The poses that were asked for, the most trusted first.
    fn finish(self, frame: &Frame<'_>, catalogue: &Arc<Catalogue>) -> Estimate {
        let Self { camera, mut poses, truncated, timings, looked, covered, .. } = self;
        if !poses.is_empty() {
            for doubt in doubts::of_image(frame.image, &camera) {
                for pose in &mut poses {
                    pose.verdict.object(doubt, Status::LowConfidence);
                }
            }
        }
        let selection = frame.selection;
        poses.sort_by(|a, b| {
            let by_score = || b.detection.score.total_cmp(&a.detection.score);
            let by_confidence = || b.confidence().total_cmp(&a.confidence());
            a.verdict.status.cmp(&b.verdict.status).then_with(by_confidence).then_with(by_score)
        });
        leave_out_twins(&mut poses, &catalogue.library);
        let found: Vec<usize> = poses.iter().map(|pose| pose.detection.object).collect();
        poses.retain(|pose| pose.confidence() >= selection.min_confidence);
        if let Some(limit) = selection.max_instances {
            limit_instances(&mut poses, limit);
        }
        let (width, height) = frame.image.dimensions();
        let camera_scaled_from = frame.camera.size().filter(|size| *size != (width, height));
        let outcome = Outcome { selection, catalogue, looked, covered: &covered, found: &found, poses: &poses };
        let hints = outcome.hints();
        let catalogue = Arc::clone(catalogue);
        Estimate { width, height, poses, camera, camera_scaled_from, truncated, hints, timings, catalogue }
    }
}
