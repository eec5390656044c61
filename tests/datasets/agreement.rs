use nalgebra::{Rotation3, Vector3};
use posed::evaluation::agreement::{Nees, Observation, Spread, Totals, ViewDeviation, warnings};
use posed_core::geometry::{ContinuousSymmetry, Pose, Symmetries, covariance_about};
use posed_core::pnp::Status;
use proptest::prelude::*;

use crate::still_scene::{DIAMETER_M, agreement, camera, drawn, judged, shape, truth};
use posed::evaluation::agreement::Shape;

fn turn(axis: Vector3<f64>, degrees: f64) -> Pose {
    Pose::new(Rotation3::new(axis * degrees.to_radians()), Vector3::zeros())
}

fn deviations(shape: &Shape, observations: Vec<Observation>) -> Vec<ViewDeviation> {
    judged(shape, observations).into_iter().map(|one| one.deviation).collect()
}

fn spread_of_many(shape: &Shape, views: usize, change: impl Fn(&mut Observation)) -> Spread {
    let all: Vec<_> = (0..600)
        .flat_map(|seed| {
            let mut observations = drawn(&truth(), views, seed);
            observations.iter_mut().for_each(&change);
            deviations(shape, observations)
        })
        .collect();
    Spread::of(all.iter()).unwrap()
}

fn close(a: &ViewDeviation, b: &ViewDeviation) -> bool {
    let numbers = |one: &ViewDeviation| {
        let Nees { total, depth, lateral, rotation, .. } = one.nees;
        [1e3 * one.translation_m, 1e3 * one.depth_m, one.rotation_deg, total, depth, lateral, rotation]
    };
    numbers(a).iter().zip(numbers(b)).all(|(a, b)| (a - b).abs() < 1e-4 * (1.0 + b.abs()))
}

#[test]
fn true_covariances_have_the_nees_that_theory_says() {
    for views in [2, 3, 8] {
        let spread = spread_of_many(&shape(), views, |_| ());
        let found = [spread.nees_mean / 6.0, spread.nees_depth, spread.nees_lateral, spread.nees_rotation];
        assert!(found.iter().all(|mean| (mean - 1.0).abs() < 0.1), "{views}: {spread:?}");
        assert!(
            (spread.within_95 - 0.95).abs() < 0.015 && (spread.nees_median - 5.35).abs() < 0.4,
            "{views}: {spread:?}"
        );
    }
}

#[test]
fn covariances_that_are_too_small_are_told() {
    let mut observations = drawn(&truth(), 40, 7);
    for one in &mut observations {
        one.covariance *= 0.25;
    }
    let scenes = [agreement(&shape(), observations)];
    let totals = Totals::of(40, &scenes);
    assert!((totals.spread_of_ok.as_ref().unwrap().nees_mean / 24.0 - 1.0).abs() < 0.3, "{totals:?}");
    assert!(warnings(&totals, &scenes, DIAMETER_M).iter().any(|warning| warning.contains("covariances are too small")));
}

#[test]
fn a_turned_pose_is_a_flip_and_named() {
    let mut observations = drawn(&truth(), 6, 0);
    let others = deviations(&shape(), observations.clone());
    observations[3].world_from_object = observations[3].world_from_object * turn(Vector3::y(), 90.0);
    let scenes = [agreement(&shape(), observations)];
    for one in scenes[0].judged() {
        let turned = one.found.image_id == 3;
        assert_eq!((one.deviation.flipped, one.deviation.disagrees), (turned, turned), "{one:?}");
        assert!(
            turned || one.deviation.translation_m < 2.0 * others[one.found.image_id as usize].translation_m + 0.002
        );
    }
    let totals = Totals::of(6, &scenes);
    assert_eq!((totals.ok, totals.ok_disagreeing, totals.ok_flipped, totals.ok_alone), (6, 1, 1, 0));
    let said = warnings(&totals, &scenes, DIAMETER_M);
    assert!(said.iter().any(|warning| warning.ends_with("disagreement: image 3 (flipped)")), "{said:?}");
}

