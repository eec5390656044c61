use nalgebra::Vector3;

use posed_core::geometry::{Covariance6, Pose};

use super::answers::{Answerer, Said};
use super::plan::{Instance, Task, visible_fraction};
use crate::evaluation::{
    Answer, BoxResult, Deviation, FoundBox, Matching, ModelPoints, Place, PoseNees, PoseResult, Record, Scored,
    TrueBox, Unmatched, assign,
};

/// Intersection over union with the true box from which on a detection is of this object.
const SAME_PLACE_OVERLAP: f64 = 0.5;

/// All that is kept of one image.
pub(super) struct ImageResult {
    /// Place of the object among the evaluated ones.
    pub(super) records: Vec<(usize, Record)>,
    /// Answers that mean none of the instances in the image.
    pub(super) unmatched: Vec<(usize, Unmatched)>,
    /// Of each object, if there was a detector.
    pub(super) matchings: Vec<Matching>,
    pub(super) poses: Vec<PoseResult>,
    pub(super) boxes: Vec<BoxResult>,
}

/// What is known of one evaluated object.
pub(super) struct Known {
    pub(super) obj_id: u32,
    pub(super) points: ModelPoints,
    /// Of the box about its vertices, metres.
    pub(super) corners: [Vector3<f64>; 8],
}

/// Scores the answers to one image.
///
/// # Errors
/// In words that name the image.
pub(super) fn score(known: &[Known], answerer: &mut Answerer<'_>, task: &Task) -> Result<ImageResult, String> {
    let said = answerer.answer(task)?;
    let (poses, boxes) = lines(known, task, &said);
    let (matchings, meant) =
        if said.by_detector { by_box(known.len(), task, &said) } else { (Vec::new(), by_pose(known, task, &said)) };
    let mut result = ImageResult { records: Vec::new(), unmatched: Vec::new(), matchings, poses, boxes };
    let Said { mut of_instances, anywhere, width_px, .. } = said;
    of_instances.resize(task.instances.len(), None);
    for ((object, answer), instance) in anywhere.into_iter().zip(meant) {
        if let Some(instance) = instance {
            of_instances[instance] = Some(answer);
        } else {
            let (scene, image_id) = (task.scene.clone(), task.image_id);
            result.unmatched.push((object, Unmatched { scene, image_id, answer }));
        }
    }
    for (instance, answer) in task.instances.iter().zip(of_instances).filter(|(instance, _)| instance.counts) {
        let record = Record {
            place: Place { scene: task.scene.clone(), image_id: task.image_id, instance: instance.truth.place },
            visible_fraction: visible_fraction(&instance.truth),
            camera_from_object: instance.truth.camera_from_object,
            region: instance.region,
            image_width_px: width_px,
            said: answer.map(|answer| scored(known, task, instance, answer)),
        };
        result.records.push((instance.object, record));
    }
    Ok(result)
}

fn scored(known: &[Known], task: &Task, instance: &Instance, answer: Answer) -> Scored {
    let points = &known[instance.object].points;
    let truth = &instance.truth.camera_from_object;
    let nees =
        |covariance: &Option<Covariance6>| PoseNees::new(points, answer.pose.as_ref()?, covariance.as_ref()?, truth);
    let (nees, image_nees) = (nees(&answer.covariance), nees(&answer.image_covariance));
    let of_alternatives = answer.alternatives.iter().map(|pose| deviation(known, task, instance, pose)).collect();
    let deviation = answer.pose.map(|pose| deviation(known, task, instance, &pose));
    Scored { answer, deviation, of_alternatives, nees, image_nees }
}

fn deviation(known: &[Known], task: &Task, instance: &Instance, pose: &Pose) -> Deviation {
    let points = &known[instance.object].points;
    Deviation::new(points, &task.camera, pose, &instance.truth.camera_from_object)
}

/// What the detector found of each object, and the instance that each answer means.
fn by_box(objects: usize, task: &Task, said: &Said) -> (Vec<Matching>, Vec<Option<usize>>) {
    let mut meant = vec![None; said.anywhere.len()];
    let of_object = |object: usize| {
        let (answers, found): (Vec<_>, Vec<_>) = (0..)
            .zip(&said.anywhere)
            .filter(|(_, (of, _))| *of == object)
            .filter_map(|(place, (_, answer))| {
                let seen = answer.detection?;
                Some((place, FoundBox { object, score: seen.score, bounding_box: seen.region }))
            })
            .unzip();
        let (instances, truths): (Vec<_>, Vec<_>) = (0..)
            .zip(&task.instances)
            .filter(|(_, instance)| instance.object == object)
            .map(|(place, instance)| {
                (place, TrueBox { object, bounding_box: instance.region, ignored: !instance.counts })
            })
            .unzip();
        let matching = Matching::new(&found, &truths, SAME_PLACE_OVERLAP);
        for (answer, truth) in answers.into_iter().zip(&matching.of_found) {
            let answer: usize = answer;
            meant[answer] = truth.map(|truth| instances[truth]);
        }
        matching
    };
    let matchings = (0..objects).map(of_object).collect();
    (matchings, meant)
}

/// The instance that each answer of a file of results means, which has no boxes: the one that it is nearest to.
///
/// Of each object as many poses as there are instances, the surest ones: more are not asked for (BOP's task of localisation).
fn by_pose(known: &[Known], task: &Task, said: &Said) -> Vec<Option<usize>> {
    let mut left: Vec<usize> = (0..known.len()).map(|object| instances_of(task, object)).collect();
    let asked_for: Vec<bool> = said
        .anywhere
        .iter()
        .map(|(object, _)| {
            let asked_for = left[*object] > 0;
            left[*object] = left[*object].saturating_sub(1);
            asked_for
        })
        .collect();
    assign(said.anywhere.len(), task.instances.len(), |place, instance| {
        let (object, answer) = &said.anywhere[place];
        let instance = &task.instances[instance];
        let off = |pose: Pose| deviation(known, task, instance, &pose).add_m;
        let meant = asked_for[place] && instance.object == *object;
        answer.pose.filter(|_| meant).map(off)
    })
}

fn instances_of(task: &Task, object: usize) -> usize {
    task.instances.iter().filter(|instance| instance.object == object).count()
}

/// The image's lines in files of results. A scene without a number has none there.
fn lines(known: &[Known], task: &Task, said: &Said) -> (Vec<PoseResult>, Vec<BoxResult>) {
    let (mut poses, mut boxes) = (Vec::new(), Vec::new());
    let Some(scene_id) = task.scene_id else { return (poses, boxes) };
    let (image_id, time_s) = (task.image_id, said.time_s);
    let counting = task.instances.iter().filter(|instance| instance.counts).map(|instance| instance.object);
    let in_boxes = counting.zip(&said.of_instances).filter_map(|(object, answer)| Some((object, answer.as_ref()?)));
    let anywhere = said.anywhere.iter().map(|(object, answer)| (*object, answer));
    for (object, answer) in in_boxes.chain(anywhere) {
        let obj_id = known[object].obj_id;
        if let Some(camera_from_object) = answer.pose {
            let score = answer.confidence;
            poses.push(PoseResult { scene_id, image_id, obj_id, score, camera_from_object, time_s });
        }
        if let Some(seen) = answer.detection {
            boxes.push(BoxResult::new(scene_id, image_id, obj_id, seen.region, seen.score, time_s));
        }
    }
    (poses, boxes)
}
