//! Views that see an object, each somewhere else: as a rule the poses of their cameras are wrong.

use std::collections::BTreeSet;

use nalgebra::Vector3;
use posed_core::pnp::Status;

use super::fused::{FusedPose, LeftOut, ViewShare};
use super::instance::{Instance, Seen};
use crate::estimator::verdict::Reason;

/// Share of an image's sides that is its rim: what is there may be cut off.
const RIM: f64 = 0.1;

/// The views that see something where another one sees it.
pub(super) fn borne_out<'a>(instances: impl Iterator<Item = &'a Instance<'a>>) -> BTreeSet<usize> {
    let shared = instances.filter(|one| one.seen.len() > 1);
    shared.flat_map(|one| one.seen.iter().map(|seen| seen.view)).collect()
}

/// `fused` are those of `instances`, all of one kind of object.
///
/// Two of them contradict each other if no view sees both: either they are one, and the cameras stood elsewhere, or each is
/// hidden from the views of the other. The first is likelier where the images should show both, and where no other view bears
/// out anything that one of the two is seen by. Then the one that fewer views see is in doubt, or both.
pub(super) fn doubt(instances: &[Instance<'_>], borne_out: &BTreeSet<usize>, fused: &mut [FusedPose]) {
    let is_odd = |one: &Instance<'_>| !one.seen.iter().any(|seen| borne_out.contains(&seen.view));
    for (a, one) in instances.iter().enumerate() {
        for (b, other) in instances.iter().enumerate().filter(|(b, _)| *b != a) {
            let apart = one.seen.iter().all(|seen| other.seen.iter().all(|of_other| of_other.view != seen.view));
            let both_in_sight = || is_in_sight(&fused[a], other) && is_in_sight(&fused[b], one);
            if apart && (is_odd(one) || is_odd(other) || both_in_sight()) {
                let outnumbers = one.seen.len() > other.seen.len();
                let status = if outnumbers { Status::Ok } else { Status::LowConfidence };
                fused[a].verdict.object(Reason::ViewsDisagree, status);
            }
        }
    }
}

/// Whether a view that another instance is seen in should show this one.
fn is_in_sight(fused: &FusedPose, other: &Instance<'_>) -> bool {
    let Some((pose, _)) = &fused.pose else { return false };
    other.seen.iter().any(|seen| shows(seen, pose.translation()))
}

fn shows(seen: &Seen<'_>, world_point: &Vector3<f64>) -> bool {
    let in_camera = seen.camera.world_from_camera.inverse().transform(world_point);
    let within = |value: f64, side: u32| (RIM..1.0 - RIM).contains(&(value / f64::from(side)));
    seen.optics.project(&in_camera).is_ok_and(|pixel| within(pixel.x, seen.size.0) && within(pixel.y, seen.size.1))
}

/// What a view alone shows is as doubtful as the view: where it contradicts the others in as much as it bears out, its
/// camera stood elsewhere. `fused` are those of all kinds, doubted as above.
pub(super) fn doubt_lone(fused: &mut [FusedPose]) {
    let used =
        |pose: &FusedPose| pose.views.iter().filter(|share| share.left_out.is_none()).map(|share| share.view).collect();
    let with_use: Vec<Vec<usize>> = fused.iter().map(used).collect();
    let disputes = |view: usize| {
        let of = |(pose, views): &(&FusedPose, &Vec<usize>)| {
            let against = |share: &ViewShare| {
                share.view == view && (views.len() < 2 || share.left_out == Some(LeftOut::Contradicts))
            };
            pose.verdict.reasons.contains(Reason::ViewsDisagree) && pose.views.iter().any(against)
        };
        fused.iter().zip(&with_use).filter(of).count()
    };
    let agreements = |view: usize| with_use.iter().filter(|views| views.len() > 1 && views.contains(&view)).count();
    let views: BTreeSet<usize> = with_use.iter().flatten().copied().collect();
    let disputed: BTreeSet<usize> =
        views.into_iter().filter(|view| disputes(*view) >= agreements(*view).max(1)).collect();
    for (pose, views) in fused.iter_mut().zip(with_use) {
        if matches!(views[..], [only] if disputed.contains(&only)) {
            pose.verdict.object(Reason::ViewsDisagree, Status::LowConfidence);
        }
    }
}
