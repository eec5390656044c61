//! Pose from three points, after Ding et al., "Revisiting the P3P Problem", CVPR 2023.
//!
//! With unit rays `b_i` and distances `d_i`, each side of the triangle is one law of cosines, a quadratic form in `d`.
//! Two combinations of them have no constant term: two conics in the plane of directions of `d`. One member of their
//! pencil, found by a cubic, is a pair of lines; each line meets a conic in up to two points.

use nalgebra::{Matrix3, Rotation3, Vector3};

use super::cubic;
use crate::geometry::Pose;

/// Twice a triangle's area over the square of its longest side below which it counts as a line.
const MIN_FLATNESS: f64 = 1e-3;
/// A side of the triangle may miss its length by this share (squared): refinement follows.
const MAX_MISFIT: f64 = 1e-3;

/// Calls `found` with each pose `camera_from_points` (at most four) that puts three points on three unit rays, all in
/// front of the camera.
pub(super) fn solve(points: [&Vector3<f64>; 3], rays: [&Vector3<f64>; 3], mut found: impl FnMut(Pose)) {
    let Some(triangle) = Triangle::new(points, rays) else {
        return;
    };
    let Some((lines, conic)) = triangle.lines_and_conic() else {
        return;
    };
    for line in lines {
        for direction in intersections(&line, &conic).into_iter().flatten() {
            let distances = triangle.distances(&direction);
            if let Some(pose) = distances.and_then(|distances| triangle.pose(points[0], rays, &distances)) {
                found(pose);
            }
        }
    }
}

/// Everything about three points and three rays that does not depend on the distances.
struct Triangle {
    /// Squared length of the sides between points 0 and 1, 0 and 2, 1 and 2.
    squares: [f64; 3],
    /// Cosines between the rays, of the same pairs.
    cosines: [f64; 3],
    /// Rows of the inverse of the matrix of columns (side 01, side 02, their cross product).
    inverse: [Vector3<f64>; 3],
}

impl Triangle {
    fn new(points: [&Vector3<f64>; 3], rays: [&Vector3<f64>; 3]) -> Option<Self> {
        let (first, second) = (points[1] - points[0], points[2] - points[0]);
        let normal = first.cross(&second);
        let area = normal.norm_squared();
        let squares = [first.norm_squared(), second.norm_squared(), (points[2] - points[1]).norm_squared()];
        let longest = squares[0].max(squares[1]).max(squares[2]);
        (area > MIN_FLATNESS * MIN_FLATNESS * longest * longest).then(|| Self {
            squares,
            cosines: [rays[0].dot(rays[1]), rays[0].dot(rays[2]), rays[1].dot(rays[2])],
            inverse: [second.cross(&normal) / area, normal.cross(&first) / area, normal / area],
        })
    }

    /// The two lines of a degenerate conic of the pencil, and a conic that is not this one; `None` when the lines are
    /// complex, so that there is no solution.
    fn lines_and_conic(&self) -> Option<([Vector3<f64>; 2], Matrix3<f64>)> {
        let [c01, c02, c12] = self.cosines;
        let (a, b) = (self.squares[0] / self.squares[2], self.squares[1] / self.squares[2]);
        let first = Matrix3::new(1.0, -c01, 0.0, -c01, 1.0 - a, a * c12, 0.0, a * c12, -a);
        let second = Matrix3::new(1.0, 0.0, -c02, 0.0, -b, b * c12, -c02, b * c12, 1.0 - b);
        // det(first + s second), by powers of s. Exchanging the roles of the conics reverses it.
        let (k01, k02, k12) = (1.0 - c01 * c01, 1.0 - c02 * c02, 1.0 - c12 * c12);
        let product = 2.0 * c01 * c02 * c12;
        let cubed = b * (k12 * b - k02);
        let squared = k02 * (1.0 - a) + b * (k12 * (b + 2.0 * a) + product - 2.0);
        let linear = k01 * (1.0 - b) + a * (k12 * (a + 2.0 * b) + product - 2.0);
        let constant = a * (k12 * a - k01);
        // Dividing by the greater end keeps the root in reach; where both vanish the conics themselves are degenerate.
        let (base, other, coefficients) = if cubed.abs() > constant.abs() {
            (first, second, [cubed, squared, linear, constant])
        } else {
            (second, first, [constant, linear, squared, cubed])
        };
        let negligible = 1e-14 * squared.abs().max(linear.abs());
        let s = if coefficients[0].abs() > negligible { cubic::real_root(coefficients) } else { 0.0 };
        let lines = lines_of(&(base + other * s))?;
        // The conic furthest from the degenerate one in the pencil.
        Some((lines, if s.abs() < 1.0 { other } else { base }))
    }

