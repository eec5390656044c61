//! Which of the views' own poses agree, before all of their points are fitted.

use nalgebra::Vector6;

use super::prepared::{Body, Placed, Prepared};
use super::view::isotropic_covariance;
use crate::geometry::{Covariance6, Pose, parts};

/// Standard deviations of a view's pose that are added to those it states, since where to look is decided here, not what is
/// found: a share of the object's radius, and an angle.
const LOOSE: f64 = 0.15;
const LOOSE_RAD: f64 = 6.0 * std::f64::consts::PI / 180.0;
/// What a view states is taken for so many times as much.
const INFLATED: f64 = 1.5;
/// 99.9 % of chi-squared with 6 degrees of freedom.
const GATE: f64 = 22.46;
/// A start turned from another by less leads to the same end.
pub(super) const SAME_RAD: f64 = 15.0 * std::f64::consts::PI / 180.0;
/// Starts that are refined.
const MAX_STARTS: usize = 3;

/// Where refinement starts.
pub(super) struct Start {
    pub pose: Pose,
    /// Whether each view agrees.
    pub members: Vec<bool>,
    cost: f64,
}

/// The poses that most of the views agree with, best first, each another one.
pub(super) fn starts(body: &Body<'_>, views: &[Prepared]) -> Vec<Start> {
    let mut all: Vec<Start> = views.iter().flat_map(|view| &view.modes).map(|mode| start(body, views, mode)).collect();
    all.sort_by(|a, b| a.cost.total_cmp(&b.cost));
    let mut distinct: Vec<Start> = Vec::new();
    for one in all {
        let same = |other: &Start| {
            let equal = body.nearest(&one.pose, &other.pose);
            let apart = (equal.translation() - other.pose.translation()).norm();
            equal.angle_to(&other.pose) < SAME_RAD && apart < body.radius_m
        };
        if distinct.len() < MAX_STARTS && !distinct.iter().any(same) {
            distinct.push(one);
        }
    }
    distinct
}

/// What the views say of one of their modes.
fn start(body: &Body<'_>, views: &[Prepared], mode: &Placed) -> Start {
    let own = loose(body, mode);
    let mut members = Vec::with_capacity(views.len());
    let mut agreeing = Vec::with_capacity(views.len());
    let mut cost = -2.0 * mode.weight.ln();
    for view in views {
        let nearest = view.modes.iter().map(|other| distance(body, view, other, mode, &own));
        let nearest = nearest.filter(|(squared, _)| *squared < GATE).min_by(|a, b| a.0.total_cmp(&b.0));
        cost += view.trust * nearest.as_ref().map_or(GATE, |(squared, _)| *squared);
        members.push(nearest.is_some());
        agreeing.extend(nearest.map(|(_, placed)| placed));
    }
    Start { pose: mean(body, mode, &agreeing), members, cost }
}

/// Squared distance of another view's mode from one, and that mode as the one of its equals nearest to it.
fn distance(body: &Body<'_>, view: &Prepared, other: &Placed, mode: &Placed, own: &Covariance6) -> (f64, Placed) {
    let equal = other.meaning(&body.nearest(&other.world_from_centred, &mode.world_from_centred));
    let step = mode.world_from_centred.step_to(&equal.world_from_centred);
    let mut covariance = own + loose(body, &equal) + view.by_camera(&equal.world_from_centred);
    forgive_turn(body, &mode.world_from_centred, &mut covariance);
    let squared = covariance.cholesky().map_or(f64::INFINITY, |factor| step.dot(&factor.solve(&step)));
    (squared - 2.0 * other.weight.ln(), equal)
}

fn loose(body: &Body<'_>, mode: &Placed) -> Covariance6 {
    mode.covariance * INFLATED + isotropic_covariance(LOOSE * body.radius_m, LOOSE_RAD)
}

/// A turn about an axis of revolution is no difference.
pub(super) fn forgive_turn(body: &Body<'_>, pose: &Pose, covariance: &mut Covariance6) {
    if let Some(turn) = body.turn(pose) {
        *covariance += turn * turn.transpose() * 100.0;
    }
}

/// The mean of the modes, each weighted by the inverse of its covariance.
fn mean(body: &Body<'_>, about: &Placed, modes: &[Placed]) -> Pose {
    let (mut information, mut pull) = (Covariance6::zeros(), Vector6::zeros());
    for mode in modes {
        let Some(factor) = loose(body, mode).cholesky() else { continue };
        let step = about.world_from_centred.step_to(&mode.world_from_centred);
        information += factor.inverse();
        pull += factor.solve(&step);
    }
    let step = information.cholesky().map_or(Vector6::zeros(), |factor| factor.solve(&pull));
    let (translation, rotation) = parts(&step);
    about.world_from_centred.perturbed(&translation, &rotation)
}
