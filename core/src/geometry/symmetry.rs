use nalgebra::{Rotation3, Unit, Vector3};
use thiserror::Error;

use super::covariance::{Covariance6, covariance_about};
use super::motion_group::{MAX_GROUP, MEASURED_WITHIN_DEG, MEASURED_WITHIN_MM, SAME, generated, nearest_group};
use super::pose::{Pose, PoseError};
use super::rotation::skew;
use super::units::METRES_PER_MILLIMETRE;

/// A rotation by any angle about an axis in frame `object`.
#[derive(Clone, Debug, PartialEq)]
pub struct ContinuousSymmetry {
    /// Direction of the axis.
    pub axis: Unit<Vector3<f64>>,
    /// A point on the axis, metres.
    pub offset_m: Vector3<f64>,
}

/// Symmetries as BOP's `models_info.json` states them, in millimetres; other fields are left alone.
#[derive(Clone, Debug, Default)]
#[cfg_attr(feature = "serde", derive(serde::Deserialize))]
pub struct BopSymmetries {
    /// 4x4 transforms, row-major.
    #[cfg_attr(feature = "serde", serde(default))]
    pub symmetries_discrete: Vec<[f64; 16]>,
    /// Axes of revolution.
    #[cfg_attr(feature = "serde", serde(default))]
    pub symmetries_continuous: Vec<BopAxis>,
}

/// An axis of revolution in BOP's syntax.
#[derive(Clone, Debug)]
#[cfg_attr(feature = "serde", derive(serde::Deserialize, serde::Serialize))]
pub struct BopAxis {
    /// Its direction, of any length.
    pub axis: [f64; 3],
    /// A point on it, millimetres.
    #[cfg_attr(feature = "serde", serde(default))]
    pub offset: [f64; 3],
}

/// The motions of frame `object` under which an object looks the same, as the BOP format states them in
/// `models_info.json`.
#[derive(Clone, Debug, PartialEq)]
pub struct Symmetries {
    /// The whole group that the stated discrete symmetries generate, identity first.
    group: Vec<Pose>,
    continuous: Vec<ContinuousSymmetry>,
}

/// Symmetries that cannot be those of an object.
#[allow(missing_docs, reason = "the messages say it")]
#[derive(Clone, Debug, Error, PartialEq)]
pub enum SymmetryError {
    #[error(
        "the discrete symmetries generate more than {MAX_GROUP} motions, so they form no finite group, and none with turns of \
         60 degrees or more is within {MEASURED_WITHIN_DEG} degrees and {MEASURED_WITHIN_MM} mm of them; an angle that is \
         not a whole fraction of a turn, or a translation, is the usual cause"
    )]
    NotFinite,
    #[error("discrete symmetry {index} is not a rigid motion: {source}")]
    Motion { index: usize, source: PoseError },
    #[error(
        "continuous symmetry {index} has no axis: its direction must be three finite numbers that are not all zero"
    )]
    Axis { index: usize },
    #[error("{0} continuous symmetries; an object has at most one axis of revolution (a sphere has no orientation)")]
    SeveralAxes(usize),
}

impl Default for Symmetries {
    fn default() -> Self {
        Self { group: vec![Pose::identity()], continuous: Vec::new() }
    }
}

impl Symmetries {
    /// From discrete symmetries (`object_from_object`; the identity may be left out, and so may products of others)
    /// and at most one axis of revolution. Discrete ones that were measured, and so generate no finite group, are replaced by
    /// those of the nearest group.
    ///
    /// # Errors
    /// When the discrete ones are those of no finite group, nor near to one, or there are several axes.
    pub fn new(discrete: &[Pose], continuous: Vec<ContinuousSymmetry>) -> Result<Self, SymmetryError> {
        if continuous.len() > 1 {
            return Err(SymmetryError::SeveralAxes(continuous.len()));
        }
        let group = generated(discrete).or_else(|| nearest_group(discrete)).ok_or(SymmetryError::NotFinite)?;
        Ok(Self { group, continuous })
    }

    /// Whether the object has no symmetry.
    #[must_use]
    pub fn is_trivial(&self) -> bool {
        self.group.len() == 1 && self.continuous.is_empty()
    }

    /// All discrete symmetries, identity first.
    #[must_use]
    pub fn discrete(&self) -> &[Pose] {
        &self.group
    }

