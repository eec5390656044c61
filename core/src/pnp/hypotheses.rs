//! Where refinement starts: poses from triplets of points, and the mirror image of a pose.

use nalgebra::{Matrix3, Rotation3, SymmetricEigen, Vector3};

use super::p3p;
use super::problem::{MAX_POINTS, Problem};
use crate::geometry::Pose;

/// Triplets of `MAX_POINTS` points.
const MAX_TRIPLETS: usize = MAX_POINTS * (MAX_POINTS - 1) * (MAX_POINTS - 2) / 6;

/// All triplets of a problem's points, the most promising in front.
pub(super) struct Triplets {
    triplets: [Triplet; MAX_TRIPLETS],
    len: usize,
}

#[derive(Clone, Copy, Default)]
struct Triplet {
    /// Large for wide triangles of points that are known well.
    quality: f64,
    points: [u8; 3],
}

impl Triplets {
    /// The first `front` triplets are the best ones, in no particular order.
    pub(super) fn new(problem: &Problem, front: usize) -> Self {
        let mut all = Self { triplets: [Triplet::default(); MAX_TRIPLETS], len: 0 };
        let seen = problem.observations();
        let count = u8::try_from(seen.len()).unwrap_or(u8::MAX);
        for a in 0..count {
            for b in a + 1..count {
                let [first, second] = [a, b].map(|k| &seen[usize::from(k)]);
                let side = second.point - first.point;
                for c in b + 1..count {
                    let third = &seen[usize::from(c)];
                    let area = side.cross(&(third.point - first.point)).norm_squared();
                    let variance = first.variance + second.variance + third.variance;
                    all.triplets[all.len] = Triplet { quality: area / (variance * variance), points: [a, b, c] };
                    all.len += 1;
                }
            }
        }
        if front < all.len {
            all.triplets[..all.len].select_nth_unstable_by(front, |x, y| y.quality.total_cmp(&x.quality));
        }
        all
    }

    pub(super) fn len(&self) -> usize {
        self.len
    }

    /// Calls `found` with each pose of each of these triplets.
    pub(super) fn solve(&self, problem: &Problem, range: std::ops::Range<usize>, mut found: impl FnMut(Pose)) {
        let seen = problem.observations();
        for triplet in &self.triplets[range] {
            let [a, b, c] = triplet.points.map(|k| &seen[usize::from(k)]);
            p3p::solve([&a.point, &b.point, &c.point], [&a.ray, &b.ray, &c.ray], &mut found);
        }
    }
}

/// The other pose of a flat object that looks alike from afar: the object mirrored through its own plane and through
/// the plane across the line of sight (Schweighofer and Pinz, "Robust pose estimation from a planar target", PAMI
/// 2006; Collins and Bartoli, "Infinitesimal plane-based pose estimation", IJCV 2014).
pub(super) fn mirrored(problem: &Problem, pose: &Pose) -> Pose {
    let (centre, normal) = plane_of(problem);
    let centre_in_camera = pose.transform(&centre);
    let reflect = |normal: &Vector3<f64>| Matrix3::identity() - normal * normal.transpose() * 2.0;
    let across = reflect(&centre_in_camera.normalize());
    // Two reflections make a rotation.
    let rotation = Rotation3::from_matrix_unchecked(across * pose.rotation().matrix() * reflect(&normal));
    Pose::new(rotation, centre_in_camera - rotation * centre)
}

/// Centre of the points and the direction in which they spread least.
fn plane_of(problem: &Problem) -> (Vector3<f64>, Vector3<f64>) {
    let points = || problem.observations().iter().map(|seen| seen.point);
    let centre = points().sum::<Vector3<f64>>() / problem.observations().len() as f64;
    let scatter: Matrix3<f64> = points().map(|p| (p - centre) * (p - centre).transpose()).sum();
    let eigen = SymmetricEigen::new(scatter);
    (centre, eigen.eigenvectors.column(eigen.eigenvalues.imin()).into())
}
