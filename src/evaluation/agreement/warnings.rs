use super::scene::SceneAgreement;
use super::totals::{Spread, Totals};
use posed_core::pnp::Status;

/// What the agreement of views says nothing about.
pub const BLIND_SPOTS: &str = "This cannot see what all views share, such as an error of the reference image (the offset). \
    Errors of the camera poses and of 'cam_K' count as errors of the answers.";

/// Views from nearly one direction share their errors.
const MIN_VIEW_ANGLE_DEG: f64 = 20.0;
/// From so many poses on, shares say something.
const MIN_VIEWS: usize = 20;
/// True covariances leave 95 % within their ellipsoid.
const MIN_WITHIN_95: f64 = 0.85;
/// A median depth of less than this share of the diameter does no harm.
const MIN_BIAS: f64 = 0.01;
/// Standard deviations of a share of one half. Many, since the views of an instance are not independent.
const MIN_SIGMAS: f64 = 5.0;
/// So many images are named.
const MAX_NAMED: usize = 5;

/// What a user should know about the figures of one object, one sentence each.
#[must_use]
pub fn warnings(totals: &Totals, scenes: &[SceneAgreement], diameter_m: f64) -> Vec<String> {
    let mut all = Vec::new();
    if totals.instances == 0 {
        all.push("nothing to compare: no object was found in two images of a scene".into());
    }
    if totals.view_angle_deg.is_some_and(|angle| angle < MIN_VIEW_ANGLE_DEG) {
        let angle = totals.view_angle_deg.unwrap_or_default();
        all.push(format!(
            "the views are only {angle:.0} degrees apart, and share errors that stay unseen; take photos from all around"
        ));
    }
    if totals.without_consensus > 0 {
        all.push(format!("no two views agree in {} of {} instances", totals.without_consensus, totals.instances));
    }
    if totals.ok_disagreeing > 0 {
        all.push(format!("ok but in disagreement: {}", named(scenes)));
    }
    if totals.ok_alone > 0 {
        all.push(format!(
            "{} ok answers stand where no other image sees the object: seen once, false detections, or wrong by more than a \
             diameter",
            totals.ok_alone
        ));
    }
    all.extend(totals.spread_of_ok.as_ref().into_iter().flat_map(|spread| of_spread(spread, diameter_m)));
    all
}

fn of_spread(spread: &Spread, diameter_m: f64) -> Vec<String> {
    let mut all = Vec::new();
    if spread.views < MIN_VIEWS {
        return all;
    }
    if spread.within_95 < MIN_WITHIN_95 {
        let share = 100.0 * spread.within_95;
        all.push(format!(
            "the covariances are too small: {share:.0} % of the ok answers lie within their 95 % ellipsoid"
        ));
    }
    let sigmas = (spread.share_too_far - 0.5).abs() * 2.0 * (spread.views as f64).sqrt();
    if sigmas > MIN_SIGMAS && spread.depth_bias_m.abs() > MIN_BIAS * diameter_m {
        let side = if spread.depth_bias_m > 0.0 { "farther from" } else { "nearer to" };
        all.push(format!(
            "the answers lie {:.1} mm {side} the camera than the other views say (median): a wrong focal length, resized images or \
             an object of another size look so; otherwise the network is at fault",
            1e3 * spread.depth_bias_m.abs()
        ));
    }
    all
}

/// The images of ok answers that disagree, the flipped ones marked.
fn named(scenes: &[SceneAgreement]) -> String {
    let several = scenes.len() > 1;
    let wrong = scenes.iter().flat_map(|scene| {
        let wrong = scene.judged().filter(|one| one.found.status == Status::Ok && one.deviation.disagrees);
        wrong.map(move |one| {
            let scene = if several { format!("scene {} ", scene.scene) } else { String::new() };
            let flipped = if one.deviation.flipped { " (flipped)" } else { "" };
            format!("{scene}image {}{flipped}", one.found.image_id)
        })
    });
    let all: Vec<_> = wrong.collect();
    let more = if all.len() > MAX_NAMED { format!(" and {} more", all.len() - MAX_NAMED) } else { String::new() };
    format!("{}{more}", all[..all.len().min(MAX_NAMED)].join(", "))
}
