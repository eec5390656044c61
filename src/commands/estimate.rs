use std::collections::BTreeMap;
use std::error::Error;
use std::fs;
use std::path::{Path, PathBuf};
use std::time::{Duration, Instant};

use clap::Args;
use image::ImageFormat;

use super::boxes::Boxes;
use super::models::ModelArgs;
use super::output::say;
use crate::estimator::{
    Answer, CallerFrames, Estimate as PoseEstimate, Estimator, Frame, FusedPose, PosedCamera, Selection, ViewsPicture,
    cameras_are_meant, fuse,
};
use crate::model::{Backend, Rig, RigCamera, read_json, write_atomically};
use crate::server::api::json::{Report, ReportContext, ViewsReport};
use crate::vision::{
    DecodeError, DecodeOptions, Decoded, Image, OrientationPolicy, RawImage, RawLayout, decode, encode,
};
use posed_core::geometry::{Camera, sigmas};

#[derive(Args, Debug)]
#[expect(clippy::doc_markdown, reason = "the comments are the help text")]
pub(super) struct Estimate {
    /// Image files: JPEG, PNG or WebP, or raw frames with --raw.
    #[arg(required = true)]
    images: Vec<PathBuf>,
    /// File of the camera that took the images (`*.camera.json`).
    #[arg(long, required_unless_present = "rig")]
    camera: Option<PathBuf>,
    /// File of the rig whose cameras took the images (`*.rig.json`), one image for each camera, in their order: prints one pose
    /// for each object, in the frame of the rig. --overlay draws all views side by side into one picture.
    #[arg(long, value_name = "FILE.rig.json", conflicts_with = "camera")]
    rig: Option<PathBuf>,
    /// Layout of raw frames, for example bgr8:1280x720. ENCODING is the name in ROS: rgb8, bgr8, rgba8, bgra8, mono8,
    /// bayer_rggb8, bayer_bggr8, bayer_gbrg8, bayer_grbg8, nv12 or yuv422_yuy2. STEP is the number of bytes from one row
    /// to the next; add it if rows have padding.
    #[arg(long, value_name = "ENCODING:WIDTHxHEIGHT[:STEP]")]
    raw: Option<RawLayout>,
    /// Images of another size than the camera's are its full frame, resized: scale the parameters.
    #[arg(long)]
    allow_resize: bool,
    /// Boxes of a detector of your own, which then replaces that of the models: JSON, a list of {object, box_px: [x, y, width,
    /// height]}, or for several images an object with such a list for each file name.
    #[arg(long, value_name = "FILE.json", conflicts_with = "rig")]
    boxes: Option<PathBuf>,
    /// Print the answers as JSON instead of tables. Several images get one line each.
    #[arg(long)]
    json: bool,
    /// Write the image with boxes and axes to this file. For several images, this is a folder.
    #[arg(long, value_name = "OUT.png")]
    overlay: Option<PathBuf>,
    /// How to treat an image with an EXIF orientation.
    #[arg(long, value_enum, default_value_t)]
    exif_orientation: OrientationPolicy,
    #[command(flatten)]
    models: ModelArgs,
}

impl Estimate {
    pub(super) fn run(self) -> Result<(), Box<dyn Error>> {
        if let Some(rig) = &self.rig {
            return self.views(rig);
        }
        let camera: Camera = read_json(self.camera.as_deref().ok_or("--camera is missing")?)?;
        let runtime = self.models.runtime()?;
        let (mut estimator, catalogue) = self.models.estimator(&runtime)?;
        let boxes = self.boxes.as_deref().map(|file| Boxes::read(file, &catalogue)).transpose()?;
        self.check_overlays()?;
        let options = DecodeOptions { exif_orientation: self.exif_orientation, ..DecodeOptions::default() };
        for path in &self.images {
            let boxes = boxes.as_ref().map(|boxes| boxes.of(path, self.images.len()).map(<[_]>::to_vec)).transpose()?;
            let selection = Selection { allow_resize: self.allow_resize, boxes, ..Selection::ALL };
            let mut answer = read(path, self.raw)
                .and_then(|image| estimate(&mut estimator, &image, &camera, &selection, &options))
                .map_err(|error| format!("{}: {error}{}", path.display(), Self::advice(error.as_ref())))?;
            if let (Some(out), Some(mut image)) = (self.overlay_path(path), answer.image.take()) {
                answer.estimate.draw(&mut image);
                write_atomically(&out, &encode(&image, ImageFormat::Png)?)
                    .map_err(|error| format!("cannot write {}: {error}", out.display()))?;
            }
            let frames = CallerFrames::default();
            let context = ReportContext { provider: runtime.provider(), frames: &frames, captured_at: None };
            let report = Report::new(&answer, &context);
            if !self.json {
                print_table(path, &answer.estimate);
            } else if self.images.len() > 1 {
                say!("{}", serde_json::to_string(&report)?);
            } else {
                say!("{}", serde_json::to_string_pretty(&report)?);
            }
        }
        Ok(())
    }

