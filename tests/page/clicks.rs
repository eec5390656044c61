//! The view Reference, from the images to the reference that is stored.

use std::fs;

use nalgebra::{Rotation3, Vector2, Vector3};
use posed_core::geometry::{Camera, Pose};
use serde_json::{Value, json};
use thirtyfour::Key;

use crate::browser::Browser;
use crate::support::{Server, copy_of, read, root, run};

/// Half the side of the cube, metres; its frame is in its centre.
const HALF_M: f64 = 0.0271;
/// The cube in the first image of `samples/pair`: as it was rendered.
const ROTATION: [f64; 9] = [
    0.022_642_479,
    -0.105_858_966,
    0.994_123_331,
    0.274_051_392,
    -0.955_631_410,
    -0.108_002_048,
    0.961_448_466,
    0.274_886_316,
    0.007_372_933,
];
const TRANSLATION_M: [f64; 3] = [-0.063_117_155, 0.023_627_058, 0.457_077_443];
/// Corners that both images show: the first is the origin of the frame, the second lies on its x axis, the third in its
/// xy plane.
const CORNERS: [[f64; 3]; 5] =
    [[-1.0, -1.0, 1.0], [-1.0, 1.0, 1.0], [-1.0, -1.0, -1.0], [1.0, -1.0, 1.0], [-1.0, 1.0, -1.0]];

pub(crate) struct Scene {
    camera: Camera,
    first_from_cube: Pose,
    second_from_first: Pose,
}

impl Scene {
    pub(crate) fn read() -> Self {
        let pair: Value = serde_json::from_slice(&read(&root().join("samples/pair/pair.json"))).unwrap();
        let numbers = |field: &str| pair["second_from_first"][field].clone();
        let rotation = serde_json::from_value(numbers("rotation_xyzw")).unwrap();
        let translation = serde_json::from_value(numbers("translation_m")).unwrap();
        Self {
            camera: serde_json::from_value(pair["camera"].clone()).unwrap(),
            first_from_cube: Pose::from_row_major(ROTATION, TRANSLATION_M).unwrap(),
            second_from_first: Pose::from_quaternion_xyzw(rotation, translation).unwrap(),
        }
    }

    /// Where a corner is in both images.
    fn pixels(&self, corner: [f64; 3]) -> [Vector2<f64>; 2] {
        let in_first = self.first_from_cube.transform(&(HALF_M * Vector3::from(corner)));
        [in_first, self.second_from_first.transform(&in_first)].map(|point| self.camera.project(&point).unwrap())
    }

    /// The frame that the first three corners span, in the first camera.
    fn first_from_frame(&self) -> Pose {
        let [origin, on_x, in_xy] = [0, 1, 2].map(|index| HALF_M * Vector3::from(CORNERS[index]));
        let x = (on_x - origin).normalize();
        let z = x.cross(&(in_xy - origin)).normalize();
        let axes = nalgebra::Matrix3::from_columns(&[x, z.cross(&x), z]);
        self.first_from_cube * Pose::new(Rotation3::from_matrix_unchecked(axes), origin)
    }
}

/// Clicks a pixel in one of the images, then in its magnifier until the table says that it is there.
async fn click_pixel(browser: &Browser, side: &str, row: usize, pixel: Vector2<f64>) {
    let canvas = format!("#reference-{side} canvas.pick");
    let by =
        browser.run("return document.querySelector(arguments[0]).clientWidth / 640;", canvas.as_str().into()).await;
    let by = by.as_f64().unwrap();
    browser.click_at(&canvas, (pixel.x + 0.5) * by, (pixel.y + 0.5) * by).await;
    // Away from the image, so that the magnifier shows the point, and not what is under the pointer.
    let lens = format!("#reference-{side} canvas.lens");
    for _ in 0..2 {
        let column = if side == "first" { 1 } else { 2 };
        let script = format!("document.querySelector('#reference-points').rows[{row}].cells[{column}].innerText");
        let text = browser.until(&script).await.as_str().unwrap().to_owned();
        let at: Vec<f64> = text.split(", ").map(|number| number.parse().unwrap()).collect();
        let off = (pixel - Vector2::new(at[0], at[1])) * 8.0;
        let half =
            browser.run("return document.querySelector(arguments[0]).clientWidth / 2;", lens.as_str().into()).await;
        let half = half.as_f64().unwrap();
        browser.click_at(&lens, half + off.x, half + off.y).await;
    }
}

