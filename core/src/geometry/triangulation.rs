use nalgebra::{Matrix2, Matrix3, Matrix4, RowVector4, SymmetricEigen, Vector2, Vector3};
use thiserror::Error;

use super::camera::{Camera, ProjectionError, normalised, normalised_by_point};
use super::covariance::whitening_of;
use super::pose::Pose;

/// What one camera saw of a point.
#[derive(Clone, Debug)]
pub struct Observation<'a> {
    /// Which camera.
    pub camera: &'a Camera,
    /// Where it was, metres.
    pub camera_from_world: Pose,
    /// What it saw.
    pub pixel: Vector2<f64>,
    /// px².
    pub covariance_px: Matrix2<f64>,
}

/// A triangulated point.
#[derive(Clone, Debug)]
pub struct TriangulatedPoint {
    /// Metres.
    pub point_in_world: Vector3<f64>,
    /// m², as the pixels' covariances say (inverse Gauss-Newton Hessian).
    pub covariance: Matrix3<f64>,
    /// Sum of the squared Mahalanobis distances of the reprojections; `2 n - 3` degrees of freedom.
    pub chi2: f64,
}

/// Observations that no point can be triangulated from.
#[allow(missing_docs, reason = "the messages say it")]
#[derive(Clone, Debug, Error, PartialEq)]
pub enum TriangulationError {
    #[error("{0} observations; triangulation needs at least 2")]
    TooFew(usize),
    #[error("observation {index} has a value that is not finite")]
    NotFinite { index: usize },
    #[error("covariance of observation {index} is not positive definite")]
    Covariance { index: usize },
    #[error("observation {index}: {source}")]
    Pixel { index: usize, source: ProjectionError },
    #[error("the rays are parallel to within {:.2} deg; take the images from further apart", MIN_ANGLE_RAD.to_degrees())]
    ParallelRays,
    #[error("the rays meet behind camera {index}; check the relative poses and the order of the points")]
    BehindCamera { index: usize },
}

/// Rays that all lie within this angle meet at no definite distance.
const MIN_ANGLE_RAD: f64 = 1e-3;
const MAX_ITERATIONS: usize = 20;

/// The point that two or more cameras see: linear triangulation (DLT; Hartley and Zisserman, section 12.2), then
/// Gauss-Newton on the reprojection errors, whitened by their covariances.
///
/// # Errors
/// [`TriangulationError`] names the observation that is unusable, or says that the rays do not meet in front of the
/// cameras.
pub fn triangulate(observations: &[Observation]) -> Result<TriangulatedPoint, TriangulationError> {
    if observations.len() < 2 {
        return Err(TriangulationError::TooFew(observations.len()));
    }
    let views = observations
        .iter()
        .enumerate()
        .map(|(index, observation)| View::new(index, observation))
        .collect::<Result<Vec<_>, _>>()?;
    if !views.iter().any(|view| view.direction.cross(&views[0].direction).norm() > MIN_ANGLE_RAD) {
        return Err(TriangulationError::ParallelRays);
    }
    let mut point = linear(&views).ok_or(TriangulationError::ParallelRays)?;
    let mut normal = Normal::new(&views, &point)?;
    for _ in 0..MAX_ITERATIONS {
        let covariance = normal.hessian.cholesky().ok_or(TriangulationError::ParallelRays)?;
        let moved = point - covariance.solve(&normal.gradient);
        // Near its minimum Gauss-Newton only ends at rounding; far from it DLT has been.
        match Normal::new(&views, &moved) {
            Ok(lower) if lower.chi2 < normal.chi2 => (point, normal) = (moved, lower),
            Ok(_) | Err(_) => break,
        }
    }
    let covariance = normal.hessian.cholesky().ok_or(TriangulationError::ParallelRays)?.inverse();
    Ok(TriangulatedPoint { point_in_world: point, covariance, chi2: normal.chi2 })
}

/// An observation on the plane z = 1.
struct View {
    camera_from_world: Pose,
    image: Vector2<f64>,
    /// `W` with `Wᵀ W = Σ⁻¹`.
    whitening: Matrix2<f64>,
    /// Unit direction of the ray, in the world.
    direction: Vector3<f64>,
}

impl View {
    fn new(index: usize, observation: &Observation) -> Result<Self, TriangulationError> {
        let Observation { camera, camera_from_world, pixel, covariance_px } = observation;
        let numbers = pixel.iter().chain(covariance_px).chain(camera_from_world.translation());
        if !numbers.chain(camera_from_world.rotation().matrix()).all(|v| v.is_finite()) {
            return Err(TriangulationError::NotFinite { index });
        }
        let (image, by_pixel) =
            camera.unproject_with_jacobian(pixel).map_err(|source| TriangulationError::Pixel { index, source })?;
        let whitening = whitening_of(&(by_pixel * covariance_px * by_pixel.transpose()))
            .ok_or(TriangulationError::Covariance { index })?;
        let direction = camera_from_world.rotation().inverse() * image.push(1.0).normalize();
        Ok(Self { camera_from_world: *camera_from_world, image, whitening, direction })
    }
}

/// The null vector of the stacked cross products of rays and projections.
fn linear(views: &[View]) -> Option<Vector3<f64>> {
    let mut gram = Matrix4::zeros();
    for view in views {
        let matrix = view.camera_from_world.matrix();
        let row = |k: usize| RowVector4::from(matrix.row(k));
        for equation in [row(2) * view.image.x - row(0), row(2) * view.image.y - row(1)] {
            gram += equation.transpose() * equation;
        }
    }
    let eigen = SymmetricEigen::new(gram);
    let null = eigen.eigenvectors.column(eigen.eigenvalues.imin()).into_owned();
    let point = null.xyz() / null.w;
    point.iter().all(|v| v.is_finite()).then_some(point)
}

