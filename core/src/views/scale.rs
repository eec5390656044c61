//! Whether the object is as large as its points say. One view cannot tell size from distance; several from different sides
//! can.

use nalgebra::{Matrix6, Vector6};

use super::fit::{Fit, Member};
use super::solution::Scale;
use crate::geometry::{join, normalised_by_point, parts};
use crate::pnp::INLIER;

/// One Gauss-Newton step from a fitted pose in pose and scale together: scales are near 1.
pub(super) fn scale(members: &[Member<'_>], fit: &Fit) -> Option<Scale> {
    let mut hessian = Matrix6::zeros();
    let mut across = Vector6::zeros();
    let (mut own, mut gradient) = (0.0, 0.0);
    for (member, seen) in members.iter().zip(&fit.seen) {
        let (of_pose, of_scale, slope) = derivatives(member, fit, &seen.step)?;
        // The view's own step is eliminated, as it is for the pose.
        let damping = (Matrix6::identity() + member.shared * seen.hessian).try_inverse()?;
        let eliminated = damping * member.shared;
        hessian += seen.hessian * damping;
        across += damping.transpose() * of_pose;
        own += of_scale - of_pose.dot(&(eliminated * of_pose));
        gradient += slope - of_pose.dot(&(damping * (seen.step + member.shared * seen.gradient)));
    }
    let factor = ((hessian + hessian.transpose()) * 0.5).cholesky()?;
    let information = own - across.dot(&factor.solve(&across));
    (information > 0.0).then(|| Scale { value: 1.0 - gradient / information, sigma: information.recip().sqrt() })
}

/// Second derivatives of one member's cost by pose and scale, and by scale; the first derivative by scale.
fn derivatives(member: &Member<'_>, fit: &Fit, step: &Vector6<f64>) -> Option<(Vector6<f64>, f64, f64)> {
    let (translation, rotation) = parts(step);
    let pose = member.view.camera_from_world * fit.pose.perturbed(&translation, &rotation);
    let (mut of_pose, mut of_scale, mut slope) = (Vector6::zeros(), 0.0, 0.0);
    for seen in member.problem.observations() {
        let rotated = pose.rotation() * seen.point;
        let at = rotated + pose.translation();
        let residual = seen.residual(&at)?;
        if residual.norm_squared() >= INLIER.limit {
            continue;
        }
        let by_point = seen.whitening * normalised_by_point(&at);
        let by_scale = by_point * rotated;
        let pull = by_point.transpose() * by_scale;
        of_pose += join(&pull, &rotated.cross(&pull)) * member.share;
        of_scale += by_scale.norm_squared() * member.share;
        slope += by_scale.dot(&residual) * member.share;
    }
    Some((member.view.camera_from_world_axes.transpose() * of_pose, of_scale, slope))
}
