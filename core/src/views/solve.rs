use nalgebra::{Vector3, Vector6};

use super::consensus::{self, forgive_turn};
use super::fit::{Fit, Member, Start, fit};
use super::options::ViewsOptions;
use super::prepared::{Body, Placed, Prepared};
use super::scale::scale;
use super::solution::{Doubts, Exclusion, ViewFit, ViewsSolution};
use super::view::{View, ViewsError};
use crate::geometry::{Camera, Covariance6, Pose, Symmetries, covariance_about, parts};
use crate::pnp::{INLIER, MIN_POINTS, ROBUST, Status, improbable};

/// Median distance of a view's points from where the pose puts them, of their spread in the view, beyond which the view
/// contradicts it: a turn of about 15 degrees, or a shift by a tenth of the object.
const MAX_MISFIT: f64 = 0.2;
/// Standard deviations of the camera's pose that may add to it.
const CAMERA_SIGMAS: f64 = 3.0;
/// Views from within this angle share their errors.
const ONE_DIRECTION_RAD: f64 = 5.0 * std::f64::consts::PI / 180.0;
/// Depth gains little from views that are no further apart.
const WEAK_BASELINE_RAD: f64 = 10.0 * std::f64::consts::PI / 180.0;
/// Below this angle the scale shows in nothing but distance.
const SCALE_ANGLE_RAD: f64 = 20.0 * std::f64::consts::PI / 180.0;
const SCALE_VIEWS: usize = 3;
/// Times that the views in use may change.
const MAX_ROUNDS: usize = 4;
/// Newton's decrement, in standard deviations squared.
const ROUGH: f64 = 1e-3;
const EXACT: f64 = 1e-7;
/// Weight of another pose above which it must be considered.
const AMBIGUOUS_WEIGHT: f64 = 0.05;
const MAX_REDUCED_CHI2: f64 = 4.0;

/// Solves `world_from_points` from what several cameras saw of the same 4 to 16 points (metres).
///
/// Views that contradict the rest are left out and named. `symmetries` are those of the frame that the points are in: each view
/// may have seen any of the poses that look alike. Views from one direction share their errors and count as one. Same
/// input, same bits.
///
/// # Errors
/// [`ViewsError`] names the view that is unusable, or says that no pose fits.
pub fn solve_views(
    points: &[Vector3<f64>],
    views: &[View<'_>],
    symmetries: &Symmetries,
    options: &ViewsOptions,
) -> Result<ViewsSolution, ViewsError> {
    let body = Body::new(points, symmetries);
    let prepared = views.iter().enumerate().map(|(index, view)| Prepared::new(index, view, &body, options));
    let prepared = prepared.collect::<Result<Vec<_>, _>>()?;
    let scene = Scene { body, views: prepared, options };
    let starts = consensus::starts(&scene.body, &scene.views);
    if starts.is_empty() {
        return Err(ViewsError::NoModes);
    }
    let mut settled: Vec<Settled<'_>> = starts.iter().filter_map(|start| scene.settle(start)).collect();
    settled.sort_by(|a, b| a.cost.total_cmp(&b.cost));
    let mut settled = settled.into_iter();
    let best = settled.next().ok_or(ViewsError::NoPose)?;
    scene.assemble(&best, settled.as_slice(), points, views)
}

struct Scene<'a> {
    body: Body<'a>,
    views: Vec<Prepared>,
    options: &'a ViewsOptions,
}

/// A view beside a pose.
struct Sighted<'v> {
    /// That of its modes that is nearest.
    mode: Option<&'v Placed>,
    /// The reading that this mode explains.
    reading: usize,
    /// Moves the view's points to those of the pose that is meant, where the view saw another one that looks the same.
    meant_from_seen: Option<Pose>,
}

/// A fit whose members agree with it, and no other view does.
struct Settled<'a> {
    members: Vec<Member<'a>>,
    fit: Fit,
    covariance: Covariance6,
    /// Trusted views that agree cost their misfits, others the most that they could.
    cost: f64,
}

