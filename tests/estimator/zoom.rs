//! A second look at where the first one saw the keypoints.

use std::sync::{Arc, Mutex};

use image::{Rgb, RgbImage};
use nalgebra::Vector2;
use posed::estimator::Estimate;
use posed::model::Input;
use posed::pnp::Status;
use serde_json::json;

use crate::script::{
    BOX, CROP, HEIGHT, Manifests, Models, SCALE, Script, WIDTH, camera, corner_pixels, sure_of, truth,
};

const ZOOM: f64 = 2.75;

/// Where a crop lies in the image: left and top edge and side, pixels.
#[derive(Clone, Copy, Debug)]
struct Place {
    edge: Vector2<f64>,
    side: f64,
}

/// An image that says at each pixel where it is.
#[allow(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "to 8 bits")]
fn chart() -> RgbImage {
    let level = |at: u32, size: u32| (255.0 * f64::from(at) / f64::from(size)).round() as u8;
    RgbImage::from_fn(WIDTH, HEIGHT, |x, y| Rgb([level(x, WIDTH), level(y, HEIGHT), 0]))
}

/// Reads off a crop of the chart where it was cut: a line through the levels of each axis.
fn place(crop: &[u8]) -> Place {
    let side = CROP as usize;
    let line = |axis: usize, size: u32| {
        let (mut st, mut sv, mut stt, mut stv) = (0.0, 0.0, 0.0, 0.0);
        for k in 0..side * side {
            let t = if axis == 0 { k % side } else { k / side } as f64 + 0.5;
            let value = f64::from(crop[3 * k + axis]) * f64::from(size) / 255.0 + 0.5;
            (st, sv, stt, stv) = (st + t, sv + value, stt + t * t, stv + t * value);
        }
        let n = (side * side) as f64;
        let slope = (n * stv - st * sv) / (n * stt - st * st);
        (sv / n - slope * st / n, slope)
    };
    let ((left, slope), (top, _)) = (line(0, WIDTH), line(1, HEIGHT));
    Place { edge: Vector2::new(left, top), side: slope * side as f64 }
}

type Places = Arc<Mutex<Vec<Vec<Place>>>>;

/// A net that sees the object's corners wherever the crop was cut, and notes where that was: for each run its crops.
#[allow(clippy::cast_possible_truncation, reason = "to a network's floats")]
fn seeing(places: &Places) -> Script {
    let places = Arc::clone(places);
    let keypoints = Arc::new(move |input: Input<'_>| {
        let Input::Bytes { shape, values } = input else { panic!("bytes were expected") };
        let crops: Vec<Place> = values.chunks_exact(values.len() / shape[0]).map(place).collect();
        let in_crop = |crop: &Place| {
            let (edge, side) = (crop.edge, crop.side);
            corner_pixels().map(|pixel| ((pixel.add_scalar(0.5) - edge) * f64::from(CROP) / side).add_scalar(-0.5))
        };
        let pixels = crops.iter().flat_map(in_crop).flat_map(|uv| [uv.x as f32, uv.y as f32]).collect();
        places.lock().unwrap().push(crops);
        Ok(sure_of(shape[0], pixels))
    });
    Script { keypoints, ..Script::default() }
}

fn estimate(zoom: bool, script: Script) -> Estimate {
    let mut manifests = Manifests::default();
    manifests.object["crop_ensemble"] = json!([0.9, 1.0, 1.1]);
    if zoom {
        manifests.object["zoom"] = json!(ZOOM);
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
    assert!((first.side - SCALE * BOX[2].max(BOX[3])).abs() < 1.0, "{first:?}");

    let corners = corner_pixels();
    let centre = corners.iter().sum::<Vector2<f64>>() / 8.0;
    let spread = (corners.iter().map(|corner| (corner - centre).norm_squared()).sum::<f64>() / 8.0).sqrt();
    assert_eq!(second.len(), 3);
    for (crop, factor) in second.iter().zip([0.9, 1.0, 1.1]) {
        let side = factor * SCALE * ZOOM * spread;
        assert!((crop.side - side).abs() < 1.0, "{crop:?}, {side}");
        assert!((crop.edge.add_scalar(crop.side / 2.0 - 0.5) - centre).amax() < 1.0, "{crop:?}, {centre}");
    }
    let found = &answer.poses[0];
    assert_eq!(found.verdict.status, Status::Ok);
    let pose = found.pose.as_ref().unwrap().camera_from_object;
    assert!(pose.angle_to(&truth()) < 0.05, "{pose:?}");
}

#[test]
fn without_zoom_there_is_one_look() {
    let places = Places::default();
    estimate(false, seeing(&places));
    let places = places.lock().unwrap();
    assert_eq!(places.iter().map(Vec::len).collect::<Vec<_>>(), [3]);
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
