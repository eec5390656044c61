use nalgebra::Vector3;
use thiserror::Error;

use super::hierarchy::{Hierarchy, part, spatial_order};
use super::least_maximum::least_maximum;
use crate::evaluation::mesh::ObjectMesh;
use posed_core::geometry::{Pose, Symmetries};

/// Steps of a turn about an axis of revolution: as the BOP toolkit, `ceil(pi / max_sym_disc_step)` with a step of 0.01.
const STEPS_OF_A_TURN: u32 = 315;
/// Of more vertices than `2^FINEST`, a sample stands for all where nearest vertices are searched.
const FINEST: u32 = 12;
/// Samples for estimates that are so far off that fewer vertices say as much.
const COARSER: [u32; 3] = [6, 8, 10];
/// A sample is fine enough if its error is at most this share of the distance.
const FINE_ENOUGH: f64 = 0.1;
/// Directions in which the outermost vertex may well be the worst one.
const DIRECTIONS: u32 = 128;

/// A mesh that is no object's.
#[allow(missing_docs, reason = "the messages say it")]
#[derive(Clone, Copy, Debug, Error, PartialEq)]
pub enum ModelPointsError {
    #[error("the mesh has no vertices")]
    NoVertices,
    #[error("the mesh has a vertex whose coordinates are not finite")]
    NotFinite,
    #[error("the object's diameter is {0} m; it must be a positive number")]
    Diameter(f64),
}

/// The vertices of an object's mesh (frame `object`, metres) and its symmetries, prepared once for the errors of many poses.
#[derive(Clone, Debug)]
pub struct ModelPoints {
    vertices: Hierarchy<3>,
    diameter_m: f64,
    symmetries: Symmetries,
    /// The symmetry group with turns about an axis of revolution in steps, `object_from_object`.
    motions: Vec<Pose>,
    /// Vertices that stand for all: from coarse to fine, the last one is the finest.
    samples: Vec<Sample>,
    /// Places of vertices that are probably the worst ones of a pose, where there are several to try.
    outermost: Vec<usize>,
}

/// One vertex for each of equal parts of all vertices.
#[derive(Clone, Debug)]
struct Sample {
    /// Places of the vertices, and the share of all vertices that each stands for.
    parts: Vec<(usize, f64)>,
    /// Mean distance of all vertices from those that stand for them, metres.
    radius_m: f64,
}

impl ModelPoints {
    /// Of a mesh with any number of vertices: about 100 ms for a quarter of a million.
    ///
    /// # Errors
    /// When there are no vertices, or there is a number that cannot be.
    pub fn new(mesh: &ObjectMesh) -> Result<Self, ModelPointsError> {
        if mesh.vertices.is_empty() {
            return Err(ModelPointsError::NoVertices);
        }
        if !mesh.vertices.iter().flatten().all(|value| value.is_finite()) {
            return Err(ModelPointsError::NotFinite);
        }
        if !(mesh.diameter_m.is_finite() && mesh.diameter_m > 0.0) {
            return Err(ModelPointsError::Diameter(mesh.diameter_m));
        }
        let mut vertices = mesh.vertices.clone();
        spatial_order(&mut vertices);
        let coarser =
            COARSER.iter().filter(|_| vertices.len() > 1 << FINEST).map(|depth| Sample::of(&vertices, *depth));
        let samples = coarser.chain([Sample::of(&vertices, FINEST)]).collect();
        let symmetries = mesh.symmetries.clone();
        let motions = motions(&symmetries);
        let outermost = if motions.len() > 1 { outermost(&vertices) } else { Vec::new() };
        Ok(Self {
            vertices: Hierarchy::new(vertices),
            diameter_m: mesh.diameter_m,
            symmetries,
            motions,
            samples,
            outermost,
        })
    }

    /// The object's diameter, metres.
    #[must_use]
    pub fn diameter_m(&self) -> f64 {
        self.diameter_m
    }

    /// The object's symmetries.
    #[must_use]
    pub fn symmetries(&self) -> &Symmetries {
        &self.symmetries
    }

    /// The middle of the box around the vertices, frame `object`, metres.
    #[must_use]
    pub fn centre(&self) -> Vector3<f64> {
        let [low, high] = self.vertices.bounds();
        (low + high) / 2.0
    }

    /// ADD: the mean distance of all vertices under both poses, metres. Hinterstoisser et al. (ACCV 2012), section 4.1.
    #[must_use]
    pub fn add_m(&self, estimate: &Pose, truth: &Pose) -> f64 {
        let apart = |vertex: &Vector3<f64>| (estimate.transform(vertex) - truth.transform(vertex)).norm();
        self.vertices().iter().map(apart).sum::<f64>() / self.vertices().len() as f64
    }