impl Scene<'_> {
    fn settle(&self, start: &consensus::Start) -> Option<Settled<'_>> {
        let mut agrees = start.members.clone();
        let mut pose = start.pose;
        let mut settled = None;
        for _ in 0..MAX_ROUNDS {
            let members = self.members(&pose, &agrees);
            let still = vec![(Vector6::zeros(), Vector6::zeros()); members.len()];
            let robust = fit(&members, &Start { pose, steps: &still }, &ROBUST, ROUGH)?;
            let fitted = fit(&members, &Start { pose: robust.pose, steps: &robust.steps() }, &INLIER, EXACT)?;
            pose = fitted.pose;
            let now = self.views.iter().map(|view| self.agrees(view, &pose)).collect::<Vec<_>>();
            let stands = now == agrees || !now.contains(&true);
            settled = Some((members, fitted));
            if stands {
                break;
            }
            agrees = now;
        }
        let (members, fit) = settled?;
        let covariance = fit.covariance(&members)?;
        let used = |index: usize| members.iter().any(|member| member.index == index);
        let cost = self.views.iter().enumerate().map(|(index, view)| {
            let most = view.problems[0].observations().len() as f64 * INLIER.limit;
            if used(index) { 0.0 } else { most * view.trust }
        });
        let cost = fit.cost / self.options.tempering + cost.sum::<f64>();
        Some(Settled { members, fit, covariance, cost })
    }

    /// The views in use, each as the equal pose that it saw.
    fn members(&self, pose: &Pose, agrees: &[bool]) -> Vec<Member<'_>> {
        let used: Vec<usize> = (0..self.views.len()).filter(|index| agrees[*index]).collect();
        let rays: Vec<Vector3<f64>> = used.iter().map(|index| self.views[*index].ray(pose)).collect();
        let mut anchored = false;
        let member = |(place, index): (usize, &usize)| {
            let view = &self.views[*index];
            let company = rays.iter().filter(|ray| ray.angle(&rays[place]) < ONE_DIRECTION_RAD).count() as f64;
            let Sighted { mode, reading, meant_from_seen } = self.sighted(view, pose);
            let mut shared = view.by_camera(pose);
            if let Some(mode) = mode {
                shared += mode.shared;
            }
            shared *= company;
            // A view sees no turn about an axis of revolution; the first one says how it is called.
            if anchored {
                forgive_turn(&self.body, pose, &mut shared);
            }
            anchored = true;
            let problem = match meant_from_seen {
                Some(meant_from_seen) => view.problems[reading].moved(&meant_from_seen),
                None => view.problems[reading].clone(),
            };
            Member { index: *index, view, problem, shared, share: company.recip() }
        };
        used.iter().enumerate().map(member).collect()
    }

    /// What a view has to do with a pose.
    fn sighted<'v>(&self, view: &'v Prepared, pose: &Pose) -> Sighted<'v> {
        let equals = view.modes.iter().map(|mode| (mode, self.body.nearest(&mode.world_from_centred, pose)));
        let nearest = equals.min_by(|(_, a), (_, b)| a.angle_to(pose).total_cmp(&b.angle_to(pose)));
        let Some((mode, equal)) = nearest else { return Sighted { mode: None, reading: 0, meant_from_seen: None } };
        let is_other = equal != mode.world_from_centred;
        let meant_from_seen = is_other.then(|| equal.inverse() * mode.world_from_centred);
        Sighted { mode: Some(mode), reading: mode.reading, meant_from_seen }
    }

    fn agrees(&self, view: &Prepared, pose: &Pose) -> bool {
        let limit = MAX_MISFIT + CAMERA_SIGMAS * view.misfit_by_camera(pose, self.body.radius_m);
        let (reading, as_seen) = self.as_seen(view, pose);
        view.misfit(reading, &as_seen) < limit
    }

    /// The pose that looks like one, as a view calls it, and the reading of the view that suits it.
    fn as_seen(&self, view: &Prepared, pose: &Pose) -> (usize, Pose) {
        let Sighted { reading, meant_from_seen, .. } = self.sighted(view, pose);
        (reading, meant_from_seen.map_or(*pose, |meant_from_seen| *pose * meant_from_seen))
    }

    fn assemble(
        &self,
        best: &Settled<'_>,
        others: &[Settled<'_>],
        points: &[Vector3<f64>],
        views: &[View<'_>],
    ) -> Result<ViewsSolution, ViewsError> {
        let Settled { members, fit, covariance, .. } = best;
        let pose = fit.pose;
        let mut chi2: f64 = fit.seen.iter().map(|seen| seen.pull.dot(&seen.step)).sum();
        // Views that pull the pose apart further than their steps may: most points fit all the same.
        let pulls = 6.0 * (members.iter().map(|member| member.share).sum::<f64>() - 1.0).max(0.0);
        let tension = if chi2 > improbable(pulls) { chi2 / pulls.max(1.0) } else { 1.0 };
        let mut inliers = vec![0; views.len()];
        for (member, seen) in members.iter().zip(&fit.seen) {
            let (translation, rotation) = parts(&seen.step);
            let camera_from_centred = member.view.camera_from_world * pose.perturbed(&translation, &rotation);
            for point in member.problem.observations() {
                let squared = point.mahalanobis_squared(&camera_from_centred);
                if squared < INLIER.limit {
                    inliers[member.index] += 1;
                    chi2 += squared * member.share;
                }
            }
        }
        let weighted: f64 = members.iter().map(|member| 2.0 * member.share * inliers[member.index] as f64).sum();
        if inliers.iter().sum::<usize>() < MIN_POINTS {
            return Err(ViewsError::NoPose);
        }
        let degrees_of_freedom = (weighted - 6.0).max(0.0);
        let reduced = chi2 / degrees_of_freedom.max(1.0);
        let inflation = if chi2 > improbable(degrees_of_freedom) { reduced } else { 1.0 }.max(tension);
        let fits =
            (0..views.len()).map(|index| self.view_fit(best, index, inliers[index], points, views[index].camera));
        let view_angle_rad = widest_angle(members, &pose);
        let scale = (members.len() >= SCALE_VIEWS && view_angle_rad > SCALE_ANGLE_RAD).then(|| scale(members, fit));
        let scale = scale.flatten().map(|mut scale| {
            scale.sigma *= inflation.sqrt();
            scale
        });
        let alternative = self.alternative(best, others);
        let trust = |used: bool| -> f64 {
            let of = |index: &usize| members.iter().any(|member| member.index == *index) == used;
            (0..views.len()).filter(of).map(|index| f64::from(u8::from(!views[index].modes.is_empty()))).sum()
        };
        let doubts = Doubts {
            views_disagree: trust(false) > 0.0,
            no_majority: trust(false) >= trust(true) && trust(false) > 0.0,
            weak_baseline: views.len() > 1 && view_angle_rad < WEAK_BASELINE_RAD,
            ambiguous: alternative.is_some_and(|(_, weight)| weight > AMBIGUOUS_WEIGHT),
            high_residual: reduced.max(tension) > MAX_REDUCED_CHI2,
        };
        let world_from_points = self.body.with_origin(&pose);
        let lever = world_from_points.translation() - pose.translation();
        Ok(ViewsSolution {
            world_from_points,
            covariance: covariance_about(&(covariance * inflation), &lever),
            chi2,
            degrees_of_freedom,
            views: fits.collect(),
            view_angle_rad,
            alternative,
            scale,
            status: status(doubts),
            doubts,
        })
    }

    fn view_fit(
        &self,
        settled: &Settled<'_>,
        index: usize,
        inliers: usize,
        points: &[Vector3<f64>],
        camera: &Camera,
    ) -> ViewFit {
        let view = &self.views[index];
        let members = settled.members.iter().zip(&settled.fit.seen);
        let member = members.into_iter().find(|(member, _)| member.index == index);
        let (reading, as_seen) = self.as_seen(view, &settled.fit.pose);
        let world_from_points = self.body.with_origin(&as_seen);
        let camera_from_points = view.camera_from_world * world_from_points;
        // Outliers of a view in use are those of the pose as this view sees it.
        let own = member.map(|(_, seen)| {
            let (translation, rotation) = parts(&seen.step);
            view.camera_from_world * as_seen.perturbed(&translation, &rotation)
        });
        let (mut sum, mut count) = (0.0, 0.0);
        for seen in view.problems[reading].observations() {
            let pixel = camera.project(&camera_from_points.transform(&points[seen.index]));
            let outlier = own.is_some_and(|own| seen.mahalanobis_squared(&own) > FAR);
            if let (Ok(pixel), Ok(observed), false) = (pixel, camera.project(&seen.image.push(1.0)), outlier) {
                sum += (pixel - observed).norm_squared();
                count += 1.0;
            }
        }
        ViewFit {
            excluded: member.is_none().then_some(Exclusion::Contradicts),
            residual_px: (count > 0.0).then(|| f64::sqrt(sum / count)),
            inliers,
            world_from_points,
        }
    }

    /// The next best pose that is another one, weighted as in [`crate::pnp::solve`].
    fn alternative(&self, best: &Settled<'_>, others: &[Settled<'_>]) -> Option<(Pose, f64)> {
        let pose = best.fit.pose;
        let other = others.iter().find(|other| {
            let equal = self.body.nearest(&other.fit.pose, &pose);
            equal.angle_to(&pose) > consensus::SAME_RAD
                || (equal.translation() - pose.translation()).norm() > self.body.radius_m
        })?;
        let volume = |settled: &Settled<'_>| settled.covariance.determinant().max(0.0).sqrt();
        let ratio = (-0.5 * (other.cost - best.cost)).exp() * volume(other) / volume(best);
        let weight = if ratio.is_finite() { ratio / (1.0 + ratio) } else { 0.5 };
        Some((self.body.with_origin(&other.fit.pose), weight))
    }
}

/// Between the directions from which the members see the object.
fn widest_angle(members: &[Member<'_>], pose: &Pose) -> f64 {
    let rays: Vec<_> = members.iter().map(|member| member.view.ray(pose)).collect();
    let pairs = rays.iter().enumerate().flat_map(|(k, a)| rays[..k].iter().map(move |b| a.angle(b)));
    pairs.fold(0.0, f64::max)
}

/// Points this far (squared Mahalanobis distance) from a fused pose are outliers of their view.
const FAR: f64 = 100.0;

fn status(doubts: Doubts) -> Status {
    let all =
        [(doubts.ambiguous, Status::Ambiguous), (doubts.high_residual || doubts.no_majority, Status::LowConfidence)];
    all.into_iter().filter(|(holds, _)| *holds).map(|(_, status)| status).max().unwrap_or(Status::Ok)
}