    /// Distances along the rays in a given ratio; `None` unless all are in front of the camera.
    fn distances(&self, direction: &Vector3<f64>) -> Option<Vector3<f64>> {
        let side = |i: usize, j: usize, cosine: f64| {
            direction[i] * direction[i] + direction[j] * direction[j] - 2.0 * direction[i] * direction[j] * cosine
        };
        let sum = side(0, 1, self.cosines[0]) + side(0, 2, self.cosines[1]) + side(1, 2, self.cosines[2]);
        let scale = (self.squares.iter().sum::<f64>() / sum).sqrt();
        let distances = self.polish(direction * scale)?;
        (distances.min() > 0.0 && distances.max() < f64::INFINITY).then_some(distances)
    }

    /// One Newton step on the laws of cosines: the quadratics above lose digits near double roots.
    fn polish(&self, d: Vector3<f64>) -> Option<Vector3<f64>> {
        let [c01, c02, c12] = self.cosines;
        // Halves of the derivatives: (01 by 0, 01 by 1), (02 by 0, 02 by 2), (12 by 1, 12 by 2).
        let (u0, u1) = (d[0] - d[1] * c01, d[1] - d[0] * c01);
        let (v0, v2) = (d[0] - d[2] * c02, d[2] - d[0] * c02);
        let (w1, w2) = (d[1] - d[2] * c12, d[2] - d[1] * c12);
        let residual = |i: usize, j: usize, ci: f64, cj: f64, square: f64| 0.5 * (d[i] * ci + d[j] * cj - square);
        let r01 = residual(0, 1, u0, u1, self.squares[0]);
        let r02 = residual(0, 2, v0, v2, self.squares[1]);
        let r12 = residual(1, 2, w1, w2, self.squares[2]);
        let determinant = u0 * v2 * w1 + u1 * v0 * w2;
        if determinant.abs() < 1e-12 * self.squares[2] * d.amax() {
            return Some(d);
        }
        // Cramer's rule on [[u0 u1 0] [v0 0 v2] [0 w1 w2]] step = residual.
        let step = Vector3::new(
            r01 * v2 * w1 + u1 * (r02 * w2 - v2 * r12),
            u0 * (v2 * r12 - r02 * w2) + r01 * v0 * w2,
            u0 * r02 * w1 - r01 * v0 * w1 + u1 * v0 * r12,
        ) / determinant;
        (step.amax() < 0.1 * d.amax()).then(|| d - step)
    }

    /// `None` where rounding has left no triangle of the right size at these distances.
    fn pose(&self, origin: &Vector3<f64>, rays: [&Vector3<f64>; 3], distances: &Vector3<f64>) -> Option<Pose> {
        let corner = rays[0] * distances[0];
        let (first, second) = (rays[1] * distances[1] - corner, rays[2] * distances[2] - corner);
        let sides = [first.norm_squared(), second.norm_squared(), (second - first).norm_squared()];
        let fits = |(side, square): (&f64, &f64)| (side - square).abs() < MAX_MISFIT * square;
        if !sides.iter().zip(&self.squares).all(fits) {
            return None;
        }
        let normal = first.cross(&second);
        let [a, b, c] = &self.inverse;
        let rotation = first * a.transpose() + second * b.transpose() + normal * c.transpose();
        Some(Pose::new(Rotation3::from_matrix_unchecked(rotation), corner - rotation * origin))
    }
}

/// The lines of a conic of rank 2 (Richter-Gebert, "Perspectives on Projective Geometry", section 11.1).
fn lines_of(conic: &Matrix3<f64>) -> Option<[Vector3<f64>; 2]> {
    let cofactors = Matrix3::from_columns(&[
        conic.column(1).cross(&conic.column(2)),
        conic.column(2).cross(&conic.column(0)),
        conic.column(0).cross(&conic.column(1)),
    ]);
    let pivot = cofactors.diagonal().iamax();
    // Of lines that have all but merged, rounding may have made a complex pair.
    let square = -cofactors[(pivot, pivot)];
    if square < -1e-10 * conic.norm_squared() {
        return None;
    }
    let meeting = if square > 0.0 { cofactors.column(pivot) / square.sqrt() } else { Vector3::zeros() };
    let outer = conic + meeting.cross_matrix();
    let (row, column) = outer.iamax_full();
    Some([outer.row(row).transpose(), outer.column(column).into_owned()])
}