pub(crate) async fn click_corners(browser: &Browser, scene: &Scene) {
    browser.until("document.querySelector('#reference-object').options.length").await;
    browser.press("Use the sample images").await;
    browser.until("document.querySelectorAll('#reference canvas.pick').length === 2").await;
    browser.until("!document.querySelector('#reference-second canvas.pick').closest('[hidden]')").await;
    browser.until("document.querySelector('#reference textarea').value").await;
    for (row, corner) in CORNERS.into_iter().enumerate() {
        let [first, second] = scene.pixels(corner);
        click_pixel(browser, "first", row, first).await;
        browser.until_text("#reference-next", "it lies on the yellow line").await;
        click_pixel(browser, "second", row, second).await;
    }
}

#[tokio::test]
async fn clicks_become_the_reference_that_is_true() {
    let folder = copy_of("reference");
    let server = Server::start(&["--reference", folder.path().to_str().unwrap(), "--recalibration"]);
    let (browser, scene) = (Browser::start().await, Scene::read());
    browser.open(&server.url("/#reference/cube")).await;
    click_corners(&browser, &scene).await;
    // Live: all rays meet.
    let script =
        "return [...document.querySelectorAll('#reference-points tr')].map((row) => Number(row.cells[5].innerText));";
    let rays_mm: Vec<f64> = serde_json::from_value(browser.run(script, Value::Null).await).unwrap();
    assert!(rays_mm.len() == CORNERS.len() && rays_mm.iter().all(|ray_mm| *ray_mm < 0.3), "{rays_mm:?}");
    browser.until("!document.querySelector('#reference-save').disabled").await;
    browser.click("#reference-save").await;
    browser.until_text("#reference-result", "Saved, and in force.").await;

    let stored: Value = serde_json::from_slice(&read(&folder.path().join("cube.json"))).unwrap();
    let pose = &stored["references"][0]["camera_from_object"];
    let numbers = |field: &str| pose[field].clone();
    let rotation = serde_json::from_value(numbers("rotation_xyzw")).unwrap();
    let stored =
        Pose::from_quaternion_xyzw(rotation, serde_json::from_value(numbers("translation_m")).unwrap()).unwrap();
    let truth = scene.first_from_frame();
    let error_mm = 1e3 * (stored.translation() - truth.translation()).norm();
    assert!(error_mm < 2.0, "{error_mm} mm");
    assert!(stored.angle_to(&truth).to_degrees() < 1.0, "{} degrees", stored.angle_to(&truth).to_degrees());

    // The page shows it: with its image, and the command is no longer needed.
    browser.click("nav a[href='#objects']").await;
    browser.until_text("#objects-list", "Reference from 1 image").await;
    browser.until("document.querySelector('[aria-labelledby=object-cube] canvas').width > 0").await;
    assert_eq!(browser.complaints().await, [""; 0]);
}

/// Where the server does not take references, the page hands out the file that `posed calibrate` takes.
#[tokio::test]
async fn clicks_become_a_file_where_recalibration_is_off() {
    let (server, browser, scene) = (Server::start(&[]), Browser::start().await, Scene::read());
    browser.open(&server.url("/#reference/cube")).await;
    browser.until_text("#reference-off", "--recalibration").await;
    click_corners(&browser, &scene).await;
    assert!(
        browser.run("return document.querySelector('#reference-save').disabled;", Value::Null).await.as_bool().unwrap()
    );
    let box_px = "box of the object in the first image, pixels";
    browser.fill(box_px, " ").await;
    browser.press("Download the clicks").await;
    browser.until_text("#reference-result", "The file needs the box").await;
    browser.fill(box_px, "192, 223, 87, 92").await;
    let keep = "const make = URL.createObjectURL; \
                URL.createObjectURL = (blob) => { blob.text().then((text) => { window.handedOut = text; }); return make(blob); };";
    browser.run(keep, Value::Null).await;
    browser.press("Download the clicks").await;
    browser.until_text("#reference-result", "posed calibrate cube --clicks clicks.json").await;
    let text = browser.until("window.handedOut").await;

    let folder = tempfile::tempdir().unwrap();
    fs::copy(root().join("samples/pair/first.jpg"), folder.path().join("first.jpg")).unwrap();
    let file = folder.path().join("clicks.json");
    fs::write(&file, text.as_str().unwrap()).unwrap();
    let reference = folder.path().join("reference");
    let (file, reference) = (file.to_str().unwrap(), reference.to_str().unwrap());
    let output = run(&["calibrate", "cube", "--clicks", file, "--reference", reference]);
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
}

