//! Views that leave two answers open.

use nalgebra::{Rotation3, Vector3};
use posed_core::geometry::Pose;
use posed_core::pnp::Status;
use posed_core::views::Mode;

use crate::scene::{Scene, Seen};

/// A view whose points may also be those of the object turned by half a turn, which it holds for likelier if `turned_first`.
fn two_answers(scene: &mut Scene, camera: &Pose, half_turn: &Pose, turned_first: bool) -> Seen {
    let turned = scene.world_from_points * *half_turn;
    let (right, wrong) = (scene.see(camera, 0.7), scene.see_at(&turned, camera, camera, 0.7));
    let (first, second) = if turned_first { (wrong, right) } else { (right, wrong) };
    let weighted = |mode: &Mode, reading: usize, weight: f64| Mode { reading, weight, ..*mode };
    let modes = vec![weighted(&first.modes[0], 0, 0.6), weighted(&second.modes[0], 1, 0.4)];
    Seen { readings: [first.readings.clone(), second.readings.clone()].concat(), modes, ..first }
}

/// Of two views that each hold the wrong answer for likelier, if it is another wrong one, the right ones agree.
#[test]
fn other_views_say_which_answer_is_right() {
    let (mut right, problems) = (0, 100);
    for problem in 0..problems {
        let mut scene = Scene::new(90, problem);
        let seen: Vec<Seen> = (0..3)
            .map(|view| {
                let camera = scene.around();
                let axis = Vector3::new(scene.normal(), scene.normal(), scene.normal()).normalize();
                let half_turn = Pose::new(Rotation3::new(axis * std::f64::consts::PI), Vector3::zeros());
                two_answers(&mut scene, &camera, &half_turn, view != 0)
            })
            .collect();
        let solution = scene.solve(&seen);
        let used = solution.views.iter().all(|view| view.excluded.is_none() && view.inliers > 10);
        let is_right = scene.error_m(&solution.world_from_points) < 5e-3 && used && solution.status == Status::Ok;
        right += u32::from(is_right && solution.views.iter().all(|view| view.residual_px.unwrap() < 2.0));
    }
    assert!(f64::from(right) >= 0.97 * f64::from(u32::try_from(problems).unwrap()), "{right} of {problems}");
}
