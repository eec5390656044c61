//! A second look at where the first one saw the keypoints.

use std::sync::{Arc, Mutex};

use image::{Rgb, RgbImage};
use nalgebra::{Matrix2, Vector2, Vector3};
use posed::estimator::Estimate;
use posed::model::Input;
use posed_core::pnp::Status;
use serde_json::json;

use crate::script::{
    BOX, CROP, HEIGHT, Manifests, Models, SCALE, Script, WIDTH, camera, corner_pixels, sure_of, truth,
};

const ZOOM: f64 = 2.75;
const UP: [f64; 3] = [0.6, 0.0, 0.8];
/// Scale and turn in degrees of the crops.
const ENSEMBLE: [(f64, f64); 3] = [(0.9, -10.0), (1.0, 0.0), (1.1, 20.0)];

/// Where a crop lies in the image: the map `image_from_crop` of pixels.
#[derive(Clone, Copy, Debug)]
struct Place {
    linear: Matrix2<f64>,
    offset: Vector2<f64>,
}

impl Place {
    fn in_crop(&self, pixel: &Vector2<f64>) -> Vector2<f64> {
        self.linear.try_inverse().unwrap() * (pixel - self.offset)
    }

    fn centre(&self) -> Vector2<f64> {
        self.linear * Vector2::repeat((f64::from(CROP) - 1.0) / 2.0) + self.offset
    }

    fn side(&self) -> f64 {
        self.linear.determinant().sqrt() * f64::from(CROP)
    }
}

/// An image that says at each pixel where it is.
#[allow(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "to 8 bits")]
fn chart() -> RgbImage {
    let level = |at: u32, size: u32| (255.0 * f64::from(at) / f64::from(size)).round() as u8;
    RgbImage::from_fn(WIDTH, HEIGHT, |x, y| Rgb([level(x, WIDTH), level(y, HEIGHT), 0]))
}

/// Reads off a crop of the chart where it was cut: a plane through the levels of each axis.
fn place(crop: &[u8]) -> Place {
    let side = CROP as usize;
    let middle = (f64::from(CROP) - 1.0) / 2.0;
    let arms = |k: usize| Vector2::new((k % side) as f64 - middle, (k / side) as f64 - middle);
    let square: f64 = (0..side * side).map(|k| arms(k).x.powi(2)).sum();
    let plane = |axis: usize, size: u32| {
        let value = |k: usize| f64::from(crop[3 * k + axis]) * f64::from(size) / 255.0;
        let mean = (0..side * side).map(value).sum::<f64>() / (side * side) as f64;
        let slope = (0..side * side).map(|k| arms(k) * value(k)).sum::<Vector2<f64>>() / square;
        (mean, slope)
    };
    let ((x, across), (y, down)) = (plane(0, WIDTH), plane(1, HEIGHT));
    let linear = Matrix2::from_rows(&[across.transpose(), down.transpose()]);
    Place { linear, offset: Vector2::new(x, y) - linear * Vector2::repeat(middle) }
}

type Places = Arc<Mutex<Vec<Vec<Place>>>>;

/// A net that sees the object's corners wherever the crop was cut, and notes where that was: for each run its crops.
fn seeing(places: &Places) -> Script {
    erring(places, |_, corner| corner)
}

/// One that errs in runs by their number, counted from 0.
#[allow(clippy::cast_possible_truncation, reason = "to a network's floats")]
fn erring(places: &Places, err: impl Fn(usize, Vector2<f64>) -> Vector2<f64> + Send + Sync + 'static) -> Script {
    let places = Arc::clone(places);
    let keypoints = Arc::new(move |input: Input<'_>| {
        let Input::Bytes { shape, values } = input else { panic!("bytes were expected") };
        let crops: Vec<Place> = values.chunks_exact(values.len() / shape[0]).map(place).collect();
        let mut places = places.lock().unwrap();
        let in_crop = |crop: &Place| corner_pixels().map(|corner| crop.in_crop(&err(places.len(), corner)));
        let pixels = crops.iter().flat_map(in_crop).flat_map(|uv| [uv.x as f32, uv.y as f32]).collect();
        places.push(crops);
        Ok(sure_of(shape[0], pixels))
    });
    Script { keypoints, ..Script::default() }
}

fn estimate(zoom: bool, script: Script) -> Estimate {
    let mut manifests = Manifests::default();
    manifests.object["crop_ensemble"] = json!(ENSEMBLE.map(|(scale, turn)| json!({"scale": scale, "turn_deg": turn})));
    if zoom {
        manifests.object["second_look"] = json!({"zoom": ZOOM, "up": UP});
    }
    Models::new(&manifests, script).estimator().unwrap().estimate(&chart(), &camera()).unwrap()
}

