use nalgebra::{Rotation3, Vector3};
use posed_core::geometry::{Pose, Symmetries};
use posed_core::pnp::Status;
use posed_core::views::Exclusion;

use crate::scene::{Scene, Seen};

/// A view that shows something else.
fn wrong_view(scene: &mut Scene, how: u64) -> Seen {
    let camera = scene.around();
    let pose = scene.world_from_points;
    let other = match how % 3 {
        // Flipped.
        0 => {
            let axis = Vector3::new(scene.normal(), scene.normal(), scene.normal()).normalize();
            pose * Pose::new(Rotation3::new(axis * std::f64::consts::PI), Vector3::zeros())
        }
        // Another object of the kind, beside it.
        1 => {
            let aside = Vector3::new(scene.normal(), scene.normal(), scene.normal()).normalize() * 0.13;
            pose.perturbed(&aside, &Vector3::new(scene.normal(), scene.normal(), scene.normal()))
        }
        // Seen right, from a camera that stands elsewhere than it is said to.
        _ => {
            let stated = camera.perturbed(&Vector3::new(0.05, -0.05, 0.05), &Vector3::new(0.1, 0.1, -0.1));
            return scene.see_at(&pose, &camera, &stated, 1.0);
        }
    };
    scene.see_at(&other, &camera, &camera, 1.0)
}

#[test]
fn one_wrong_view_of_four_is_named_and_does_no_harm() {
    let problems = 600;
    let (mut right, mut named) = (0, 0);
    for problem in 0..problems {
        let mut scene = Scene::new(40, problem);
        let mut seen: Vec<_> = (0..3)
            .map(|_| {
                let camera = scene.around();
                scene.see(&camera, 1.0)
            })
            .collect();
        let place = (problem % 4) as usize;
        let wrong = wrong_view(&mut scene, problem / 4);
        seen.insert(place, wrong);
        let solution = scene.solve(&seen);
        right += u32::from(scene.error_m(&solution.world_from_points) < 6e-3);
        let excluded: Vec<_> = solution.views.iter().map(|view| view.excluded.is_some()).collect();
        let expected: Vec<_> = (0..4).map(|view| view == place).collect();
        if excluded == expected {
            named += 1;
            assert_eq!(solution.views[place].excluded, Some(Exclusion::Contradicts));
            assert!(solution.doubts.views_disagree && !solution.doubts.no_majority);
        }
    }
    println!("right {right}, named {named} of {problems}");
    assert!(f64::from(right) >= 0.99 * problems as f64, "{right} of {problems}");
    assert!(f64::from(named) >= 0.98 * problems as f64, "{named} of {problems}");
}

#[test]
fn two_views_that_contradict_each_other_are_not_trusted() {
    for problem in 0..100 {
        let mut scene = Scene::new(41, problem);
        let camera = scene.around();
        let seen = [scene.see(&camera, 1.0), wrong_view(&mut scene, 3 * problem)];
        let views = [(1.0, 0.5), (0.5, 1.0)].map(|trust| {
            let mut views: Vec<_> = seen.iter().map(|seen| scene.view(seen)).collect();
            (views[0].trust, views[1].trust) = trust;
            posed_core::views::solve_views(&scene.points, &views, &Symmetries::default(), &crate::scene::exact())
                .unwrap()
        });
        for (solution, trusted) in views.iter().zip([0, 1]) {
            assert!(solution.doubts.no_majority && solution.status == Status::LowConfidence, "{problem}");
            // The one that is trusted more has its way.
            assert!(solution.views[trusted].excluded.is_none() && solution.views[1 - trusted].excluded.is_some());
        }
    }
}

/// Points that are anywhere, in every view, as where something is in front of the object.
#[test]
fn outliers_within_views_are_left_out() {
    let mut wrong = 0;
    for problem in 0..300 {
        let mut scene = Scene::new(42, problem);
        let seen: Vec<_> = (0..3)
            .map(|view| {
                let camera = scene.around();
                let mut seen = scene.see(&camera, 1.0);
                for k in 0..3 {
                    seen.readings[0].pixels[(4 * view + k) % 14].x += 60.0 * scene.normal();
                }
                seen.modes = scene.solve_reading(&seen);
                seen
            })
            .collect();
        let solution = scene.solve(&seen);
        wrong += u32::from(scene.error_m(&solution.world_from_points) > 5e-3);
    }
    assert!(wrong <= 3, "{wrong}");
}
