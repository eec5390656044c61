//! One object in those views that show it.

use posed_core::calibration::Offset;
use posed_core::geometry::{Camera, Covariance6, Pose};
use posed_core::pnp::Status;
use posed_core::views::{View, ViewsOptions, ViewsSolution, solve_views};

use super::fused::{FusedPose, LeftOut, PosedCamera, ViewShare};
use crate::estimator::answer::{ObjectPose, SolvedPose};
use crate::estimator::gates::is_loose;
use crate::estimator::verdict::{Reason, Verdict};
use crate::model::ObjectModel;

/// So many keypoints of a crop say as much as one whose error is its own: misfits count less by as much. Measured on rendered
/// images before there was any trust, as the factor of the solver's covariances. How large the fused covariance is, is another
/// matter: what a view's keypoints have in common is said by its modes, where trust has measured it.
pub(super) const TEMPERING: f64 = 2.9;
/// Views from within this angle are one view.
const NO_BASELINE_RAD: f64 = std::f64::consts::PI / 180.0;
/// What is known of every view is at least its word against one other's.
const MIN_TRUST: f64 = 0.05;
/// Doubts about an image, which its company does not lift.
const OF_IMAGES: [Reason; 4] = [Reason::GreyImage, Reason::DarkImage, Reason::CameraSuspect, Reason::TooNear];

/// A pose in a view.
#[derive(Clone, Copy)]
pub(super) struct Seen<'a> {
    pub view: usize,
    pub place: usize,
    pub found: &'a ObjectPose,
    pub camera: &'a PosedCamera,
    pub optics: &'a Camera,
    /// Of the image, pixels: a camera need not state it.
    pub size: (u32, u32),
}

/// Poses in several views that are of one object.
pub(super) struct Instance<'a> {
    pub model: &'a ObjectModel,
    pub offset: &'a Offset,
    /// At most one of each view.
    pub seen: Vec<Seen<'a>>,
}

