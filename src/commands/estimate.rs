use std::error::Error;
use std::fs;
use std::path::PathBuf;
use std::time::{Duration, Instant};

use clap::Args;

use super::ModelArgs;
use crate::estimator::{Answer, Estimator, ObjectPose, Report};
use crate::geometry::Camera;
use crate::model::{Store, read_json, write_atomically};
use crate::pnp::Status;
use crate::vision::{ImageLimits, Mark, decode, draw_marks, encode_png};

#[derive(Args, Debug)]
pub(super) struct Estimate {
    /// JPEG, PNG or WebP image.
    image: PathBuf,
    /// Camera that took the image (`*.camera.json`).
    #[arg(long)]
    camera: PathBuf,
    /// Print the whole answer as JSON instead of a table.
    #[arg(long)]
    json: bool,
    /// Write the image with boxes and axes drawn into it.
    #[arg(long, value_name = "OUT.png")]
    overlay: Option<PathBuf>,
    #[command(flatten)]
    models: ModelArgs,
}

impl Estimate {
    pub(super) fn run(self) -> Result<(), Box<dyn Error>> {
        let camera: Camera = read_json(&self.camera)?;
        let bytes = fs::read(&self.image).map_err(|error| format!("cannot read {}: {error}", self.image.display()))?;
        let store = Store::load(&self.models.paths(), &self.models.runtime()?)?;
        let mut estimator = Estimator::new(store);
        let start = Instant::now();
        let mut image =
            decode(&bytes, &ImageLimits::default()).map_err(|error| format!("{}: {error}", self.image.display()))?;
        let decode = start.elapsed();
        let estimate = estimator.estimate(&image, &camera)?;
        let answer = Answer { estimate, queued: Duration::ZERO, decode, total: start.elapsed() };
        if let Some(path) = &self.overlay {
            let marks: Vec<Mark> = answer.estimate.poses.iter().map(mark).collect();
            draw_marks(&mut image, &camera, &marks);
            write_atomically(path, &encode_png(&image)?)
                .map_err(|error| format!("cannot write {}: {error}", path.display()))?;
        }
        let report = Report::from(answer);
        if self.json {
            println!("{}", serde_json::to_string_pretty(&report)?);
        } else {
            print_table(&report);
        }
        Ok(())
    }
}

fn mark(found: &ObjectPose) -> Mark {
    Mark {
        bounding_box: found.detection.bounding_box,
        box_colour: match found.verdict.status {
            Status::Ok => [60, 220, 90],
            Status::Ambiguous => [250, 200, 40],
            Status::LowConfidence => [250, 130, 30],
            Status::Rejected => [230, 40, 40],
        },
        camera_from_object: found.pose.as_ref().map(|solved| solved.camera_from_object),
        axis_length_m: 0.5 * found.diameter_m,
    }
}

fn print_table(report: &Report) {
    println!("{:<12} {:<15} {:>6}  {:>26}  {:>9}", "object", "status", "score", "translation x y z (m)", "rmse (px)");
    for pose in &report.poses {
        let (translation, rmse) = pose.solved.as_ref().map_or_else(Default::default, |solved| {
            let [x, y, z] = solved.camera_from_object.translation_m;
            (format!("{x:>8.4} {y:>8.4} {z:>8.4}"), format!("{:.2}", solved.reprojection_rmse_px))
        });
        println!("{:<12} {:<15} {:>6.2}  {translation:>26}  {rmse:>9}", pose.object, pose.status, pose.detection.score);
    }
}
