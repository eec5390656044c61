//! Lens models of OpenCV: what a lens does to normalised image coordinates (the plane z = 1).
//!
//! Formulas: OpenCV's documentation of `projectPoints` (radial, tangential and thin prism terms) and of
//! `fisheye::projectPoints` (Kannala and Brandt, "A generic camera model ...", PAMI 2006).

use nalgebra::{Matrix2, Vector2};

/// Rays further than this from the optical axis (tangent of the angle, about 88 degrees) are outside every model here:
/// coordinates on the plane z = 1 lose their meaning towards 90 degrees.
const MAX_RADIUS: f64 = 30.0;
/// Steps in which the domain of a polynomial is searched for its end.
const DOMAIN_STEPS: u32 = 3000;
const MAX_NEWTON_STEPS: usize = 50;
/// Residual on the plane z = 1 at which an inversion has converged: 1e-9 px and less for any real camera.
const CONVERGED: f64 = 1e-13;

/// A lens, and how far from the optical axis its polynomial is still one to one.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct Lens {
    model: Model,
    /// Largest radius on the plane z = 1 up to which the distorted radius grows.
    max_radius: f64,
}

#[derive(Clone, Debug, PartialEq)]
pub(super) enum Model {
    Pinhole,
    /// `k1 k2 p1 p2 k3 k4 k5 k6 s1 s2 s3 s4`, as many of them as the camera states, the rest zero.
    OpenCv {
        coefficients: [f64; 12],
        stated: usize,
    },
    /// `k1 k2 k3 k4`.
    Fisheye([f64; 4]),
}

impl Lens {
    pub(super) fn is_fisheye(&self) -> bool {
        matches!(self.model, Model::Fisheye(_))
    }

    pub(super) fn new(model: Model) -> Self {
        let mut lens = Self { model, max_radius: MAX_RADIUS };
        lens.max_radius = lens.end_of_domain();
        lens
    }

    #[cfg(feature = "serde")]
    pub(super) fn model(&self) -> &Model {
        &self.model
    }

    pub(super) fn is_pinhole(&self) -> bool {
        matches!(self.model, Model::Pinhole)
    }

    /// Where a lens moves a point, and the derivative of the moved point; `None` outside the lens model's domain.
    pub(super) fn distort(&self, point: &Vector2<f64>) -> Option<(Vector2<f64>, Matrix2<f64>)> {
        // Written so that NaN is outside too.
        let inside = point.norm_squared() < self.max_radius * self.max_radius;
        if !inside {
            return None;
        }
        let (moved, jacobian) = self.evaluate(point);
        // Tangential and prism terms can fold the image even where the radial polynomial still grows.
        (moved.iter().all(|v| v.is_finite()) && jacobian.determinant() > 0.0).then_some((moved, jacobian))
    }

    /// The point that [`Lens::distort`] moves here, by damped Newton, and the derivative of the point found; `None`
    /// where no point of the domain is moved here.
    pub(super) fn undistort(&self, moved: &Vector2<f64>) -> Option<(Vector2<f64>, Matrix2<f64>)> {
        if self.is_pinhole() {
            return self.distort(moved);
        }
        let mut point = *moved;
        // A barrel moves points inwards: what comes from far out starts beyond the domain, or is not in the image.
        let limit = 0.95 * self.max_radius;
        if point.norm() > limit {
            point *= limit / point.norm();
        }
        let (mut image, mut jacobian) = self.distort(&point)?;
        for _ in 0..MAX_NEWTON_STEPS {
            let residual = moved - image;
            if residual.norm() < CONVERGED * (1.0 + moved.norm()) {
                return Some((point, jacobian.try_inverse()?));
            }
            let step = jacobian.try_inverse()? * residual;
            let (next, (next_image, next_jacobian)) = (0..30).find_map(|halvings| {
                let next = point + step * 0.5_f64.powi(halvings);
                let moved_next = self.distort(&next)?;
                ((moved - moved_next.0).norm() < residual.norm()).then_some((next, moved_next))
            })?;
            (point, image, jacobian) = (next, next_image, next_jacobian);
        }
        None
    }

    fn evaluate(&self, point: &Vector2<f64>) -> (Vector2<f64>, Matrix2<f64>) {
        match &self.model {
            Model::Pinhole => (*point, Matrix2::identity()),
            Model::OpenCv { coefficients, .. } => opencv(coefficients, point),
            Model::Fisheye(coefficients) => fisheye(coefficients, point),
        }
    }

