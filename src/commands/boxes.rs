//! The file of `--boxes`: where objects are, from a detector of the user's own.

use std::collections::BTreeMap;
use std::error::Error;
use std::path::Path;

use serde::Deserialize;
use serde_json::Value;

use crate::estimator::GivenBox;
use crate::model::{Catalogue, read_json};

/// The boxes of each image.
pub(super) enum Boxes {
    /// Of the only one.
    One(Vec<GivenBox>),
    /// By file name.
    ByImage(BTreeMap<String, Vec<GivenBox>>),
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct Entry {
    object: String,
    box_px: [f64; 4],
}

impl Boxes {
    /// Reads a file and checks that its objects can be answered.
    pub(super) fn read(file: &Path, catalogue: &Catalogue) -> Result<Self, Box<dyn Error>> {
        let name = file.display();
        let wrong = |error: serde_json::Error| {
            format!("{name}: {error}; an entry is {{\"object\": NAME, \"box_px\": [x, y, width, height]}}")
        };
        let checked = |entries: Vec<Entry>| -> Result<Vec<GivenBox>, String> {
            entries.into_iter().map(|entry| entry.checked(catalogue).map_err(|e| format!("{name}: {e}"))).collect()
        };
        match read_json(file)? {
            list @ Value::Array(_) => Ok(Self::One(checked(serde_json::from_value(list).map_err(wrong)?)?)),
            Value::Object(images) => {
                let of_image = |(image, entries)| {
                    let entries: Vec<Entry> = serde_json::from_value(entries).map_err(wrong)?;
                    Ok((image, checked(entries)?))
                };
                Ok(Self::ByImage(images.into_iter().map(of_image).collect::<Result<_, Box<dyn Error>>>()?))
            }
            Value::Null | Value::Bool(_) | Value::Number(_) | Value::String(_) => {
                Err(format!("{name}: give a list of boxes, or an object with a list for each image's file name").into())
            }
        }
    }

    /// Those of an image, of so many in all.
    pub(super) fn of(&self, image: &Path, images: usize) -> Result<&[GivenBox], String> {
        match self {
            Self::One(boxes) if images == 1 => Ok(boxes),
            Self::One(_) => {
                Err(format!("--boxes has one list for {images} images; give an object with a list for each file name"))
            }
            Self::ByImage(by_image) => {
                let name = image.file_name().unwrap_or_default().to_string_lossy();
                let missing = || format!("--boxes has no entry {name:?}; add one (an empty list if nothing is there)");
                by_image.get(&*name).map(Vec::as_slice).ok_or_else(missing)
            }
        }
    }
}

impl Entry {
    fn checked(self, catalogue: &Catalogue) -> Result<GivenBox, String> {
        let Self { object, box_px } = self;
        let Catalogue { library, references } = catalogue;
        if library.object(&object).is_none() {
            let known: Vec<&str> = library.known().map(|object| object.manifest.name.as_str()).collect();
            return Err(format!("unknown object {object:?}; known objects: {}", known.join(", ")));
        }
        if references.get(&object).is_none() {
            return Err(format!("object {object:?} is not calibrated; run `posed calibrate {object}`"));
        }
        Ok(GivenBox { object, region: box_px.into() })
    }
}
