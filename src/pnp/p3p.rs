//! Pose from three points: Grunert's equations (1841) in the form of Haralick et al., "Review and analysis of
//! solutions of the three point perspective pose estimation problem", IJCV 1994, with polished distances.

use nalgebra::{Matrix3, Rotation3, Vector3};

use super::quartic::real_roots;
use crate::geometry::Pose;

const POLISHING_STEPS: usize = 3;
const MIN_SINE: f64 = 1e-3;

/// Calls `found` with each pose `camera_from_points` (at most four) that puts three points on three unit rays, all in
/// front of the camera.
pub(super) fn solve(points: [&Vector3<f64>; 3], rays: [&Vector3<f64>; 3], mut found: impl FnMut(Pose)) {
    let Some(points_frame) = frame(points[0], points[1], points[2]) else {
        return;
    };
    let triangle = Triangle::new(points, rays);
    let (roots, count) = real_roots(triangle.quartic());
    for &v in &roots[..count] {
        let Some(distances) = triangle.distances(v).and_then(|d| triangle.polish(d)) else {
            continue;
        };
        let [a, b, c] = [0, 1, 2].map(|k| rays[k] * distances[k]);
        if let Some(camera_frame) = frame(&a, &b, &c) {
            let rotation = Rotation3::from_matrix_unchecked(camera_frame * points_frame.transpose());
            found(Pose::new(rotation, a - rotation * points[0]));
        }
    }
}

/// An orthonormal frame attached to a triangle, as columns; `None` for a triangle that is nearly a line.
fn frame(a: &Vector3<f64>, b: &Vector3<f64>, c: &Vector3<f64>) -> Option<Matrix3<f64>> {
    let x = (b - a).try_normalize(1e-12)?;
    let to_c = (c - a).try_normalize(1e-12)?;
    let z = x.cross(&to_c);
    let z = z.try_normalize(MIN_SINE)?;
    Some(Matrix3::from_columns(&[x, z.cross(&x), z]))
}

/// Squared side lengths and cosines between rays. Side `a` lies opposite point 1, and so on.
struct Triangle {
    a2: f64,
    b2: f64,
    c2: f64,
    cos_alpha: f64,
    cos_beta: f64,
    cos_gamma: f64,
}

impl Triangle {
    fn new([p1, p2, p3]: [&Vector3<f64>; 3], [j1, j2, j3]: [&Vector3<f64>; 3]) -> Self {
        Self {
            a2: (p2 - p3).norm_squared(),
            b2: (p1 - p3).norm_squared(),
            c2: (p1 - p2).norm_squared(),
            cos_alpha: j2.dot(j3),
            cos_beta: j1.dot(j3),
            cos_gamma: j1.dot(j2),
        }
    }

    /// Coefficients of the quartic in `v = s3 / s1` (Haralick et al., equation 9).
    fn quartic(&self) -> [f64; 5] {
        let Self { a2, b2, c2, cos_alpha, cos_beta, cos_gamma } = *self;
        let minus = (a2 - c2) / b2;
        let plus = (a2 + c2) / b2;
        let (alpha2, beta2, gamma2) = (cos_alpha * cos_alpha, cos_beta * cos_beta, cos_gamma * cos_gamma);
        let a4 = (minus - 1.0).powi(2) - 4.0 * c2 / b2 * alpha2;
        let a3 = 4.0
            * (minus * (1.0 - minus) * cos_beta - (1.0 - plus) * cos_alpha * cos_gamma
                + 2.0 * c2 / b2 * alpha2 * cos_beta);
        let a2_ = 2.0
            * (minus * minus - 1.0 + 2.0 * minus * minus * beta2 + 2.0 * (b2 - c2) / b2 * alpha2
                - 4.0 * plus * cos_alpha * cos_beta * cos_gamma
                + 2.0 * (b2 - a2) / b2 * gamma2);
        let a1 = 4.0
            * (-minus * (1.0 + minus) * cos_beta + 2.0 * a2 / b2 * gamma2 * cos_beta
                - (1.0 - plus) * cos_alpha * cos_gamma);
        let a0 = (1.0 + minus).powi(2) - 4.0 * a2 / b2 * gamma2;
        [a4, a3, a2_, a1, a0]
    }

