use std::path::{Path, PathBuf};

use super::error::ImageProblem;

const ENDINGS: [&str; 5] = ["jpg", "png", "tif", "tiff", "jpeg"];

/// The file of an image. Folders are called after what they hold, and after the sensor where there are several; numbers have six
/// digits in the BOP format and four in LINEMOD.
pub(super) fn find(scene: &Path, sensor: &str, image_id: u32) -> Result<PathBuf, ImageProblem> {
    let of_sensor = [format!("rgb_{sensor}"), format!("gray_{sensor}"), sensor.to_owned()];
    let of_any = ["rgb".to_owned(), "gray".to_owned()];
    let folders = if sensor.is_empty() { &[][..] } else { &of_sensor[..] };
    let names = [format!("{image_id:06}"), format!("{image_id:04}")];
    let file = |folder: &String| {
        let candidates = names.iter().flat_map(|name| ENDINGS.map(|ending| format!("{name}.{ending}")));
        candidates.map(|name| scene.join(folder).join(name)).find(|path| path.is_file())
    };
    folders.iter().chain(&of_any).find_map(file).ok_or_else(|| {
        let folders: Vec<_> = folders.iter().chain(&of_any).map(|folder| format!("{folder}/")).collect();
        ImageProblem::NoPixels {
            folders: format!("{} ({} as png, jpg or tif)", folders.join(", "), names.join(" or ")),
        }
    })
}