    /// ADD-S (ADI): the mean distance, metres, of vertices under the true pose from the nearest of all vertices under the
    /// estimate. Hinterstoisser et al. (ACCV 2012), section 4.1.
    ///
    /// Exact for up to 4,096 vertices. Of more, 4,096 are searched for: one for each of as many compact parts of equally many
    /// vertices, the one nearest to the part's mean. The error is at most [`ModelPoints::sampling_radius_m`], and commonly a
    /// hundredth of it, since within a part errors cancel. Where that radius with 64, 256 or 1,024 parts is below a tenth of the
    /// distance, which is then far above any threshold, those do.
    #[must_use]
    pub fn add_s_m(&self, estimate: &Pose, truth: &Pose) -> f64 {
        let estimated_from_true = estimate.inverse() * *truth;
        let distance = |vertex: &Vector3<f64>| self.vertices.distance(&estimated_from_true.transform(vertex));
        let mut mean_m = f64::INFINITY;
        for sample in &self.samples {
            mean_m = sample.mean(|place| distance(&self.vertices()[place]));
            if sample.radius_m <= FINE_ENOUGH * mean_m {
                break;
            }
        }
        mean_m
    }

    /// ADD, or ADD-S for an object with symmetries, metres.
    #[must_use]
    pub fn average_distance_m(&self, estimate: &Pose, truth: &Pose) -> f64 {
        if self.symmetries.is_trivial() { self.add_m(estimate, truth) } else { self.add_s_m(estimate, truth) }
    }

    /// The mean distance (metres) of vertices from those that stand for them in [`ModelPoints::add_s_m`]; 0 where each stands for
    /// itself. The distance to the nearest vertex differs between two points by no more than they are apart.
    #[must_use]
    pub fn sampling_radius_m(&self) -> f64 {
        self.samples.last().map_or(0.0, |finest| finest.radius_m)
    }

    /// Vertices in an order in which neighbours are near each other.
    pub(super) fn vertices(&self) -> &[Vector3<f64>] {
        self.vertices.points()
    }

    /// The mean over all vertices of a value that is known for each place, from the finest sample.
    pub(super) fn sampled_mean(&self, value: impl Fn(usize) -> f64) -> f64 {
        self.samples.last().map_or(f64::INFINITY, |finest| finest.mean(value))
    }

    /// The largest value over all vertices, the least over all poses that look like the true one: `value` of such a pose and of a
    /// vertex's place.
    pub(super) fn least_maximum(&self, truth: &Pose, value: impl Fn(&Pose, usize) -> f64) -> f64 {
        let equals: Vec<_> = self.motions.iter().map(|motion| *truth * *motion).collect();
        least_maximum(equals.len(), self.vertices().len(), &self.outermost, |equal, place| value(&equals[equal], place))
    }
}

impl Sample {
    /// Of points in spatial order; of no more than `2^depth` points all.
    fn of(vertices: &[Vector3<f64>], depth: u32) -> Self {
        let all = vertices.len();
        if all <= 1 << depth {
            let parts = (0..all).map(|place| (place, 1.0 / all as f64)).collect();
            return Self { parts, radius_m: 0.0 };
        }
        let mut sum_m = 0.0;
        let stands_for = |index| {
            let places = part(index, all, depth);
            let members = &vertices[places.clone()];
            let middle = members.iter().sum::<Vector3<f64>>() / members.len() as f64;
            let from_middle = |place: &usize| (vertices[*place] - middle).norm_squared();
            let nearest =
                places.clone().min_by(|a, b| from_middle(a).total_cmp(&from_middle(b))).unwrap_or(places.start);
            sum_m += members.iter().map(|member| (member - vertices[nearest]).norm()).sum::<f64>();
            (nearest, members.len() as f64 / all as f64)
        };
        let parts = (0..1 << depth).map(stands_for).collect();
        Self { parts, radius_m: sum_m / all as f64 }
    }

    fn mean(&self, value: impl Fn(usize) -> f64) -> f64 {
        self.parts.iter().map(|(place, share)| share * value(*place)).sum()
    }
}

/// The outermost vertices in directions all around, on a spiral of Fibonacci.
fn outermost(vertices: &[Vector3<f64>]) -> Vec<usize> {
    let golden_angle = std::f64::consts::PI * (3.0 - 5.0_f64.sqrt());
    let along = |step: u32| {
        let z = 1.0 - 2.0 * (f64::from(step) + 0.5) / f64::from(DIRECTIONS);
        let (sine, cosine) = (golden_angle * f64::from(step)).sin_cos();
        let direction = Vector3::new(cosine, sine, 0.0) * (1.0 - z * z).sqrt() + Vector3::z() * z;
        (0..vertices.len()).max_by(|a, b| vertices[*a].dot(&direction).total_cmp(&vertices[*b].dot(&direction)))
    };
    let mut places: Vec<_> = (0..DIRECTIONS).filter_map(along).collect();
    places.sort_unstable();
    places.dedup();
    places
}

/// The symmetry group as `misc.get_symmetry_transformations` of the BOP toolkit makes it discrete.
fn motions(symmetries: &Symmetries) -> Vec<Pose> {
    let [axis] = symmetries.continuous() else { return symmetries.discrete().to_vec() };
    let turns = (0..STEPS_OF_A_TURN)
        .map(|step| axis.turn(std::f64::consts::TAU * f64::from(step) / f64::from(STEPS_OF_A_TURN)));
    let turns: Vec<_> = turns.collect();
    symmetries.discrete().iter().flat_map(|motion| turns.iter().map(move |turn| *turn * *motion)).collect()
}