/// Nothing says which of two is wrong.
#[test]
fn two_views_get_their_difference() {
    let mut observations = drawn(&truth(), 2, 5);
    let apart = observations[0].world_from_object.step_to(&observations[1].world_from_object);
    let pair = deviations(&shape(), observations.clone());
    for one in &pair {
        assert!((one.translation_m - apart.fixed_rows::<3>(0).norm()).abs() < 1e-12);
        assert!((one.nees.total - pair[0].nees.total).abs() < 1e-9);
    }
    observations[0].world_from_object = observations[0].world_from_object * turn(Vector3::x(), 120.0);
    let scene = agreement(&shape(), observations);
    assert_eq!(scene.instances[0].support, 1);
    assert!(scene.judged().all(|one| one.deviation.flipped));
    let totals = Totals::of(2, &[scene]);
    assert_eq!((totals.without_consensus, totals.ok_flipped), (1, 2));
}

#[test]
fn a_pose_far_off_disagrees_or_is_alone() {
    for (metres, disagreeing, alone) in [(0.0, 0, 0), (0.03, 1, 0), (0.09, 1, 0), (0.3, 0, 1)] {
        let mut observations = drawn(&truth(), 5, 2);
        let shift = Vector3::new(metres, 0.0, 0.0);
        observations[2].world_from_object = observations[2].world_from_object.perturbed(&shift, &Vector3::zeros());
        let scene = agreement(&shape(), observations);
        let totals = Totals::of(5, &[scene]);
        assert_eq!((totals.instances, totals.ok), (1, 5));
        assert_eq!((totals.ok_disagreeing, totals.ok_alone), (disagreeing, alone), "{metres} m");
    }
}

#[test]
fn rejected_poses_have_no_say_but_are_compared() {
    let mut observations = drawn(&truth(), 5, 3);
    let ok = deviations(&shape(), observations[..2].to_vec());
    for one in &mut observations[2..] {
        one.world_from_object = one.world_from_object * turn(Vector3::z(), 90.0);
        one.status = Status::Rejected;
    }
    let all = deviations(&shape(), observations);
    assert!(close(&all[0], &ok[0]) && close(&all[1], &ok[1]));
    assert!(all[2..].iter().all(|one| one.flipped));
}

#[test]
fn views_from_one_direction_and_wrong_depths_are_told() {
    let observations = |narrow: bool, nearer_m: f64| {
        let mut all = drawn(&truth(), 60, 4);
        for (index, one) in all.iter_mut().enumerate() {
            let ray = (truth().translation() - one.camera_in_world).normalize();
            one.world_from_object = one.world_from_object.perturbed(&(ray * -nearer_m), &Vector3::zeros());
            if narrow {
                one.camera_in_world = camera(index % 3, 60, &truth());
            }
        }
        all
    };
    for (narrow, nearer_m, words) in
        [(false, 0.0, None), (true, 0.0, Some("degrees apart")), (false, 0.008, Some("mm nearer"))]
    {
        let scenes = [agreement(&shape(), observations(narrow, nearer_m))];
        let said = warnings(&Totals::of(60, &scenes), &scenes, DIAMETER_M);
        let found = said.iter().find(|warning| warning.contains("degrees apart") || warning.contains(" mm "));
        assert_eq!(found.is_some(), words.is_some(), "{said:?}");
        assert!(words.is_none_or(|words| found.unwrap().contains(words)), "{said:?}");
    }
}

#[test]
fn what_cannot_be_compared_is_refused() {
    type Case<'a> = (&'a dyn Fn(&mut Observation), &'a str);
    let cases: [Case<'_>; 4] = [
        (&|one| one.covariance[(2, 2)] = f64::NAN, "image 1: a value"),
        (&|one| one.covariance[(4, 4)] = 0.0, "image 1: the covariance"),
        (&|one| one.covariance *= 0.0, "image 1: the covariance"),
        (&|one| one.camera_in_world = *one.world_from_object.translation(), "image 1: the camera stands in"),
    ];
    for (change, words) in cases {
        let mut observations = drawn(&truth(), 3, 0);
        change(&mut observations[1]);
        let bounds = posed::evaluation::agreement::Bounds::default();
        let error = posed::evaluation::agreement::SceneAgreement::of("table".into(), &shape(), &bounds, observations);
        let said = error.unwrap_err().to_string();
        assert!(said.contains(words), "{said}");
    }
    for diameter_m in [0.0, -1.0, f64::NAN] {
        assert!(Shape::new(diameter_m, Vector3::zeros(), Symmetries::default()).is_err());
    }
    let totals = Totals::of(0, &[agreement(&shape(), Vec::new())]);
    assert_eq!((totals.answers, &totals.spread_of_ok), (0, &None));
    assert!(warnings(&totals, &[], DIAMETER_M)[0].contains("nothing to compare"));
}