/// By keyboard: Enter places a point, arrows move it. Points that cannot be are told in words.
#[tokio::test]
async fn points_are_placed_by_keyboard_and_mistakes_told() {
    let (server, browser) = (Server::start(&[]), Browser::start().await);
    browser.open(&server.url("/#reference/cube")).await;
    browser.until("document.querySelector('#reference-object').options.length").await;
    browser.press("Use the sample images").await;
    browser.until("document.querySelector('#reference textarea').value").await;
    let cell = |column: usize| format!("document.querySelector('#reference-points').rows[0].cells[{column}].innerText");
    for (side, column, keys, shown) in [
        ("first", 1, vec![Key::Enter, Key::Right, Key::Right, Key::Down], "320.50, 240.00"),
        ("second", 2, vec![Key::Enter, Key::Left], "319.00, 239.50"),
    ] {
        browser
            .run("document.querySelector(arguments[0]).focus();", format!("#reference-{side} canvas.pick").into())
            .await;
        for key in keys {
            browser.driver.action_chain().send_keys(key.value().to_string()).perform().await.unwrap();
        }
        browser.until(&format!("{} === '{shown}'", cell(column))).await;
    }
    browser.until_text("#reference-ready", "1 of at least 4 points are complete").await;
    for (text, words) in [
        ("1 2 3", "A matrix has 16 numbers"),
        ("{\"rotation_xyzw\": [0, 0, 0, 2], \"translation_m\": [1, 0, 0]}", "does not have length 1"),
        (
            "{\"rotation_xyzw\": [0, 0, 0, 1], \"translation_m\": [-147, -215, 108]}",
            "Are the translations in millimetres?",
        ),
        ("{\"rotation_xyzw\": [0, 0, 0, 1], \"translation_m\": [0, 0, 0]}", "stand in one place"),
    ] {
        browser.fill("second from first", text).await;
        browser.until_text("#reference-cameras", words).await;
    }
    assert_eq!(browser.complaints().await, [""; 0]);
}

/// Two poses, or the file of a board, mean the same as the relative pose of a rig.
#[tokio::test]
async fn relative_poses_are_read_in_every_form() {
    let (server, browser) = (Server::start(&[]), Browser::start().await);
    browser.open(&server.url("/#reference")).await;
    let scene: Value = serde_json::from_slice(&read(&root().join("tests/data/still/scene_camera.json"))).unwrap();
    let world = |id: &str| {
        let numbers = |field: &str| -> Vec<f64> { serde_json::from_value(scene[id][field].clone()).unwrap() };
        let metres: Vec<f64> = numbers("cam_t_w2c").iter().map(|millimetres| millimetres / 1e3).collect();
        Pose::from_row_major(numbers("cam_R_w2c").try_into().unwrap(), metres.try_into().unwrap()).unwrap()
    };
    let (first, second) = (world("3"), world("7"));
    let truth = second * first.inverse();
    let form = |pose: &Pose| json!({"rotation_xyzw": pose.rotation_xyzw(), "translation_m": pose.translation_m()});
    let matrix = truth.matrix();
    let rows =
        json!((0..4).map(|row| (0..4).map(|column| matrix[(row, column)]).collect::<Vec<_>>()).collect::<Vec<_>>());
    let script = "const [{readPose}, {stated, compose, inverse}] = await Promise.all([import('/page/relative-pose.js'), import('/page/geometry.js')]); \
                  const [kind, ...texts] = arguments[0]; const poses = texts.map((text) => readPose(text)); \
                  return stated(kind === 'one' ? poses[0] : kind === 'camera' ? compose(poses[1], inverse(poses[0])) : compose(inverse(poses[1]), poses[0]));";
    for asked in [
        json!(["one", form(&truth).to_string()]),
        json!(["one", rows.to_string()]),
        json!(["camera", scene["3"].to_string(), scene["7"].to_string()]),
        json!(["world", form(&first.inverse()).to_string(), form(&second.inverse()).to_string()]),
    ] {
        let found = browser.run(script, asked.clone()).await;
        let numbers = |field: &str| found[field].clone();
        let rotation = serde_json::from_value(numbers("rotation_xyzw")).unwrap();
        let found =
            Pose::from_quaternion_xyzw(rotation, serde_json::from_value(numbers("translation_m")).unwrap()).unwrap();
        assert!(found.angle_to(&truth) < 1e-6 && (found.translation() - truth.translation()).norm() < 1e-6, "{asked}");
    }
    // By hand: the file fills in both cameras, too.
    browser.click("#reference-cameras input[value=board]").await;
    browser.choose("Choose scene_camera.json", "tests/data/still/scene_camera.json".as_ref()).await;
    browser.until("document.querySelector('#reference-cameras').innerText.includes('second image')").await;
    browser.until("document.querySelector('#reference-first') && document.querySelectorAll('#reference-cameras input[value=numbers]:checked').length === 2").await;
    assert_eq!(browser.complaints().await, [""; 0]);
}
