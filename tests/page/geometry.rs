//! The page's cameras are those of the core: what it draws lies where the server means it.

use nalgebra::{Vector2, Vector3};
use posed_core::geometry::Camera;
use serde_json::{Value, json};

use crate::browser::Browser;
use crate::support::Server;

#[tokio::test]
async fn the_page_projects_as_the_core_does() {
    let (server, browser) = (Server::start(&[]), Browser::start().await);
    browser.open(&server.url("/")).await;
    let pinhole = || Camera::pinhole(610.0, 605.0, 315.0, 245.0).unwrap();
    let opencv = |coefficients: &[f64]| pinhole().with_opencv_distortion(coefficients).unwrap();
    let cameras = [
        pinhole(),
        opencv(&[-0.28, 0.09, 0.001, -0.002, 0.01]),
        opencv(&[0.3, -0.1, 0.001, 0.002, 0.02, 0.25, -0.05, 0.01]),
        opencv(&[-0.1, 0.02, 0.001, 0.002, 0.0, 0.01, 0.0, 0.0, 0.002, -0.001, 0.001, 0.0005]),
        // It folds back within view.
        opencv(&[-0.8, 0.05, 0.0, 0.0]),
        pinhole().with_fisheye_distortion(&[0.02, -0.01, 0.004, -0.001]).unwrap(),
    ];
    let points: Vec<[f64; 3]> = (-4..=4)
        .flat_map(|x| (-4..=4).map(move |y| [0.09 * f64::from(x), 0.08 * f64::from(y), 0.5 + 0.01 * f64::from(x * y)]))
        .chain([[0.1, 0.1, -0.5], [0.1, 0.1, 0.0]])
        .collect();
    let script = "const {project, unproject} = await import('/page/camera.js'); const [camera, points] = arguments[0]; \
                  return points.map((point) => { const pixel = project(camera, point); \
                  return pixel && {pixel, ray: unproject(camera, pixel)}; });";
    for camera in cameras {
        let found = browser.run(script, json!([camera, points])).await;
        let mut seen = 0;
        for (point, found) in points.iter().zip(found.as_array().unwrap()) {
            let Ok(pixel) = camera.project(&Vector3::from(*point)) else {
                assert_eq!(found, &Value::Null, "{camera:?} {point:?}");
                continue;
            };
            let numbers =
                |field: &str| Vector2::from(serde_json::from_value::<[f64; 2]>(found[field].clone()).unwrap());
            assert!((numbers("pixel") - pixel).norm() < 1e-6, "{camera:?} {point:?} {found}");
            let ray = Vector2::new(point[0] / point[2], point[1] / point[2]);
            assert!((numbers("ray") - ray).norm() < 1e-6, "{camera:?} {point:?} {found}");
            seen += 1;
        }
        assert!(seen > 20, "{camera:?}");
    }
}
