//! The file of `--clicks`: points clicked in pairs of images.

use std::error::Error;
use std::path::{Path, PathBuf};

use nalgebra::Vector2;
use serde::Deserialize;
use serde_json::Value;

use super::known::{Known, beside};
use super::output::say;
use crate::model::{ObjectModel, PoseFile, read_json};
use posed_core::calibration::{Click, ClickedPair, ClickedReference, FrameClicks, reference_from_clicks};
use posed_core::geometry::{Camera, Pose};

/// Points that lie farther apart than the object is large, by this factor, are no points of it.
const MAX_SPREAD: f64 = 3.0;

/// Two images with a known relative pose.
#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct Pair {
    /// The first image.
    image: PathBuf,
    /// Only to see that it is another one.
    #[serde(default)]
    second_image: Option<PathBuf>,
    first_camera: Camera,
    second_camera: Camera,
    second_from_first: PoseFile,
    clicks: Vec<ClickEntry>,
    frame: FrameEntry,
    #[serde(default = "usual_click_error")]
    sigma_px: f64,
    box_px: [f64; 4],
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct ClickEntry {
    first_px: [f64; 2],
    second_px: [f64; 2],
}

/// Indices of the clicks that span the object's frame.
#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct FrameEntry {
    origin: usize,
    on_x: usize,
    in_xy: usize,
}

fn usual_click_error() -> f64 {
    1.0
}

/// The reference images of a file: one pair, or a list of pairs.
pub(super) fn known(path: &Path, model: &ObjectModel) -> Result<Vec<Known>, Box<dyn Error>> {
    let file = path.display();
    let wrong = |error: serde_json::Error| format!("{file}: {error}");
    let value: Value = read_json(path)?;
    let pairs: Vec<Pair> = if value.is_array() {
        serde_json::from_value(value).map_err(wrong)?
    } else {
        vec![serde_json::from_value(value).map_err(wrong)?]
    };
    if pairs.is_empty() {
        return Err(format!("{file}: no pair of images").into());
    }
    check_images(path, &pairs)?;
    let several = pairs.len() > 1;
    let of_pair = |(index, pair): (usize, &Pair)| {
        let place = if several { format!("{file}: pair {index}") } else { file.to_string() };
        if several {
            say!("pair {index}: {}", pair.image.display());
        }
        pair.known(path, model).map_err(|error| format!("{place}: {error}").into())
    };
    pairs.iter().enumerate().map(of_pair).collect()
}

/// That no image is given for two: not within a pair, and not as the reference image of two pairs, which would count as two
/// measurements.
fn check_images(file: &Path, pairs: &[Pair]) -> Result<(), Box<dyn Error>> {
    let read = |image: &Path| {
        let path = beside(file, image);
        std::fs::read(&path).map_err(|error| format!("{}: {error}", path.display()))
    };
    let firsts = pairs.iter().map(|pair| read(&pair.image)).collect::<Result<Vec<_>, _>>()?;
    for (index, (pair, first)) in pairs.iter().zip(&firsts).enumerate() {
        let second = pair.second_image.as_deref();
        let same = if second.map(read).transpose()?.is_some_and(|second| second == *first) {
            second
        } else {
            firsts[..index].iter().position(|other| other == first).map(|other| pairs[other].image.as_path())
        };
        if let Some(other) = same {
            let (image, other) = (pair.image.display(), other.display());
            return Err(format!("{image} and {other} are the same image; choose one from another side").into());
        }
    }
    Ok(())
}

impl Pair {
    fn known(&self, file: &Path, model: &ObjectModel) -> Result<Known, Box<dyn Error>> {
        let image = beside(file, &self.image);
        let clicks: Vec<Click> = self
            .clicks
            .iter()
            .map(|click| Click { first_px: Vector2::from(click.first_px), second_px: Vector2::from(click.second_px) })
            .collect();
        let pair = ClickedPair {
            first_camera: &self.first_camera,
            second_camera: &self.second_camera,
            second_from_first: Pose::try_from(&self.second_from_first)?,
            clicks: &clicks,
            sigma_px: self.sigma_px,
        };
        let FrameEntry { origin, on_x, in_xy } = self.frame;
        let reference = reference_from_clicks(&pair, FrameClicks { origin, on_x, in_xy })?;
        check_spread(&reference, model.manifest.diameter_m)?;
        say!("{:<6} {:>10} {:>10} {:>8} {:>9}", "click", "first, px", "second, px", "ray, mm", "sigma, mm");
        for (index, residual) in reference.residuals.iter().enumerate() {
            say!(
                "{index:<6} {:>10.2} {:>10.2} {:>8.2} {:>9.2}",
                residual.first_px,
                residual.second_px,
                residual.ray_mm,
                residual.sigma_mm
            );
        }
        Ok(Known {
            path: image,
            camera: self.first_camera.clone(),
            camera_from_object: reference.camera_from_object,
            region: self.box_px.into(),
        })
    }
}

/// Whether the clicked points are as far apart as points of the object can be.
fn check_spread(reference: &ClickedReference, diameter_m: f64) -> Result<(), String> {
    let points = &reference.points_in_object;
    let apart = points.iter().enumerate().flat_map(|(index, a)| points[..index].iter().map(move |b| (a - b).norm()));
    let spread_m = apart.fold(0.0, f64::max);
    if spread_m <= MAX_SPREAD * diameter_m {
        return Ok(());
    }
    Err(format!(
        "the clicked points lie up to {spread_m:.3} m apart, but the object is {diameter_m:.3} m large; is the translation of \
         'second_from_first' in millimetres? give metres"
    ))
}
