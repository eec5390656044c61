use nalgebra::{Matrix6, Rotation3, Vector3, Vector6};
use posed::evaluation::{Consistency, GroupConsistency, PoseNees};
use posed_core::geometry::{Covariance6, Pose};
use proptest::prelude::*;

use crate::objects::{any_pose, can, points, symmetries};

const POSES: usize = 4000;

/// A covariance as a solver states it: the depth is worst, and turns and shifts go together.
fn covariance() -> Covariance6 {
    let mut root = Matrix6::from_diagonal(&Vector6::new(2e-3, 2e-3, 8e-3, 0.02, 0.03, 0.01));
    root[(3, 1)] = 0.015;
    root[(4, 0)] = -0.01;
    root[(2, 5)] = 3e-3;
    root * root.transpose()
}

/// Sums of twelve uniform numbers are nearly Gaussian.
fn gaussian(random: &mut fastrand::Rng) -> f64 {
    (0..12).map(|_| random.f64()).sum::<f64>() - 6.0
}

/// Poses whose true ones are off by as much as a covariance says, times a factor.
fn simulated(kind: usize, factor: f64) -> Consistency {
    let symmetries = &symmetries()[kind];
    let points = points(&can(3, 9, symmetries.clone()));
    let root = covariance().cholesky().unwrap().l();
    let mut random = fastrand::Rng::with_seed(3);
    let errors = (0..POSES).map(|_| {
        let turn = Vector3::from_fn(|_, _| gaussian(&mut random));
        let estimate = Pose::new(Rotation3::new(turn), Vector3::new(0.1, -0.05, 0.7));
        let step = factor * root * Vector6::from_fn(|_, _| gaussian(&mut random));
        let (shift, turn) = (step.fixed_rows::<3>(0).into_owned(), step.fixed_rows::<3>(3).into_owned());
        let mut truth = estimate.perturbed(&shift, &turn);
        // Any pose that looks alike is as true.
        truth = truth * symmetries.discrete()[random.usize(..symmetries.discrete().len())];
        if let [axis] = symmetries.continuous() {
            truth = truth * axis.turn(6.0 * random.f64());
        }
        PoseNees::new(&points, &estimate, &covariance(), &truth)
    });
    Consistency::of(&errors.collect::<Vec<_>>())
}

fn parts(consistency: &Consistency) -> [&GroupConsistency; 4] {
    [&consistency.pose, &consistency.depth, &consistency.lateral, &consistency.rotation]
        .map(|part| part.as_ref().unwrap())
}

#[test]
fn honest_covariances_are_found_honest() {
    for (kind, degrees) in [[6.0, 1.0, 2.0, 3.0], [6.0, 1.0, 2.0, 3.0], [5.0, 1.0, 2.0, 2.0]].into_iter().enumerate() {
        let consistency = simulated(kind, 1.0);
        assert_eq!(consistency.unusable, 0);
        for (part, degrees) in parts(&consistency).into_iter().zip(degrees) {
            assert!((part.mean_degrees - degrees).abs() < 1e-12);
            assert!((part.mean / degrees - 1.0).abs() < 0.06, "{kind} {degrees}: {}", part.mean);
            assert!((part.sigma_ratio - 1.0).abs() < 0.03);
            let levels: Vec<_> = part.coverage.iter().map(|coverage| coverage.level).collect();
            assert_eq!(levels, [0.5, 0.9, 0.95]);
            for coverage in &part.coverage {
                assert!((coverage.share - coverage.level).abs() < 0.025, "{kind} {degrees}: {coverage:?}");
            }
        }
    }
}

#[test]
fn errors_of_twice_the_sigma_are_told() {
    for part in parts(&simulated(0, 2.0)) {
        assert!((part.sigma_ratio - 2.0).abs() < 0.06, "{}", part.sigma_ratio);
        assert!(part.coverage[2].share < 0.75);
    }
}

#[test]
fn the_groups_are_along_and_across_the_ray() {
    let points = points(&can(3, 9, symmetries()[0].clone()));
    let estimate = Pose::new(Rotation3::identity(), Vector3::new(0.3, -0.2, 0.6));
    let variance = 1e-4;
    let ray = estimate.transform(&points.centre()).normalize();
    let nees = |shift: Vector3<f64>| {
        let truth = estimate.perturbed(&shift, &Vector3::zeros());
        // Only the origin's place is uncertain.
        let mut covariance = Matrix6::identity() * variance;
        covariance.fixed_view_mut::<3, 3>(3, 3).copy_from(&(nalgebra::Matrix3::identity() * 1e-12));
        PoseNees::new(&points, &estimate, &covariance, &truth).unwrap()
    };
    let along = nees(ray * 0.02);
    assert!((along.depth.value - 4.0).abs() < 1e-3 && along.lateral.value < 1e-9, "{along:?}");
    let across = nees(ray.cross(&Vector3::y()).normalize() * 0.02);
    assert!((across.lateral.value - 4.0).abs() < 1e-3 && across.depth.value < 1e-9, "{across:?}");
    assert!((across.pose.value - 4.0).abs() < 1e-9 && across.rotation.value < 1e-9);
}

proptest! {
    #[test]
    fn nees_is_the_quadratic_form_of_the_step(
        estimate in any_pose(), step in prop::array::uniform6(-0.1..0.1f64), roots in prop::collection::vec(-1.0..1.0f64, 36),
    ) {
        let points = points(&can(3, 9, symmetries()[0].clone()));
        let step = Vector6::from(step);
        let truth = estimate.perturbed(&step.fixed_rows::<3>(0).into(), &step.fixed_rows::<3>(3).into());
        let root = Matrix6::from_vec(roots);
        let covariance = root * root.transpose() * 1e-3 + Matrix6::identity() * 1e-4;
        let expected = step.dot(&(covariance.try_inverse().unwrap() * step));
        let found = PoseNees::new(&points, &estimate, &covariance, &truth).unwrap();
        prop_assert!((found.pose.value - expected).abs() < 1e-6 * (1.0 + expected));
        prop_assert!(found.rotation.value <= found.pose.value * (1.0 + 1e-9));
    }

    #[test]
    fn what_is_no_covariance_is_counted(entry in 0..36usize, value in prop::sample::select(vec![f64::NAN, f64::INFINITY, -1.0, 5.0])) {
        let points = points(&can(3, 9, symmetries()[2].clone()));
        let pose = Pose::new(Rotation3::identity(), Vector3::new(0.1, 0.0, 0.6));
        let mut broken = Matrix6::identity();
        broken[entry] = value;
        // A larger variance is still one.
        prop_assume!(entry % 7 != 0 || value < 5.0 || !value.is_finite());
        let errors = [PoseNees::new(&points, &pose, &broken, &pose), PoseNees::new(&points, &pose, &Matrix6::zeros(), &pose)];
        let consistency = Consistency::of(&errors);
        prop_assert_eq!((consistency.unusable, consistency.pose), (2, None));
    }
}

#[test]
fn a_singular_covariance_is_unusable() {
    let points = points(&can(3, 9, symmetries()[0].clone()));
    let pose = Pose::new(Rotation3::identity(), Vector3::new(0.1, 0.0, 0.6));
    let direction = Vector6::new(1.0, 2.0, 3.0, 1.0, -1.0, 0.5);
    let flat = direction * direction.transpose();
    assert_eq!(PoseNees::new(&points, &pose, &flat, &pose), None);
    assert!(PoseNees::new(&points, &pose, &(flat + Matrix6::identity() * 1e-6), &pose).is_some());
}