    /// The axis of revolution, if there is one.
    #[must_use]
    pub fn continuous(&self) -> &[ContinuousSymmetry] {
        &self.continuous
    }

    /// The same symmetries of another frame that is fixed to the object.
    #[must_use]
    pub fn in_frame(&self, frame_from_object: &Pose) -> Self {
        let object_from_frame = frame_from_object.inverse();
        let group = self.group.iter().map(|symmetry| *frame_from_object * *symmetry * object_from_frame).collect();
        let turned = |symmetry: &ContinuousSymmetry| ContinuousSymmetry {
            axis: frame_from_object.rotation() * symmetry.axis,
            offset_m: frame_from_object.transform(&symmetry.offset_m),
        };
        Self { group, continuous: self.continuous.iter().map(turned).collect() }
    }

    /// Of all poses that look like `camera_from_object`, the one turned least from `like`: the previous pose of a
    /// track, or any constant. Every symmetric equal of a pose gives the same answer, up to rounding and except where
    /// two answers are equally near.
    #[must_use]
    pub fn nearest(&self, camera_from_object: &Pose, like: &Pose) -> Pose {
        let mut best = *camera_from_object;
        let mut best_angle = f64::INFINITY;
        for symmetry in &self.group {
            let mut pose = *camera_from_object * *symmetry;
            if let [axis] = self.continuous.as_slice() {
                pose = pose * axis.turn_towards(&pose, like);
            }
            let angle = pose.angle_to(like);
            // The margin lets rounding decide nothing: of equally near poses the first of the group wins.
            if angle < best_angle - SAME {
                (best, best_angle) = (pose, angle);
            }
        }
        best
    }

    /// [`Symmetries::nearest`] to the object's axes along those of the camera: the same choice for every image.
    #[must_use]
    pub fn canonical(&self, camera_from_object: &Pose) -> Pose {
        self.nearest(camera_from_object, &Pose::identity())
    }

    /// [`Symmetries::nearest`] with the covariance that it has: the same step, seen at another origin of the object.
    #[must_use]
    pub fn nearest_with(&self, pose: &Pose, covariance: &Covariance6, like: &Pose) -> (Pose, Covariance6) {
        let nearest = self.nearest(pose, like);
        (nearest, covariance_about(covariance, &(nearest.translation() - pose.translation())))
    }

    /// [`Symmetries::canonical`] with the covariance that it has.
    #[must_use]
    pub fn canonical_with(&self, pose: &Pose, covariance: &Covariance6) -> (Pose, Covariance6) {
        self.nearest_with(pose, covariance, &Pose::identity())
    }
}

impl TryFrom<&BopSymmetries> for Symmetries {
    type Error = SymmetryError;

    fn try_from(stated: &BopSymmetries) -> Result<Self, SymmetryError> {
        let discrete = stated
            .symmetries_discrete
            .iter()
            .enumerate()
            .map(|(index, matrix)| {
                let mut matrix = nalgebra::Matrix4::from_row_slice(matrix);
                for row in 0..3 {
                    matrix[(row, 3)] *= METRES_PER_MILLIMETRE;
                }
                Pose::from_matrix(&matrix).map_err(|source| SymmetryError::Motion { index, source })
            })
            .collect::<Result<Vec<_>, _>>()?;
        let continuous = stated
            .symmetries_continuous
            .iter()
            .enumerate()
            .map(|(index, BopAxis { axis, offset })| {
                let finite = axis.iter().chain(offset).all(|v| v.is_finite());
                let direction = Unit::try_new(Vector3::from(*axis), 1e-9).filter(|_| finite);
                let axis = direction.ok_or(SymmetryError::Axis { index })?;
                Ok(ContinuousSymmetry { axis, offset_m: Vector3::from(*offset) * METRES_PER_MILLIMETRE })
            })
            .collect::<Result<Vec<_>, _>>()?;
        Self::new(&discrete, continuous)
    }
}

impl ContinuousSymmetry {
    /// The motion of this symmetry by an angle (radians).
    #[must_use]
    pub fn turn(&self, angle: f64) -> Pose {
        let rotation = Rotation3::from_axis_angle(&self.axis, angle);
        Pose::new(rotation, self.offset_m - rotation * self.offset_m)
    }

