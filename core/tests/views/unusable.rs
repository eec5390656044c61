use nalgebra::{Matrix6, Vector2};
use posed_core::geometry::Symmetries;
use posed_core::pnp::PnpError;
use posed_core::views::{ViewsError, solve_views};

use crate::scene::{Scene, Seen, exact};

fn scene() -> (Scene, Vec<Seen>) {
    let mut scene = Scene::new(80, 0);
    let seen = (0..2)
        .map(|_| {
            let camera = scene.around();
            scene.see(&camera, 1.0)
        })
        .collect();
    (scene, seen)
}

fn error(change: impl FnOnce(&mut Vec<Seen>)) -> ViewsError {
    let (scene, mut seen) = scene();
    change(&mut seen);
    scene.solve_symmetric(&seen, &Symmetries::default()).unwrap_err()
}

#[test]
fn errors_name_the_view() {
    assert_eq!(error(|seen| seen[1].camera_covariance[(0, 0)] = f64::NAN), ViewsError::NotFinite { view: 1 });
    assert_eq!(error(|seen| seen[1].camera_covariance[(0, 1)] = 1.0), ViewsError::CameraCovariance { view: 1 });
    assert_eq!(
        error(|seen| seen[0].camera_covariance = -Matrix6::identity()),
        ViewsError::CameraCovariance { view: 0 }
    );
    assert_eq!(
        error(|seen| seen[1].readings[0].pixels[2] = Vector2::new(f64::NAN, 0.0)),
        ViewsError::View { view: 1, source: PnpError::NotFinite { index: 2 } }
    );
    let message = error(|seen| seen[0].readings[0].pixels.truncate(13)).to_string();
    assert!(message.starts_with("view 0: 14 points, 13 pixels"), "{message}");
    assert_eq!(error(|seen| seen.iter_mut().for_each(|seen| seen.modes.clear())), ViewsError::NoModes);
    assert_eq!(error(Vec::clear), ViewsError::NoModes);
    let missing = ViewsError::NoReading { view: 1, reading: 1, readings: 1 };
    assert_eq!(error(|seen| seen[1].modes[0].reading = 1), missing);
    let none = ViewsError::NoReading { view: 0, reading: 0, readings: 0 };
    assert_eq!(error(|seen| seen[0].readings.clear()), none);
}

/// A view without a pose of its own is used where its points agree.
#[test]
fn a_view_without_modes_takes_part() {
    let (scene, mut seen) = scene();
    seen[1].modes.clear();
    let views: Vec<_> = seen.iter().map(|seen| scene.view(seen)).collect();
    let solution = solve_views(&scene.points, &views, &Symmetries::default(), &exact()).unwrap();
    assert!(solution.views[1].excluded.is_none() && solution.views[1].inliers > 10);
}
