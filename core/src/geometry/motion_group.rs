//! Finite groups of motions: what stated symmetries generate.
//!
//! Symmetries that somebody measured are off by a little, and then no power of them is the identity: LINEMOD's glue turns by 1.5
//! degrees less than a half turn. They are replaced by the nearest group: the motions are multiplied with a generous notion of
//! equality, and the group that this draft is meant to be is found by averaging (Grove, Karcher and Ruh, 1974).

use nalgebra::{Matrix3, Rotation3, SymmetricEigen, Vector3};

use super::pose::Pose;
use super::rotation::nearest_rotation;

/// Larger than every finite group of rotations that an object has in practice (icosahedron: 60), cyclic ones included.
pub(super) const MAX_GROUP: usize = 128;
/// Elements of the group that agree so far are one (radians; metres are compared alike).
pub(super) const SAME: f64 = 1e-6;

/// How far a measured symmetry may be from that which is meant: the largest in the datasets of the field is 1.53 degrees off. A
/// pose that is right only within so much is still right by every usual measure (5 degrees, a tenth of the diameter).
pub(super) const MEASURED_WITHIN_DEG: f64 = 2.0;
pub(super) const MEASURED_WITHIN_MM: f64 = 1.0;
/// Motions of a draft that are nearer are one. Products collect the errors of their factors.
const DRAFT_SAME_DEG: f64 = 15.0;
/// Different motions of a draft are no nearer, so no turn is less than a sixth of a full one: with smaller ones, any angle at
/// all would be near some group.
const DRAFT_APART_DEG: f64 = 50.0;
/// The error is squared in each: from 0.1 to less than rounding.
const AVERAGING_STEPS: usize = 6;

/// The group that exact motions generate, identity first; `None` if it is too large to be finite.
pub(super) fn generated(stated: &[Pose]) -> Option<Vec<Pose>> {
    closure(stated, |group, product| Some(group.iter().any(|known| same(known, product))))
}

/// The group that measured motions are meant to generate, identity first; `None` if there is none near them.
pub(super) fn nearest_group(stated: &[Pose]) -> Option<Vec<Pose>> {
    let draft = closure(stated, |group, product| {
        let angle = group.iter().map(|known| known.angle_to(product)).fold(f64::INFINITY, f64::min).to_degrees();
        let decided = !(DRAFT_SAME_DEG..DRAFT_APART_DEG).contains(&angle);
        decided.then_some(angle < DRAFT_SAME_DEG)
    })?;
    let products = table(&draft)?;
    let rotations = averaged(draft.iter().map(|motion| *motion.rotation()).collect(), &products);
    let exact = |(g, row): (usize, &Vec<usize>)| {
        let apart = |(h, gh): (usize, &usize)| (rotations[g] * rotations[h]).matrix() - rotations[*gh].matrix();
        row.iter().enumerate().all(|pair| apart(pair).norm() < SAME * 1e-3)
    };
    if !products.iter().enumerate().all(exact) {
        return None;
    }
    let centre = fixed_point(&draft);
    let group: Vec<_> = rotations.into_iter().map(|rotation| Pose::new(rotation, centre - rotation * centre)).collect();
    // What is almost the identity is no symmetry that somebody measured.
    let near = |motion: &Pose| {
        let turned = group[1..].iter().map(|exact| exact.angle_to(motion)).fold(f64::INFINITY, f64::min);
        let shift_mm = 1e3 * (motion.transform(&centre) - centre).norm();
        turned.to_degrees() <= MEASURED_WITHIN_DEG && shift_mm <= MEASURED_WITHIN_MM || same(motion, &group[0])
    };
    stated.iter().all(near).then_some(group)
}

/// All products of motions. `is_known` says whether a product is one of those found so far, or `None` if that is unclear.
fn closure(stated: &[Pose], is_known: impl Fn(&[Pose], &Pose) -> Option<bool>) -> Option<Vec<Pose>> {
    let mut group = vec![Pose::identity()];
    let mut next = 0;
    while let Some(&element) = group.get(next) {
        for generator in stated {
            let product = element * *generator;
            if !is_known(&group, &product)? {
                group.push(product);
            }
        }
        if group.len() > MAX_GROUP {
            return None;
        }
        next += 1;
    }
    Some(group)
}

/// Which motion of a draft each product of two of them is.
fn table(draft: &[Pose]) -> Option<Vec<Vec<usize>>> {
    let place = |product: Pose| draft.iter().position(|known| known.angle_to(&product).to_degrees() < DRAFT_SAME_DEG);
    draft.iter().map(|g| draft.iter().map(|h| place(*g * *h)).collect()).collect()
}

/// Rotations that multiply as the table says: each becomes the mean of what its products say of it.
fn averaged(mut rotations: Vec<Rotation3<f64>>, products: &[Vec<usize>]) -> Vec<Rotation3<f64>> {
    for _ in 0..AVERAGING_STEPS {
        let says = |(gh, h): (&usize, &Rotation3<f64>)| (rotations[*gh] * h.inverse()).into_inner();
        let mean = |row: &Vec<usize>| nearest_rotation(&row.iter().zip(&rotations).map(says).sum::<Matrix3<f64>>());
        rotations = products.iter().map(mean).collect();
    }
    rotations
}

/// The point that motions leave where it is, as nearly as they can; of an axis, the point nearest to the origin.
fn fixed_point(motions: &[Pose]) -> Vector3<f64> {
    let mut normal = Matrix3::zeros();
    let mut right = Vector3::zeros();
    for motion in motions {
        let moves = motion.rotation().matrix() - Matrix3::identity();
        normal += moves.transpose() * moves;
        right -= moves.transpose() * motion.translation();
    }
    // For an exact group each eigenvalue is twice the number of its motions, or zero along an axis that all of them share.
    let eigen = SymmetricEigen::new(normal);
    let known = |(value, axis): (&f64, nalgebra::MatrixView3x1<'_, f64>)| {
        if *value > motions.len() as f64 { axis * (axis.dot(&right) / value) } else { Vector3::zeros() }
    };
    eigen.eigenvalues.iter().zip([0, 1, 2].map(|k| eigen.eigenvectors.fixed_view::<3, 1>(0, k))).map(known).sum()
}

fn same(a: &Pose, b: &Pose) -> bool {
    a.angle_to(b) < SAME && (a.translation() - b.translation()).norm() < SAME
}