/// Points (directions) in which a line meets a conic.
fn intersections(line: &Vector3<f64>, conic: &Matrix3<f64>) -> [Option<Vector3<f64>>; 2] {
    // d = u + t v, with the coordinate that the line fixes best eliminated.
    let fixed = line.iamax();
    let (i, j) = ((fixed + 1) % 3, (fixed + 2) % 3);
    let mut u = Vector3::ith(i, 1.0);
    u[fixed] = -line[i] / line[fixed];
    let mut v = Vector3::ith(j, 1.0);
    v[fixed] = -line[j] / line[fixed];
    let by_u = conic * u;
    let (constant, half_linear, square) = (u.dot(&by_u), v.dot(&by_u), v.dot(&(conic * v)));
    let discriminant = half_linear * half_linear - square * constant;
    if discriminant < -1e-8 * half_linear * half_linear {
        return [None; 2];
    }
    let root = discriminant.max(0.0).sqrt();
    // Without cancellation: one root by the sum of equal signs, the other by the product of the roots.
    let sum = -(half_linear + root.copysign(half_linear));
    // Only positive ratios put both points in front of the camera; an infinite or undefined one is no solution.
    [sum / square, constant / sum].map(|t| (t > 0.0 && t < f64::INFINITY).then(|| u + v * t))
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn point() -> impl Strategy<Value = Vector3<f64>> {
        prop::array::uniform3(-0.1..0.1f64).prop_map(Vector3::from)
    }

    fn nearest_to(truth: &Pose, points: [&Vector3<f64>; 3]) -> f64 {
        let rays = points.map(|p| truth.transform(p).normalize());
        let mut best = f64::INFINITY;
        solve(points, rays.each_ref(), |pose| best = best.min((pose.matrix() - truth.matrix()).norm()));
        best
    }

    proptest! {
        /// Among the poses found is the true one, unless the triangle is a sliver.
        #[test]
        fn finds_the_true_pose(
            points in prop::array::uniform3(point()),
            rotation in prop::array::uniform3(-3.0..3.0f64),
            translation in (-0.3..0.3f64, -0.2..0.2f64, 0.4..1.5f64),
        ) {
            let [a, b, c] = &points;
            prop_assume!((b - a).cross(&(c - a)).norm() > 1e-4);
            let truth = Pose::new(
                Rotation3::new(Vector3::from(rotation)),
                Vector3::new(translation.0, translation.1, translation.2),
            );
            let ray = truth.transform(a).normalize();
            let normal = (truth.transform(b) - truth.transform(a)).cross(&(truth.transform(c) - truth.transform(a)));
            // Seen edge-on the problem is ill-posed: solutions merge.
            prop_assume!(normal.normalize().dot(&ray).abs() > 0.05);
            let apart = nearest_to(&truth, [a, b, c]);
            prop_assert!(apart < 1e-3, "{apart}");
        }

        /// Every pose found is a rigid motion that reproduces the rays.
        #[test]
        fn poses_found_reproduce_the_rays(
            points in prop::array::uniform3(point()),
            pixels in prop::array::uniform3((-0.4..0.4f64, -0.3..0.3f64)),
        ) {
            let [a, b, c] = &points;
            prop_assume!((b - a).cross(&(c - a)).norm() > 1e-4);
            let rays = pixels.map(|(x, y)| Vector3::new(x, y, 1.0).normalize());
            let (mut worst, mut skewed) = (0.0_f64, 0.0_f64);
            solve([a, b, c], rays.each_ref(), |pose| {
                let rotation = pose.rotation().matrix();
                skewed = skewed.max((rotation.transpose() * rotation - Matrix3::identity()).norm());
                for (point, ray) in [a, b, c].into_iter().zip(&rays) {
                    worst = worst.max((pose.transform(point).normalize() - ray).norm());
                }
            });
            prop_assert!(worst < 1e-3 && skewed < 1e-2, "{worst} {skewed}");
        }
    }

    /// Every coefficient that the method divides by vanishes for an equilateral triangle seen squarely.
    #[test]
    fn an_equilateral_triangle_seen_squarely() {
        let corner = |k: f64| Vector3::new((k * 2.0944).cos(), (k * 2.0944).sin(), 0.0) * 0.05;
        let [a, b, c] = [0.0, 1.0, 2.0].map(corner);
        for turn in [0.0, 0.3, 1e-6] {
            let truth = Pose::new(Rotation3::new(Vector3::new(turn, 0.0, 0.1)), Vector3::new(0.0, 0.0, 0.5));
            let apart = nearest_to(&truth, [&a, &b, &c]);
            assert!(apart < 1e-3, "{turn}: {apart}");
        }
    }
}
