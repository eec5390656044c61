use serde::Serialize;

use crate::estimator::{FusedPose, PosedCamera};
use crate::evaluation::{Consistency, ModelPoints, PoseNees};
use crate::model::ObjectModel;
use posed_core::geometry::{Pose, rotated_covariance};
use posed_core::pnp::Status;

/// Correct below this share of the diameter.
const CORRECT: f64 = 0.1;

/// One subset of views, and how far the pose that follows from it is from the truth.
pub(super) struct Outcome {
    status: Option<Status>,
    /// ADD or ADD-S over the diameter, and in metres; infinite without a pose.
    add: f64,
    add_m: f64,
    within_5_5: bool,
    nees: Option<PoseNees>,
    /// Of the views that are wrong on purpose, how many there were, whether they were left out, and whether only they were.
    wrong: usize,
    named: bool,
    named_alone: bool,
}

impl Outcome {
    pub(super) fn of(
        model: &ObjectModel,
        points: &ModelPoints,
        world_from_object: &Pose,
        cameras: &[PosedCamera],
        fused: &[FusedPose],
        wrong: &[usize],
    ) -> Self {
        let diameter_m = points.diameter_m();
        // The most trusted pose about there: what a robot would take.
        let near = |fused: &&FusedPose| {
            let pose = fused.pose.as_ref().filter(|_| fused.object == model.manifest.name);
            pose.is_some_and(|(pose, _)| (pose.translation() - world_from_object.translation()).norm() < diameter_m)
        };
        let missing = Self {
            status: None,
            add: f64::INFINITY,
            add_m: f64::INFINITY,
            within_5_5: false,
            nees: None,
            wrong: wrong.len(),
            named: false,
            named_alone: false,
        };
        let Some(fused) = fused.iter().find(near) else { return missing };
        let Some((pose, covariance)) = &fused.pose else { return missing };
        let add_m = points.average_distance_m(pose, world_from_object);
        let truth = points.symmetries().nearest(world_from_object, pose);
        let used = fused.views.iter().find(|view| view.left_out.is_none());
        let nees = used.and_then(|used| {
            let camera_from_world = cameras[used.view].world_from_camera.inverse();
            let covariance = rotated_covariance(camera_from_world.rotation(), covariance);
            PoseNees::new(points, &(camera_from_world * *pose), &covariance, &(camera_from_world * *world_from_object))
        });
        let left_out: Vec<usize> =
            fused.views.iter().filter(|view| view.left_out.is_some()).map(|view| view.view).collect();
        Self {
            status: Some(fused.verdict.status),
            add: add_m / diameter_m,
            add_m,
            within_5_5: truth.angle_to(pose).to_degrees() < 5.0
                && (truth.translation() - pose.translation()).norm() < 0.05,
            nees,
            wrong: wrong.len(),
            named: wrong.iter().all(|view| left_out.contains(view)),
            named_alone: left_out == wrong,
        }
    }

    fn is_right(&self) -> bool {
        self.add < CORRECT
    }
}

/// What all subsets of so many views of an object say.
#[derive(Debug, Serialize)]
pub(super) struct Row {
    pub(super) object: String,
    pub(super) views: usize,
    /// Subsets.
    pub(super) poses: usize,
    /// Share with ADD(-S) below a tenth of the diameter.
    pub(super) add: f64,
    pub(super) deg5_cm5: f64,
    pub(super) median_add_mm: Option<f64>,
    pub(super) p90_add_mm: Option<f64>,
    /// Share with status `ok`, and of these the share that is wrong.
    pub(super) ok: f64,
    pub(super) ok_wrong: f64,
    /// Of `ok` poses.
    pub(super) nees_mean: Option<f64>,
    pub(super) nees_median: Option<f64>,
    pub(super) within_95: Option<f64>,
    /// Of the subsets with views that are wrong on purpose, those in which these are left out, and those in which no other is.
    pub(super) named: f64,
    pub(super) named_alone: f64,
}

impl Row {
    pub(super) fn of(object: &str, views: usize, outcomes: &[Outcome]) -> Self {
        let share = |holds: &dyn Fn(&Outcome) -> bool, of: &dyn Fn(&Outcome) -> bool| {
            let all = outcomes.iter().filter(|one| of(one)).count();
            outcomes.iter().filter(|one| of(one) && holds(one)).count() as f64 / all.max(1) as f64
        };
        let any = |_: &Outcome| true;
        let is_ok = |one: &Outcome| one.status == Some(Status::Ok);
        let mut errors: Vec<f64> = outcomes.iter().map(|one| 1e3 * one.add_m).collect();
        errors.sort_by(f64::total_cmp);
        let quantile = |percent: usize| {
            let place = (errors.len() * percent).div_ceil(100).checked_sub(1)?;
            errors.get(place).copied().filter(|error| error.is_finite())
        };
        let of_ok: Vec<_> = outcomes.iter().filter(|one| is_ok(one)).map(|one| one.nees).collect();
        let consistency = Consistency::of(&of_ok);
        let pose = consistency.pose.as_ref();
        Self {
            object: object.into(),
            views,
            poses: outcomes.len(),
            add: share(&Outcome::is_right, &any),
            deg5_cm5: share(&|one| one.within_5_5, &any),
            median_add_mm: quantile(50),
            p90_add_mm: quantile(90),
            ok: share(&is_ok, &any),
            ok_wrong: share(&|one| !one.is_right(), &is_ok),
            nees_mean: pose.map(|pose| pose.mean),
            nees_median: pose.map(|pose| pose.median),
            within_95: pose.and_then(crate::evaluation::GroupConsistency::within_95),
            named: share(&|one| one.named, &|one| one.wrong > 0),
            named_alone: share(&|one| one.named_alone, &|one| one.wrong > 0),
        }
    }
}