struct Normal {
    hessian: Matrix3<f64>,
    gradient: Vector3<f64>,
    chi2: f64,
}

impl Normal {
    fn new(views: &[View], point: &Vector3<f64>) -> Result<Self, TriangulationError> {
        let mut normal = Self { hessian: Matrix3::zeros(), gradient: Vector3::zeros(), chi2: 0.0 };
        for (index, view) in views.iter().enumerate() {
            let in_camera = view.camera_from_world.transform(point);
            let seen = normalised(&in_camera).map_err(|_| TriangulationError::BehindCamera { index })?;
            let residual = view.whitening * (seen - view.image);
            let jacobian =
                view.whitening * normalised_by_point(&in_camera) * view.camera_from_world.rotation().matrix();
            normal.hessian += jacobian.transpose() * jacobian;
            normal.gradient += jacobian.transpose() * residual;
            normal.chi2 += residual.norm_squared();
        }
        Ok(normal)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use nalgebra::Rotation3;
    use proptest::prelude::*;
    use rand::SeedableRng as _;
    use rand::rngs::SmallRng;
    use rand_distr::{Distribution as _, StandardNormal};

    fn camera() -> Camera {
        Camera::pinhole(600.0, 600.0, 319.5, 239.5).unwrap().with_opencv_distortion(&[-0.1, 0.02, 0.001, 0.0]).unwrap()
    }

    /// A camera on a sphere about the origin, looking at it.
    fn looking_at_origin(turn: [f64; 3], distance: f64) -> Pose {
        Pose::new(Rotation3::new(turn.into()), Vector3::new(0.0, 0.0, distance))
    }

    fn observe<'a>(camera: &'a Camera, pose: &Pose, point: &Vector3<f64>) -> Observation<'a> {
        let pixel = camera.project(&pose.transform(point)).unwrap();
        Observation { camera, camera_from_world: *pose, pixel, covariance_px: Matrix2::identity() }
    }

    proptest! {
        #[test]
        fn recovers_the_point(
            point in prop::array::uniform3(-0.1..0.1f64), turn in prop::array::uniform3(-1.0..1.0f64), count in 2..5u32,
        ) {
            prop_assume!(Vector3::from(turn).xy().norm() > 0.05);
            let (point, camera) = (Vector3::from(point), camera());
            let poses = (0..count).map(|k| looking_at_origin(turn.map(|angle| angle * f64::from(k)), 0.6));
            let observations: Vec<_> = poses.map(|pose| observe(&camera, &pose, &point)).collect();
            let found = triangulate(&observations).unwrap();
            prop_assert!((found.point_in_world - point).norm() < 1e-7, "{found:?}");
        }
    }

    #[test]
    fn covariance_is_true() {
        let (camera, mut nees) = (camera(), 0.0);
        let problems = 4000;
        for seed in 0..problems {
            let mut rng = SmallRng::seed_from_u64(seed);
            let point = Vector3::from_fn(|_, _| rng.random_range(-0.1..0.1));
            let observations: Vec<_> = (0..3)
                .map(|k| {
                    let pose = looking_at_origin([0.1, 0.3 * f64::from(k), 0.2], 0.7);
                    let mut observation = observe(&camera, &pose, &point);
                    let root = Matrix2::new(1.5, 0.0, 0.6, 0.5);
                    observation.covariance_px = root * root.transpose();
                    observation.pixel += root * Vector2::from_fn(|_, _| StandardNormal.sample(&mut rng));
                    observation
                })
                .collect();
            let found = triangulate(&observations).unwrap();
            let error = found.point_in_world - point;
            nees += (error.transpose() * found.covariance.try_inverse().unwrap() * error)[0] / problems as f64;
        }
        // Chi-squared with 3 degrees of freedom: mean 3, standard error 0.04 over 4,000 problems.
        assert!((2.85..3.15).contains(&nees), "{nees}");
    }

    /// With the second observation changed.
    fn attempt<'a>(
        pair: &[Observation<'a>; 2],
        change: impl FnOnce(&mut Observation<'a>),
    ) -> Result<Vector3<f64>, TriangulationError> {
        let mut changed = pair.clone();
        change(&mut changed[1]);
        triangulate(&changed).map(|found| found.point_in_world)
    }

    #[test]
    fn unusable_observations_are_named() {
        let camera = camera().with_opencv_distortion(&[-0.3, 0.0, 0.0, 0.0]).unwrap();
        let point = Vector3::new(0.01, 0.02, 0.0);
        let pair =
            [[0.0, 0.0, 0.0], [0.0, 0.4, 0.0]].map(|turn| observe(&camera, &looking_at_origin(turn, 0.6), &point));
        assert!(attempt(&pair, |_| ()).is_ok());
        assert_eq!(triangulate(&pair[..1]).map(|_| ()), Err(TriangulationError::TooFew(1)));
        assert_eq!(attempt(&pair, |o| o.pixel.x = f64::NAN), Err(TriangulationError::NotFinite { index: 1 }));
        assert_eq!(
            attempt(&pair, |o| o.covariance_px = -Matrix2::identity()),
            Err(TriangulationError::Covariance { index: 1 })
        );
        let folded = TriangulationError::Pixel { index: 1, source: ProjectionError::OutsideLens };
        assert_eq!(attempt(&pair, |o| o.pixel.x = 9e4), Err(folded));
        assert_eq!(attempt(&pair, |o| *o = pair[0].clone()), Err(TriangulationError::ParallelRays));
        // Rays that part in front of the cameras.
        assert!(matches!(attempt(&pair, |o| o.pixel.x += 400.0), Err(TriangulationError::BehindCamera { .. })));
    }
}
