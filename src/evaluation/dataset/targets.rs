use std::collections::BTreeMap;
use std::path::Path;

use serde::Deserialize;

use super::error::DatasetError;
use super::file::json;

/// Which objects in which images count: the lists that come with the datasets of BOP (`test_targets_bop19.json`).
#[derive(Clone, Debug, Default)]
pub struct Targets {
    by_image: BTreeMap<(u32, u32), Vec<Target>>,
}

/// An entry of such a list.
#[derive(Clone, Copy, Debug, Deserialize, PartialEq, Eq)]
pub struct Target {
    pub scene_id: u32,
    pub im_id: u32,
    /// `None` in lists for detection: every object counts.
    pub obj_id: Option<u32>,
    /// How many instances of the object count; all if it is not said.
    pub inst_count: Option<usize>,
}

impl Targets {
    /// # Errors
    /// When the file is no such list.
    pub fn read(path: &Path) -> Result<Self, DatasetError> {
        let list: Vec<Target> = json(path)?;
        if list.is_empty() {
            return Err(DatasetError::Syntax { path: path.into(), reason: "lists no targets".into() });
        }
        let mut by_image = BTreeMap::<_, Vec<_>>::new();
        for target in list {
            by_image.entry((target.scene_id, target.im_id)).or_default().push(target);
        }
        Ok(Self { by_image })
    }

    /// How many instances of an object count in an image: none if it is not listed.
    #[must_use]
    pub fn instances(&self, scene_id: u32, image_id: u32, obj_id: u32) -> usize {
        let targets = self.by_image.get(&(scene_id, image_id)).map_or(&[][..], Vec::as_slice);
        let of_object = targets.iter().filter(|target| target.obj_id.is_none_or(|listed| listed == obj_id));
        of_object.map(|target| target.inst_count.unwrap_or(usize::MAX)).fold(0, usize::saturating_add)
    }

    /// Whether anything counts in an image.
    #[must_use]
    pub fn has_image(&self, scene_id: u32, image_id: u32) -> bool {
        self.by_image.contains_key(&(scene_id, image_id))
    }

    /// Scene and image of those that an object counts in, in order.
    pub fn images(&self, obj_id: u32) -> impl Iterator<Item = (u32, u32)> + '_ {
        self.by_image.keys().copied().filter(move |(scene, image)| self.instances(*scene, *image, obj_id) > 0)
    }
}