    /// The motion after which a pose's rotation is nearest to another's.
    fn turn_towards(&self, pose: &Pose, like: &Pose) -> Pose {
        // The angle between them is least where the trace of `M exp(angle [a]x)` is greatest, M = likeᵀ pose.
        let apart = (like.rotation().inverse() * pose.rotation()).into_inner();
        let sine = (apart * skew(&self.axis)).trace();
        let cosine = apart.trace() - self.axis.dot(&(apart * *self.axis));
        self.turn(sine.atan2(cosine))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::geometry::pose::tests::any_pose;
    use proptest::prelude::*;
    use std::f64::consts::PI;

    fn half_turn(axis: Vector3<f64>) -> Pose {
        Pose::new(Rotation3::new(axis * PI), Vector3::zeros())
    }

    /// A bar with three half turns, stated by two of them.
    fn bar() -> Symmetries {
        Symmetries::new(&[half_turn(Vector3::x()), half_turn(Vector3::y())], Vec::new()).unwrap()
    }

    /// A can that looks the same upside down; its axis is not through the origin.
    fn can() -> Symmetries {
        let axis = ContinuousSymmetry { axis: Vector3::z_axis(), offset_m: Vector3::new(0.02, 0.01, 0.0) };
        let flip = half_turn(Vector3::x());
        let about_axis = Pose::new(*flip.rotation(), axis.offset_m - flip.rotation() * axis.offset_m);
        Symmetries::new(&[about_axis], vec![axis]).unwrap()
    }

    fn close(a: &Pose, b: &Pose) -> bool {
        (a.matrix() - b.matrix()).norm() < 1e-6
    }

    proptest! {
        #[test]
        fn all_equals_of_a_pose_have_one_canonical_form(pose in any_pose(), element in 0..4usize) {
            let bar = bar();
            let equal = pose * bar.discrete()[element];
            let canonical = bar.canonical(&pose);
            // Where two equals are almost equally near, either may win.
            let angles = bar.discrete().iter().map(|s| (pose * *s).angle_to(&Pose::identity()));
            prop_assume!(angles.filter(|a| a - canonical.angle_to(&Pose::identity()) < 1e-3).count() == 1);
            prop_assert!(close(&bar.canonical(&equal), &canonical));
        }

        #[test]
        fn a_turn_about_an_axis_of_revolution_changes_nothing(pose in any_pose(), angle in -3.0..3.0f64, flip in 0..2usize) {
            let can = can();
            let equal = pose * can.discrete()[flip] * can.continuous()[0].turn(angle);
            let canonical = can.canonical(&pose);
            let angles = can.discrete().iter().map(|s| can.nearest(&(pose * *s), &Pose::identity()));
            let far = angles.map(|p| p.angle_to(&Pose::identity())).all(|a| (a - canonical.angle_to(&Pose::identity())).abs() < 1e-6);
            prop_assert!(far);
            // Upright or upside down alike where the axis lies across the camera's.
            prop_assume!(pose.rotation().matrix().m33.abs() > 1e-3);
            prop_assert!(close(&can.canonical(&equal), &canonical));
        }

        #[test]
        fn the_canonical_form_looks_the_same_and_is_its_own(pose in any_pose()) {
            let can = can();
            let canonical = can.canonical(&pose);
            let on_axis = |t: f64| can.continuous()[0].offset_m + Vector3::z() * t;
            let seen = |p: &Pose, t: f64| p.transform(&on_axis(t));
            let upright = (seen(&canonical, 0.1) - seen(&pose, 0.1)).norm() < 1e-9;
            let flipped = (seen(&canonical, 0.1) - seen(&pose, -0.1)).norm() < 1e-9;
            prop_assert!(upright || flipped);
            prop_assert!(close(&can.canonical(&canonical), &canonical));
        }

        #[test]
        fn another_frame_has_the_same_symmetries(frame in any_pose(), pose in any_pose(), like in any_pose()) {
            let can = can();
            let elsewhere = can.in_frame(&frame);
            let there = elsewhere.nearest(&(pose * frame.inverse()), &(like * frame.inverse()));
            prop_assert!(close(&(there * frame), &can.nearest(&pose, &like)));
        }

        #[test]
        fn nearest_follows_a_track(pose in any_pose(), step in prop::array::uniform3(-0.1..0.1f64), element in 0..4usize) {
            let bar = bar();
            let next = pose.perturbed(&Vector3::zeros(), &Vector3::from(step));
            prop_assert!(close(&bar.nearest(&(next * bar.discrete()[element]), &pose), &next));
        }
    }

    #[test]
    fn the_group_is_completed() {
        assert_eq!(bar().discrete().len(), 4);
        let fifth = Pose::new(Rotation3::new(Vector3::z() * (2.0 * PI / 5.0)), Vector3::zeros());
        assert_eq!(Symmetries::new(&[fifth], Vec::new()).unwrap().discrete().len(), 5);
        assert!(Symmetries::default().is_trivial() && !can().is_trivial());
    }

    fn stated(discrete: &[[f64; 16]], axes: &[([f64; 3], [f64; 3])]) -> Result<Symmetries, SymmetryError> {
        Symmetries::try_from(&BopSymmetries {
            symmetries_discrete: discrete.to_vec(),
            symmetries_continuous: axes.iter().map(|(axis, offset)| BopAxis { axis: *axis, offset: *offset }).collect(),
        })
    }

    #[rustfmt::skip]
    const HALF_TURN: [f64; 16] = [
        -1.0, 0.0, 0.0, 10.0,
        0.0, -1.0, 0.0, 0.0,
        0.0, 0.0, 1.0, 0.0,
        0.0, 0.0, 0.0, 1.0,
    ];

    #[test]
    fn millimetres_of_bop_become_metres() {
        let symmetries = stated(&[HALF_TURN], &[([0.0, 0.0, 2.0], [5.0, 0.0, 0.0])]).unwrap();
        let half_turn = symmetries.discrete()[1].transform(&Vector3::new(0.02, 0.0, 0.0));
        assert!((half_turn - Vector3::new(-0.01, 0.0, 0.0)).norm() < 1e-12);
        assert_eq!(symmetries.continuous()[0].axis, Vector3::z_axis());
        assert!((symmetries.continuous()[0].offset_m.x - 0.005).abs() < 1e-12);
        assert!(stated(&[], &[]).unwrap().is_trivial());
    }

    #[cfg(feature = "serde")]
    #[test]
    fn reads_what_bop_states() {
        let json = r#"{"diameter": 90, "symmetries_continuous": [{"axis": [0, 0, 2]}]}"#;
        let read: BopSymmetries = serde_json::from_str(json).unwrap();
        assert!(read.symmetries_discrete.is_empty());
        assert_eq!(
            (read.symmetries_continuous[0].axis, read.symmetries_continuous[0].offset),
            ([0.0, 0.0, 2.0], [0.0; 3])
        );
    }

    /// Measured half turns of LINEMOD: eggbox and glue, off by 0.19 and 1.53 degrees.
    #[rustfmt::skip]
    const MEASURED: [[f64; 16]; 2] = [
        [
            -0.999_964, -0.003_337_77, -0.007_745_2, 0.232_611,
            0.003_214_62, -0.999_869, 0.015_859_3, 0.694_388,
            -0.007_797_12, 0.015_833_8, 0.999_844, -0.079_206_3,
            0.0, 0.0, 0.0, 1.0,
        ],
        [
            -0.999_633, 0.026_679, 0.004_793_36, -0.262_139,
            -0.026_674_4, -0.999_644, 0.001_005_04, -0.197_966,
            0.004_818_47, 0.000_876_815, 0.999_988, 0.032_165_2,
            0.0, 0.0, 0.0, 1.0,
        ],
    ];

    fn is_exact(symmetries: &Symmetries) -> bool {
        let group = symmetries.discrete();
        let known = |product: Pose| group.iter().any(|element| (element.matrix() - product.matrix()).norm() < 1e-9);
        group.iter().all(|a| group.iter().all(|b| known(*a * *b)))
    }

    #[test]
    fn measured_half_turns_become_exact() {
        for (measured, off_deg) in MEASURED.iter().zip([0.19, 1.53]) {
            let symmetries = stated(&[*measured], &[]).unwrap();
            assert_eq!((symmetries.discrete().len(), is_exact(&symmetries)), (2, true));
            let rotation = nalgebra::Matrix3::from_fn(|row, column| measured[4 * row + column]);
            let off = (symmetries.discrete()[1].rotation().matrix() - rotation).norm() / 2.0_f64.sqrt();
            assert!((off.to_degrees() - off_deg).abs() < 0.01, "{}", off.to_degrees());
            let shift =
                symmetries.discrete()[1].translation() - 1e-3 * Vector3::new(measured[3], measured[7], measured[11]);
            assert!(shift.norm() < 1e-4, "{shift}");
        }
    }

    /// Three half turns whose axes do not quite meet, nor at right angles: only together do they make an exact group.
    #[test]
    fn measured_symmetries_become_one_group() {
        let off = |axis: Vector3<f64>, x_mm: f64| {
            Pose::new(Rotation3::new(axis.normalize() * (PI - 0.01)), Vector3::new(1e-3 * x_mm, 0.0, 2e-4))
        };
        let axes = [Vector3::new(1.0, 0.01, 0.0), Vector3::new(0.0, 1.0, -0.01), Vector3::new(0.01, 0.0, 1.0)];
        let stated = [off(axes[0], 0.2), off(axes[1], 50.0), off(axes[2], 49.8)];
        for some in [&stated[..], &stated[1..]] {
            let symmetries = Symmetries::new(some, Vec::new()).unwrap();
            assert_eq!((symmetries.discrete().len(), is_exact(&symmetries)), (4, true));
            for motion in some {
                let nearest = symmetries.discrete().iter().map(|s| s.angle_to(motion)).fold(f64::INFINITY, f64::min);
                assert!(nearest < 0.03, "{nearest}");
            }
        }
        let sixth = Pose::new(Rotation3::new(Vector3::z() * (PI / 3.0 + 0.01)), Vector3::zeros());
        let symmetries = Symmetries::new(&[sixth], Vec::new()).unwrap();
        assert_eq!((symmetries.discrete().len(), is_exact(&symmetries)), (6, true));
    }

    #[test]
    fn what_is_exact_is_not_touched() {
        let about_axis = half_turn(Vector3::new(0.6, 0.0, 0.8));
        for turn in [about_axis, Pose::new(Rotation3::new(Vector3::z() * (PI / 6.0)), Vector3::zeros())] {
            assert_eq!(Symmetries::new(&[turn], Vec::new()).unwrap().discrete()[1], turn);
        }
    }

    #[test]
    fn what_is_too_far_from_a_symmetry_is_refused() {
        let turn = |degrees: f64, along_m: f64| {
            Symmetries::new(
                &[Pose::new(Rotation3::new(Vector3::z() * degrees.to_radians()), Vector3::z() * along_m)],
                Vec::new(),
            )
        };
        assert_eq!(turn(177.1, 0.0), Err(SymmetryError::NotFinite));
        assert_eq!(turn(179.0, 0.002), Err(SymmetryError::NotFinite));
        assert_eq!(turn(31.0, 0.0), Err(SymmetryError::NotFinite));
        assert_eq!(turn(1.0, 0.0), Err(SymmetryError::NotFinite));
        assert_eq!(turn(178.5, 0.0005).unwrap().discrete().len(), 2);
    }

    #[test]
    fn what_is_no_symmetry_is_refused() {
        let scaled = HALF_TURN.map(|value| 2.0 * value);
        let scaled = [&scaled[..15], &[1.0]].concat().try_into().unwrap();
        assert!(matches!(stated(&[scaled], &[]), Err(SymmetryError::Motion { index: 0, .. })));
        assert_eq!(stated(&[], &[([0.0; 3], [0.0; 3])]), Err(SymmetryError::Axis { index: 0 }));
        let odd = Pose::new(Rotation3::new(Vector3::z()), Vector3::zeros());
        assert_eq!(Symmetries::new(&[odd], Vec::new()), Err(SymmetryError::NotFinite));
        let shift = Pose::new(Rotation3::identity(), Vector3::x());
        assert_eq!(Symmetries::new(&[shift], Vec::new()), Err(SymmetryError::NotFinite));
        let axis = can().continuous()[0].clone();
        assert_eq!(Symmetries::new(&[], vec![axis.clone(), axis]), Err(SymmetryError::SeveralAxes(2)));
    }
}