#[test]
fn an_object_of_revolution_has_one_degree_of_freedom_less() {
    let axis = ContinuousSymmetry { axis: Vector3::z_axis(), offset_m: Vector3::zeros() };
    let bottle = Shape::new(DIAMETER_M, Vector3::zeros(), Symmetries::new(&[], vec![axis]).unwrap()).unwrap();
    // However each view is turned about the axis.
    let spin = |one: &mut Observation| {
        let angle = 1e6 * one.world_from_object.translation().x;
        one.world_from_object = one.world_from_object * turn(Vector3::z(), angle % 360.0);
    };
    let spread = spread_of_many(&bottle, 4, spin);
    assert!((spread.nees_mean / 5.0 - 1.0).abs() < 0.1 && (spread.nees_rotation - 1.0).abs() < 0.1, "{spread:?}");
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(48))]

    #[test]
    fn equal_poses_of_a_symmetric_object_agree(seed in 0..1000u64, equals in prop::collection::vec(0..4usize, 6)) {
        let half_turns = [turn(Vector3::x(), 180.0), turn(Vector3::y(), 180.0)];
        let symmetries = Symmetries::new(&half_turns, Vec::new()).unwrap();
        let bar = Shape::new(DIAMETER_M, Vector3::new(0.001, 0.002, 0.0), symmetries.clone()).unwrap();
        let observations = drawn(&truth(), 6, seed);
        let mut turned = observations.clone();
        for (one, equal) in turned.iter_mut().zip(equals) {
            one.world_from_object = one.world_from_object * symmetries.discrete()[equal];
        }
        let (expected, found) = (deviations(&bar, observations), deviations(&bar, turned));
        prop_assert!(expected.iter().zip(&found).all(|(a, b)| close(a, b)), "{expected:?} {found:?}");
    }

    #[test]
    fn two_instances_are_told_apart(
        seed in 0..1000u64, direction in prop::array::uniform3(-1.0..1.0f64), apart in 0.5..6.0f64, missing in 0..4usize,
    ) {
        prop_assume!(Vector3::from(direction).norm() > 0.1);
        let shift = Vector3::from(direction).normalize() * (apart * DIAMETER_M);
        let second = truth().perturbed(&shift, &Vector3::new(1.0, 2.0, 0.5));
        let mut all = drawn(&truth(), 8, seed);
        all.extend(drawn(&second, 8, seed + 1).into_iter().skip(missing));
        let scene = agreement(&shape(), all);
        prop_assert_eq!(scene.instances.iter().map(|one| one.observations.len()).collect::<Vec<_>>(), [8, 8 - missing]);
        prop_assert!(scene.judged().all(|one| one.deviation.translation_m < 0.3 * DIAMETER_M && !one.deviation.flipped));
    }

    #[test]
    fn order_does_not_matter(
        order in Just((0..14).collect::<Vec<usize>>()).prop_shuffle(), seed in 0..1000u64, far in 0.0..0.2f64,
    ) {
        let mut all = drawn(&truth(), 8, seed);
        let second = truth().perturbed(&Vector3::new(far, 0.02, 0.0), &Vector3::new(0.0, 1.0, 0.0));
        all.extend(drawn(&second, 6, seed + 1));
        all[5].status = Status::Rejected;
        all[9].status = Status::LowConfidence;
        let shuffled = order.into_iter().map(|index| all[index].clone()).collect();
        let as_json = |all| serde_json::to_string(&agreement(&shape(), all)).unwrap();
        prop_assert_eq!(as_json(all.clone()), as_json(shuffled));
    }

    #[test]
    fn the_origin_of_the_objects_frame_does_not_matter(seed in 0..1000u64, origin in prop::array::uniform3(-1.0..1.0f64)) {
        let origin = Vector3::from(origin);
        let moved_shape = Shape::new(DIAMETER_M, -origin, Symmetries::default()).unwrap();
        let observations = drawn(&truth(), 5, seed);
        let mut moved = observations.clone();
        for one in &mut moved {
            let lever = one.world_from_object.rotation() * origin;
            one.world_from_object = one.world_from_object * Pose::new(Rotation3::identity(), origin);
            one.covariance = covariance_about(&one.covariance, &lever);
        }
        let (expected, found) = (deviations(&shape(), observations), deviations(&moved_shape, moved));
        prop_assert!(expected.iter().zip(&found).all(|(a, b)| close(a, b)), "{expected:?} {found:?}");
    }
}