    /// Several images of one scene.
    fn views(&self, rig: &Path) -> Result<(), Box<dyn Error>> {
        let rig = Rig::read_with_cameras_beside(rig)?;
        if rig.cameras.len() != self.images.len() {
            let (images, cameras) = (self.images.len(), rig.cameras.len());
            return Err(
                format!("{images} images for {cameras} cameras; give one image for each, in their order").into()
            );
        }
        let runtime = self.models.runtime()?;
        let (mut estimator, _) = self.models.estimator(&runtime)?;
        let selection = Selection { allow_resize: self.allow_resize, ..Selection::ALL };
        let options = DecodeOptions { exif_orientation: self.exif_orientation, ..DecodeOptions::default() };
        let answer = |(path, camera): (&PathBuf, &RigCamera)| {
            read(path, self.raw)
                .and_then(|image| estimate(&mut estimator, &image, &camera.camera, &selection, &options))
                .map_err(|error| format!("{}: {error}{}", path.display(), Self::advice(error.as_ref())))
        };
        let mut answers = self.images.iter().zip(&rig.cameras).map(answer).collect::<Result<Vec<_>, _>>()?;
        let posed = |camera: &RigCamera| PosedCamera {
            world_from_camera: camera.rig_from_camera,
            covariance: camera.covariance,
        };
        let cameras: Vec<PosedCamera> = rig.cameras.iter().map(posed).collect();
        let images: Vec<_> = answers.iter_mut().filter_map(|answer| answer.image.take()).collect();
        let estimates: Vec<&PoseEstimate> = answers.iter().map(|answer| &answer.estimate).collect();
        let fused = fuse(&cameras, &estimates);
        cameras_are_meant(&cameras, &estimates, &fused)?;
        if let Some(out) = &self.overlay {
            let each = images.iter().zip(&estimates).enumerate();
            let drawn: Vec<_> =
                each.map(|(view, (image, estimate))| ViewsPicture::of(image).drawn(view, estimate, &fused)).collect();
            write_atomically(out, &encode(&ViewsPicture::side_by_side(&drawn), ImageFormat::Png)?)
                .map_err(|error| format!("cannot write {}: {error}", out.display()))?;
        }
        if self.json {
            say!("{}", serde_json::to_string_pretty(&ViewsReport::new(&answers, &fused, runtime.provider(), None))?);
        } else {
            print_fused(&fused);
        }
        Ok(())
    }

    /// The option that an error asks for.
    fn advice(error: &(dyn Error + 'static)) -> &'static str {
        match error.downcast_ref() {
            Some(DecodeError::Orientation(_)) => ", or choose with --exif-orientation",
            Some(_) | None => "",
        }
    }

    /// No picture may replace another one.
    fn check_overlays(&self) -> Result<(), Box<dyn Error>> {
        let mut seen = BTreeMap::new();
        for image in &self.images {
            let Some(out) = self.overlay_path(image) else { continue };
            if let Some(other) = seen.insert(out.clone(), image) {
                let (image, other, out) = (image.display(), other.display(), out.display());
                return Err(
                    format!("{other} and {image} would both be drawn to {out}; give them different names").into()
                );
            }
        }
        Ok(())
    }

    fn overlay_path(&self, image: &Path) -> Option<PathBuf> {
        let out = self.overlay.as_ref()?;
        if self.images.len() == 1 {
            return Some(out.clone());
        }
        // Not `with_extension`: of `cam.0001` it would take the number for one.
        Some(out.join(format!("{}.png", image.file_stem()?.display())))
    }
}

fn read(path: &Path, raw: Option<RawLayout>) -> Result<Image, Box<dyn Error>> {
    let bytes = fs::read(path)?.into();
    Ok(match raw {
        Some(layout) => Image::Raw(RawImage::new(layout, bytes)?),
        None => Image::Encoded(bytes),
    })
}

fn estimate(
    estimator: &mut Estimator,
    image: &Image,
    camera: &Camera,
    selection: &Selection,
    options: &DecodeOptions,
) -> Result<Answer, Box<dyn Error>> {
    let start = Instant::now();
    let Decoded { image, exif } = decode(image, options)?;
    let decode = start.elapsed();
    let frame = Frame { selection, ..Frame::new(&image, camera) };
    // One frame, one answer.
    let estimate = estimator.estimate_all(&[frame]).swap_remove(0)?;
    Ok(Answer {
        estimate,
        exif,
        image: Some(image),
        room: None,
        batch_size: 1,
        queued: Duration::ZERO,
        decode,
        total: start.elapsed(),
    })
}

fn print_fused(fused: &[FusedPose]) {
    say!(
        "{:<12} {:<15} {:>8}  {:>26}  {:>10}  reasons",
        "object",
        "status",
        "views",
        "translation x y z (m)",
        "sigma (mm)"
    );
    for object in fused {
        let used = object.views.iter().filter(|view| view.left_out.is_none()).count();
        let views = format!("{used} of {}", object.views.len());
        let (translation, sigma) = object.pose.as_ref().map_or_else(Default::default, |(pose, covariance)| {
            let [x, y, z] = pose.translation_m();
            (format!("{x:>8.4} {y:>8.4} {z:>8.4}"), format!("{:.1}", 1e3 * sigmas(covariance).0))
        });
        let reasons: Vec<_> = object.verdict.reasons.iter().map(|reason| reason.to_string()).collect();
        let (name, status, reasons) = (&object.object, object.verdict.status, reasons.join(", "));
        say!("{name:<12} {status:<15} {views:>8}  {translation:>26}  {sigma:>10}  {reasons}");
    }
}

fn print_table(path: &Path, estimate: &PoseEstimate) {
    say!("{}", path.display());
    say!(
        "  {:<12} {:<15} {:>10}  {:>26}  {:>9}",
        "object",
        "status",
        "confidence",
        "translation x y z (m)",
        "rmse (px)"
    );
    for found in &estimate.poses {
        let (translation, rmse) = found.pose.as_ref().map_or_else(Default::default, |solved| {
            let [x, y, z] = solved.camera_from_object.translation_m();
            (format!("{x:>8.4} {y:>8.4} {z:>8.4}"), format!("{:.2}", solved.reprojection_rmse_px))
        });
        let (object, status, confidence) = (&found.object, found.verdict.status, found.confidence());
        say!("  {object:<12} {status:<15} {confidence:>10.2}  {translation:>26}  {rmse:>9}");
    }
    for hint in &estimate.hints {
        say!("  {hint}");
    }
}