    /// The radius at which the distorted radius stops growing, found on a grid and then by bisection.
    fn end_of_domain(&self) -> f64 {
        // Along the axis of growing x of the purely radial part; the rest is checked point by point.
        let radial = match &self.model {
            Model::Pinhole => return MAX_RADIUS,
            Model::Fisheye(_) => self.model.clone(),
            Model::OpenCv { coefficients: [k1, k2, _, _, k3, k4, k5, k6, ..], stated } => Model::OpenCv {
                coefficients: [*k1, *k2, 0.0, 0.0, *k3, *k4, *k5, *k6, 0.0, 0.0, 0.0, 0.0],
                stated: *stated,
            },
        };
        let radial = Self { model: radial, max_radius: MAX_RADIUS };
        let grows = |radius: f64| {
            let (moved, jacobian) = radial.evaluate(&Vector2::new(radius, 0.0));
            // The second derivative of moved radius by radius is `jacobian.m11`; a pole turns the sign of `moved`.
            moved.x >= 0.0 && jacobian.m11 > 0.0
        };
        // Even in the angle, so that the grid is fine near the axis, where real images lie.
        let at = |step: u32| (f64::from(step) / f64::from(DOMAIN_STEPS) * MAX_RADIUS.atan()).tan();
        let Some(first_bad) = (0..=DOMAIN_STEPS).find(|step| !grows(at(*step))) else {
            return MAX_RADIUS;
        };
        let (mut good, mut bad) = (at(first_bad.saturating_sub(1)), at(first_bad));
        for _ in 0..60 {
            let middle = 0.5 * (good + bad);
            if grows(middle) { good = middle } else { bad = middle }
        }
        good
    }
}

fn opencv(
    &[k1, k2, p1, p2, k3, k4, k5, k6, s1, s2, s3, s4]: &[f64; 12],
    point: &Vector2<f64>,
) -> (Vector2<f64>, Matrix2<f64>) {
    let (x, y) = (point.x, point.y);
    let r2 = x * x + y * y;
    let above = 1.0 + r2 * (k1 + r2 * (k2 + r2 * k3));
    let below = 1.0 + r2 * (k4 + r2 * (k5 + r2 * k6));
    let radial = above / below;
    // By r², as all derivatives that follow.
    let above_slope = k1 + r2 * (2.0 * k2 + 3.0 * r2 * k3);
    let below_slope = k4 + r2 * (2.0 * k5 + 3.0 * r2 * k6);
    let radial_slope = (above_slope - radial * below_slope) / below;
    let moved = Vector2::new(
        x * radial + 2.0 * p1 * x * y + p2 * (r2 + 2.0 * x * x) + r2 * (s1 + s2 * r2),
        y * radial + p1 * (r2 + 2.0 * y * y) + 2.0 * p2 * x * y + r2 * (s3 + s4 * r2),
    );
    let prism = Vector2::new(s1 + 2.0 * s2 * r2, s3 + 2.0 * s4 * r2);
    let cross = 2.0 * x * y * radial_slope;
    let jacobian = Matrix2::new(
        radial + 2.0 * x * x * radial_slope + 2.0 * p1 * y + 6.0 * p2 * x + 2.0 * x * prism.x,
        cross + 2.0 * p1 * x + 2.0 * p2 * y + 2.0 * y * prism.x,
        cross + 2.0 * p1 * x + 2.0 * p2 * y + 2.0 * x * prism.y,
        radial + 2.0 * y * y * radial_slope + 6.0 * p1 * y + 2.0 * p2 * x + 2.0 * y * prism.y,
    );
    (moved, jacobian)
}

fn fisheye(&[k1, k2, k3, k4]: &[f64; 4], point: &Vector2<f64>) -> (Vector2<f64>, Matrix2<f64>) {
    let r = point.norm();
    let theta = r.atan();
    let t2 = theta * theta;
    let moved_angle = theta * (1.0 + t2 * (k1 + t2 * (k2 + t2 * (k3 + t2 * k4))));
    let slope = 1.0 + t2 * (3.0 * k1 + t2 * (5.0 * k2 + t2 * (7.0 * k3 + t2 * 9.0 * k4)));
    if r < 1e-8 {
        return (*point, Matrix2::identity());
    }
    let scale = moved_angle / r;
    let direction = point / r;
    let along = direction * direction.transpose();
    // Radially d(moved)/dr; across, the scale.
    (point * scale, along * (slope / (1.0 + r * r)) + (Matrix2::identity() - along) * scale)
}
