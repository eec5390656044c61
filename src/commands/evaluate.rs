use std::error::Error;
use std::fs;
use std::path::PathBuf;

use clap::Args;

use super::ModelArgs;
use crate::estimator::solve_object;
use crate::evaluation::{ObjectModel, PoseError, Score, image_ids, read_image, scenes};
use crate::model::KeypointModel;
use crate::vision::{ImageLimits, decode};

#[derive(Args, Debug)]
pub(super) struct Evaluate {
    /// Names of the objects: their folders in the models folder.
    #[arg(required = true)]
    objects: Vec<String>,
    /// BOP split: a folder of scene folders with ground truth.
    #[arg(long, value_name = "DIR")]
    split: PathBuf,
    /// BOP models folder: meshes and `models_info.json`, for scores only.
    #[arg(long, value_name = "DIR")]
    meshes: PathBuf,
    /// Views that show less of the object than this share are left out.
    #[arg(long, default_value_t = 0.7)]
    min_visible: f64,
    #[command(flatten)]
    models: ModelArgs,
}

impl Evaluate {
    pub(super) fn run(self) -> Result<(), Box<dyn Error>> {
        let (paths, runtime) = (self.models.paths(), self.models.runtime()?);
        println!("Ground-truth boxes of {}, visible fraction >= {}\n", self.split.display(), self.min_visible);
        println!("| object | views | ADD(-S) % | 5°5cm % | rotation, median (deg) | translation, median (mm) |");
        println!("|---|---|---|---|---|---|");
        for name in &self.objects {
            let mut model = KeypointModel::load(&paths, name, &runtime)?;
            let mesh = ObjectModel::read(&self.meshes, model.manifest.obj_id)?;
            let errors = self.errors(&mut model, &mesh)?;
            let score = Score::of(&errors, &mesh);
            println!(
                "| {name} | {} | {:.1} | {:.1} | {:.2} | {:.1} |",
                score.views,
                100.0 * score.add,
                100.0 * score.deg5_cm5,
                score.median_rotation_deg,
                1e3 * score.median_translation_m,
            );
        }
        Ok(())
    }

    fn errors(&self, model: &mut KeypointModel, mesh: &ObjectModel) -> Result<Vec<Option<PoseError>>, Box<dyn Error>> {
        let name = &model.manifest.name;
        let reference = model.reference.clone().ok_or_else(|| format!("{name} is not calibrated"))?;
        let obj_id = model.manifest.obj_id;
        let mut errors = Vec::new();
        for scene in scenes(&self.split)? {
            for image_id in image_ids(&scene)? {
                let (path, camera, objects) = read_image(&scene, image_id)?;
                let wanted = objects.iter().filter(|o| o.obj_id == obj_id && o.visible_fraction >= self.min_visible);
                for truth in wanted {
                    let image = decode(&fs::read(&path)?, &ImageLimits::default())?;
                    let solved = solve_object(model, &image, &truth.bounding_box, &camera)?;
                    errors.push(solved.ok().map(|solution| {
                        let (estimate, _) = reference.offset.apply(&solution.pose, &solution.covariance);
                        PoseError::new(mesh, &estimate, &truth.camera_from_object)
                    }));
                }
            }
        }
        if errors.is_empty() {
            return Err(format!("{}: no view of {}", self.split.display(), model.manifest.name).into());
        }
        Ok(errors)
    }
}