impl Instance<'_> {
    pub(super) fn fused(&self) -> FusedPose {
        let solution = (self.seen.len() > 1).then(|| self.solve()).flatten();
        match solution {
            Some(solution) if solution.view_angle_rad < NO_BASELINE_RAD && used(&solution).count() > 1 => {
                self.best_view(LeftOut::NoBaseline, Some(Reason::WeakBaseline))
            }
            Some(solution) => self.of(&solution),
            None if self.seen.len() > 1 => self.best_view(LeftOut::Contradicts, Some(Reason::ViewsDisagree)),
            None => self.best_view(LeftOut::Contradicts, None),
        }
    }

    fn solve(&self) -> Option<ViewsSolution> {
        let points = self.model.manifest.keypoints_scaled_by(self.offset.keypoints_scale);
        let symmetries = self.model.symmetries.in_frame(&self.offset.object_from_keypoints.inverse());
        // More than one view: each has a pose.
        let views: Vec<View<'_>> = self
            .seen
            .iter()
            .filter_map(|seen| Some((seen, &seen.found.pose.as_ref()?.observed)))
            .map(|(seen, observed)| View {
                camera: seen.optics,
                world_from_camera: seen.camera.world_from_camera,
                camera_covariance: seen.camera.covariance,
                readings: &observed.readings,
                modes: &observed.modes,
                trust: seen.found.confidence().max(MIN_TRUST),
            })
            .collect();
        let options = ViewsOptions { tempering: TEMPERING, ..ViewsOptions::default() };
        solve_views(&points, &views, &symmetries, &options).ok()
    }

    /// What several views agree in.
    fn of(&self, solution: &ViewsSolution) -> FusedPose {
        let (pose, covariance) = self.in_users_frame(&solution.world_from_points, &solution.covariance);
        let shares = self.seen.iter().zip(&solution.views).map(|(seen, fit)| ViewShare {
            view: seen.view,
            place: seen.place,
            left_out: fit.excluded.map(|posed_core::views::Exclusion::Contradicts| LeftOut::Contradicts),
            residual_px: fit.residual_px,
            inliers: fit.inliers,
            camera_from_object: Some(seen.camera.world_from_camera.inverse() * pose),
        });
        let used: Vec<&ObjectPose> = used(solution).map(|index| self.seen[index].found).collect();
        let verdict = self.verdict(solution, &used, &covariance);
        FusedPose {
            object: self.model.manifest.name.clone(),
            verdict,
            pose: Some((pose, covariance)),
            confidence: used.iter().map(|found| found.confidence()).fold(0.0, f64::max),
            views: shares.collect(),
            view_angle_rad: solution.view_angle_rad,
            scale: solution.scale,
            diameter_m: self.model.manifest.diameter_m,
        }
    }

    /// The offset's uncertainty is one error that all views share: it is added once.
    fn in_users_frame(&self, world_from_keypoints: &Pose, covariance: &Covariance6) -> (Pose, Covariance6) {
        let (pose, covariance) = self.offset.apply(world_from_keypoints, covariance);
        self.model.symmetries.canonical_with(&pose, &covariance)
    }

    fn verdict(&self, solution: &ViewsSolution, used: &[&ObjectPose], covariance: &Covariance6) -> Verdict {
        let mut verdict = if let [only] = used { only.verdict } else { Verdict::default() };
        let doubts = solution.doubts;
        for (holds, reason, status) in [
            (doubts.views_disagree, Reason::ViewsDisagree, Status::Ok),
            (doubts.no_majority, Reason::ViewsDisagree, Status::LowConfidence),
            (doubts.ambiguous, Reason::PlanarAmbiguity, Status::Ambiguous),
            (doubts.high_residual, Reason::HighResidual, Status::LowConfidence),
            (doubts.weak_baseline && used.len() > 1, Reason::WeakBaseline, Status::Ok),
            (used.len() == 1, Reason::SingleView, Status::Ok),
            (is_loose(covariance, self.model.manifest.diameter_m), Reason::UncertainPose, Status::LowConfidence),
        ] {
            if holds {
                verdict.object(reason, status);
            }
        }
        for reason in OF_IMAGES {
            if used.iter().all(|found| found.verdict.reasons.contains(reason)) {
                verdict.object(reason, Status::LowConfidence);
            }
        }
        // Views that are all doubtful by themselves may share what is wrong.
        let best = used.iter().min_by_key(|found| found.verdict.status);
        if let Some(best) = best.filter(|best| best.verdict.status > Status::Ambiguous) {
            best.verdict.reasons.iter().for_each(|reason| verdict.object(reason, Status::LowConfidence));
            verdict.status = verdict.status.max(Status::LowConfidence);
        }
        verdict
    }

    /// The view that is trusted most, as it has the object by itself.
    fn best_view(&self, left_out: LeftOut, why: Option<Reason>) -> FusedPose {
        let better = |a: &&Seen<'_>, b: &&Seen<'_>| {
            let by_confidence = || b.found.confidence().total_cmp(&a.found.confidence());
            a.found.verdict.status.cmp(&b.found.verdict.status).then_with(by_confidence)
        };
        // An instance has a view.
        let Some(best) = self.seen.iter().min_by(better) else { return self.nothing() };
        let solved = best.found.pose.as_ref();
        let pose = solved.map(|solved| {
            let (pose, covariance) = solved.in_frame(&best.camera.world_from_camera);
            self.model.symmetries.canonical_with(&pose, &covariance)
        });
        let mut verdict = best.found.verdict;
        verdict.object(Reason::SingleView, Status::Ok);
        if let Some(why) = why {
            verdict.object(why, if why == Reason::ViewsDisagree { Status::LowConfidence } else { Status::Ok });
        }
        let share = |seen: &Seen<'_>| {
            let is_best = seen.view == best.view;
            let own = seen.found.pose.as_ref();
            ViewShare {
                view: seen.view,
                place: seen.place,
                left_out: match (is_best, seen.found.verdict.status) {
                    (true, Status::Rejected) => Some(LeftOut::Rejected),
                    (true, _) => None,
                    (false, _) => Some(left_out),
                },
                residual_px: own.map(|own| own.reprojection_rmse_px),
                inliers: own.map_or(0, SolvedPose::inlier_count),
                camera_from_object: own.map(|own| own.camera_from_object),
            }
        };
        FusedPose {
            pose,
            verdict,
            confidence: best.found.confidence(),
            views: self.seen.iter().map(share).collect(),
            ..self.nothing()
        }
    }

    fn nothing(&self) -> FusedPose {
        FusedPose {
            object: self.model.manifest.name.clone(),
            verdict: Verdict::default(),
            pose: None,
            confidence: 0.0,
            views: Vec::new(),
            view_angle_rad: 0.0,
            scale: None,
            diameter_m: self.model.manifest.diameter_m,
        }
    }
}

/// Places of the views that a pose rests on.
fn used(solution: &ViewsSolution) -> impl Iterator<Item = usize> {
    let used = solution.views.iter().enumerate().filter(|(_, view)| view.excluded.is_none());
    used.map(|(index, _)| index)
}