    /// Distances along the three rays for a root `v`.
    fn distances(&self, v: f64) -> Option<Vector3<f64>> {
        let minus = (self.a2 - self.c2) / self.b2;
        let denominator = 2.0 * (self.cos_gamma - v * self.cos_alpha);
        let s1 = (self.b2 / (1.0 + v * v - 2.0 * v * self.cos_beta)).sqrt();
        let u = if denominator.abs() > 1e-9 {
            ((minus - 1.0) * v * v - 2.0 * minus * self.cos_beta * v + 1.0 + minus) / denominator
        } else {
            // The linear equation for u degenerates; the law of cosines over side c still holds.
            self.cos_gamma + (self.cos_gamma * self.cos_gamma - 1.0 + self.c2 / (s1 * s1)).max(0.0).sqrt()
        };
        let distances = Vector3::new(s1, u * s1, v * s1);
        distances.iter().all(|s| s.is_finite() && *s > 0.0).then_some(distances)
    }

    /// Gauss-Newton on the three laws of cosines; `None` where the result leaves the front of the camera or does not
    /// fit.
    fn polish(&self, mut s: Vector3<f64>) -> Option<Vector3<f64>> {
        for _ in 0..POLISHING_STEPS {
            let (residual, jacobian) = self.laws_of_cosines(&s);
            s -= jacobian.try_inverse()? * residual;
        }
        let (residual, _) = self.laws_of_cosines(&s);
        let fits = residual.amax() < 1e-6 * self.a2.max(self.b2).max(self.c2);
        (fits && s.iter().all(|d| *d > 0.0)).then_some(s)
    }

    fn laws_of_cosines(&self, s: &Vector3<f64>) -> (Vector3<f64>, Matrix3<f64>) {
        let side = |i: usize, j: usize, cosine: f64, squared: f64| {
            s[i] * s[i] + s[j] * s[j] - 2.0 * s[i] * s[j] * cosine - squared
        };
        let slope = |i: usize, j: usize, cosine: f64| 2.0 * (s[i] - s[j] * cosine);
        let residual = Vector3::new(
            side(1, 2, self.cos_alpha, self.a2),
            side(0, 2, self.cos_beta, self.b2),
            side(0, 1, self.cos_gamma, self.c2),
        );
        let jacobian = Matrix3::new(
            0.0,
            slope(1, 2, self.cos_alpha),
            slope(2, 1, self.cos_alpha),
            slope(0, 2, self.cos_beta),
            0.0,
            slope(2, 0, self.cos_beta),
            slope(0, 1, self.cos_gamma),
            slope(1, 0, self.cos_gamma),
            0.0,
        );
        (residual, jacobian)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn point() -> impl Strategy<Value = Vector3<f64>> {
        prop::array::uniform3(-0.1..0.1f64).prop_map(Vector3::from)
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
            let rays = [a, b, c].map(|p| truth.transform(p).normalize());
            let normal = (truth.transform(b) - truth.transform(a)).cross(&(truth.transform(c) - truth.transform(a)));
            // Seen edge-on the problem is ill-posed: solutions merge.
            prop_assume!(normal.normalize().dot(&rays[0]).abs() > 0.05);
            let mut best = f64::INFINITY;
            solve([a, b, c], rays.each_ref(), |pose| {
                best = best.min((pose.matrix() - truth.matrix()).norm());
            });
            prop_assert!(best < 1e-3, "{best}");
        }

        /// Every pose found reproduces the rays.
        #[test]
        fn poses_found_reproduce_the_rays(
            points in prop::array::uniform3(point()),
            pixels in prop::array::uniform3((-0.4..0.4f64, -0.3..0.3f64)),
        ) {
            let [a, b, c] = &points;
            let rays = pixels.map(|(x, y)| Vector3::new(x, y, 1.0).normalize());
            let mut worst = 0.0_f64;
            solve([a, b, c], rays.each_ref(), |pose| {
                for (point, ray) in [a, b, c].into_iter().zip(&rays) {
                    worst = worst.max((pose.transform(point).normalize() - ray).norm());
                }
            });
            prop_assert!(worst < 1e-3, "{worst}");
        }
    }
}