#[test]
fn the_second_crops_lie_about_the_keypoints() {
    let places = Places::default();
    let answer = estimate(true, seeing(&places));
    let places = places.lock().unwrap();
    let [first, second] = &places[..] else { panic!("{} runs", places.len()) };
    let [first] = &first[..] else { panic!("{} crops at first", first.len()) };
    assert!((first.side() - SCALE * BOX[2].max(BOX[3])).abs() < 1.0, "{first:?}");
    assert!((first.linear - Matrix2::identity() * first.linear.m11).amax() < 0.02, "turned: {first:?}");

    let corners = corner_pixels();
    let centre = corners.iter().sum::<Vector2<f64>>() / 8.0;
    let spread = (corners.iter().map(|corner| (corner - centre).norm_squared()).sum::<f64>() / 8.0).sqrt();
    let camera_from_object = truth();
    let tip = |z: f64| camera().project(&camera_from_object.transform(&(Vector3::from(UP) * z))).unwrap();
    let axis = tip(0.001) - tip(-0.001);
    assert_eq!(second.len(), 3);
    for (crop, (scale, turn)) in second.iter().zip(ENSEMBLE) {
        let side = scale * SCALE * ZOOM * spread;
        assert!((crop.side() - side).abs() < 1.0, "{crop:?}, {side}");
        assert!((crop.centre() - centre).amax() < 1.0, "{crop:?}, {centre}");
        let in_crop = crop.linear.try_inverse().unwrap() * axis;
        let from_upright = in_crop.x.atan2(-in_crop.y).to_degrees();
        assert!((from_upright - turn).abs() < 3.0, "{crop:?}: it leans by {from_upright}, not {turn}");
    }
    let found = &answer.poses[0];
    assert_eq!(found.verdict.status, Status::Ok);
    let pose = found.pose.as_ref().unwrap().camera_from_object;
    assert!(pose.angle_to(&truth()) < 0.05, "{pose:?}");
}

const RIGHT: Vector2<f64> = Vector2::new(12.0, 0.0);

/// What a look sees elsewhere than it was cut for is looked at there, until it stays.
#[test]
fn looks_follow_the_keypoints() {
    let places = Places::default();
    let answer = estimate(true, erring(&places, |run, corner| if run == 0 { corner + RIGHT } else { corner }));
    let places = places.lock().unwrap();
    assert_eq!(places.iter().map(Vec::len).collect::<Vec<_>>(), [1, 3, 3]);
    let (second, third) = (places[1][1].centre(), places[2][1].centre());
    assert!((second - third - RIGHT).amax() < 1.0, "{second}, {third}");
    assert!(answer.poses[0].pose.as_ref().unwrap().camera_from_object.angle_to(&truth()) < 0.05);
}

#[test]
fn looks_follow_the_size_of_the_keypoints() {
    let places = Places::default();
    let larger = |corner| {
        let centre = corner_pixels().iter().sum::<Vector2<f64>>() / 8.0;
        centre + 1.1 * (corner - centre)
    };
    estimate(true, erring(&places, move |run, corner| if run == 0 { larger(corner) } else { corner }));
    let places = places.lock().unwrap();
    assert_eq!(places.iter().map(Vec::len).collect::<Vec<_>>(), [1, 3, 3]);
    let shrunk = places[2][1].side() / places[1][1].side();
    assert!((shrunk * 1.1 - 1.0).abs() < 0.01, "{shrunk}");
}

#[test]
fn keypoints_that_never_stay_are_followed_three_times() {
    let places = Places::default();
    estimate(true, erring(&places, |run, corner| if run % 2 == 0 { corner + RIGHT } else { corner }));
    assert_eq!(places.lock().unwrap().iter().map(Vec::len).collect::<Vec<_>>(), [1, 3, 3, 3]);
}

#[test]
fn without_zoom_there_is_one_look() {
    let places = Places::default();
    estimate(false, seeing(&places));
    let places = places.lock().unwrap();
    assert_eq!(places.iter().map(Vec::len).collect::<Vec<_>>(), [3]);
}

/// A symmetric object may be seen one way in one crop and another way in the next.
#[test]
fn a_crop_that_disagrees_is_left_out() {
    let places = Places::default();
    let Script { keypoints: seen, .. } = seeing(&places);
    let keypoints = Arc::new(move |input: Input<'_>| {
        let mut outputs = seen(input)?;
        let pixels = &mut outputs.iter_mut().find(|output| output.name == "keypoints").unwrap().values;
        if pixels.len() == 3 * 16 {
            pixels[..16].reverse(); // the first crop of the second look
        }
        Ok(outputs)
    });
    let answer = estimate(true, Script { keypoints, ..Script::default() });
    assert_eq!(answer.poses[0].verdict.status, Status::Ok);
    assert!(answer.poses[0].pose.as_ref().unwrap().camera_from_object.angle_to(&truth()) < 0.05);
}

/// Keypoints all in one place, or all over: there is nothing to look at more closely.
#[test]
fn nonsense_is_answered_without_a_second_look() {
    for pixels in [[32.0; 16].to_vec(), (0..16).map(|k| if k % 3 == 0 { 900.0 } else { -700.0 }).collect()] {
        let runs = Arc::new(Mutex::new(0));
        let counted = Arc::clone(&runs);
        let keypoints = Arc::new(move |_: Input<'_>| {
            *counted.lock().unwrap() += 1;
            Ok(sure_of(1, pixels.clone()))
        });
        let answer = estimate(true, Script { keypoints, ..Script::default() });
        assert_eq!(answer.poses.len(), 1);
        assert_ne!(answer.poses[0].verdict.status, Status::Ok);
        assert_eq!(*runs.lock().unwrap(), 1);
    }
}
