use std::collections::BTreeMap;
use std::fmt;
use std::fs;
use std::path::Path;
use std::sync::Arc;

use super::detector::DetectorModel;
use super::load_error::LoadError;
use super::object::{DETECTOR, ObjectModel};

/// Every model, in memory: a worker makes its networks from it, and again after a fault. It never changes; what is added or
/// removed makes another one.
pub struct Library {
    /// Each object has a place, which is its own as long as the program runs: `None` where it was removed.
    pub objects: Vec<Option<Arc<ObjectModel>>>,
    /// The shared one first, then those that objects bring along.
    pub detectors: Vec<Looking>,
    /// Whose the places are.
    names: Vec<String>,
    shared: Option<Arc<DetectorModel>>,
    /// Of each object the detector that looks for it.
    detector_of: Vec<Option<usize>>,
    ok_probability: Option<f64>,
    generation: u64,
}

/// A detector, and what it looks for.
pub struct Looking {
    pub model: Arc<DetectorModel>,
    /// Of each class the place of its object. `None` where the class is no object that is served, or another detector looks for it.
    pub objects: Vec<Option<usize>>,
    /// The object that brings it along; `None` for the shared one.
    pub owner: Option<String>,
}

/// A score of 1 that is halved each time is below it after the third.
const GIVEN_UP_BELOW: f64 = 0.2;

impl Library {
    /// Loads the shared detector, if there is one, and each folder with an `object.json`.
    ///
    /// # Errors
    /// [`LoadError`] names the file, and the field where there is one.
    pub fn load(folder: &Path) -> Result<Self, LoadError> {
        let library = Self::load_or_empty(folder)?;
        let nothing = library.shared.is_none() && library.objects.is_empty();
        if nothing { Err(LoadError::Empty { path: folder.into() }) } else { Ok(library) }
    }

    /// As [`Library::load`], but a folder without any model will do.
    ///
    /// # Errors
    /// As there.
    pub fn load_or_empty(folder: &Path) -> Result<Self, LoadError> {
        let names = Self::folders(folder)?;
        let shared = load_shared(folder)?;
        let objects = names.iter().map(|name| ObjectModel::load(folder, name).map(|object| Some(Arc::new(object))));
        let objects = objects.collect::<Result<_, _>>()?;
        Ok(Self::new(names, objects, shared, None, 0))
    }

    /// Names of the folders of objects, in order. Folders whose names begin with a dot are none.
    ///
    /// # Errors
    /// [`LoadError::Folder`] where the folder cannot be read.
    pub fn folders(folder: &Path) -> Result<Vec<String>, LoadError> {
        let unreadable = |source| LoadError::Folder { path: folder.into(), source };
        let mut names = Vec::new();
        for entry in fs::read_dir(folder).map_err(unreadable)? {
            let path = entry.map_err(unreadable)?.path();
            let name = path.file_name().and_then(|name| name.to_str()).unwrap_or_default();
            if name == DETECTOR || name.starts_with('.') || !path.is_dir() {
                continue;
            }
            // One that lacks its manifest alone is a mistake; another folder is nobody's business.
            if path.join("object.json").exists() || path.join("keypoints.onnx").exists() {
                names.push(name.to_owned());
            }
        }
        names.sort();
        Ok(names)
    }

    fn new(
        names: Vec<String>,
        objects: Vec<Option<Arc<ObjectModel>>>,
        shared: Option<Arc<DetectorModel>>,
        ok_probability: Option<f64>,
        generation: u64,
    ) -> Self {
        let mut own: Vec<&Arc<ObjectModel>> =
            objects.iter().flatten().filter(|object| object.detector.is_some()).collect();
        own.sort_by(|a, b| a.manifest.name.cmp(&b.manifest.name));
        let own = own
            .into_iter()
            .filter_map(|object| Some((object.detector.as_ref().map(Arc::clone)?, Some(object.manifest.name.clone()))));
        let all: Vec<(Arc<DetectorModel>, Option<String>)> =
            shared.iter().map(|shared| (Arc::clone(shared), None)).chain(own).collect();
        let served = |place: usize| objects[place].as_ref().map(|object| object.manifest.name.as_str());
        let detector_of: Vec<Option<usize>> =
            (0..objects.len()).map(|place| who_looks_for(served(place)?, &all)).collect();
        let place_of = |name: &str| names.iter().position(|known| known == name);
        let looking = |(index, (model, owner)): (usize, (Arc<DetectorModel>, Option<String>))| {
            let object =
                |label: &Option<String>| place_of(label.as_deref()?).filter(|place| detector_of[*place] == Some(index));
            Looking { objects: model.manifest.labels.iter().map(object).collect(), model, owner }
        };
        let detectors = all.into_iter().enumerate().map(looking).collect();
        Self { objects, detectors, names, shared, detector_of, ok_probability, generation }
    }

    /// With another probability from which on poses are `ok`, for all objects that state what their evidence is worth, and for
    /// those that come later. For a library that nobody shares yet.
    #[must_use]
    pub fn with_ok_probability(mut self, ok_probability: Option<f64>) -> Self {
        self.ok_probability = ok_probability;
        for object in self.objects.iter_mut().flatten().filter_map(Arc::get_mut) {
            set_ok_probability(object, ok_probability);
        }
        self
    }

    /// With an object more, or another model of one.
    #[must_use]
    pub fn with(&self, mut object: ObjectModel) -> Self {
        set_ok_probability(&mut object, self.ok_probability);
        let (mut names, mut objects) = (self.names.clone(), self.objects.clone());
        let name = object.manifest.name.clone();
        let place = names.iter().position(|known| *known == name).unwrap_or_else(|| {
            names.push(name);
            objects.push(None);
            objects.len() - 1
        });
        objects[place] = Some(Arc::new(object));
        Self::new(names, objects, self.shared.clone(), self.ok_probability, self.generation + 1)
    }

    /// Without an object.
    #[must_use]
    pub fn without(&self, name: &str) -> Self {
        let gone = |object: &Arc<ObjectModel>| object.manifest.name == name;
        let objects = self.objects.iter().map(|object| object.clone().filter(|object| !gone(object))).collect();
        Self::new(self.names.clone(), objects, self.shared.clone(), self.ok_probability, self.generation + 1)
    }

    /// With the shared detector that lies in a models folder now, or without any.
    ///
    /// # Errors
    /// As [`Library::load`].
    pub fn with_shared_detector(&self, folder: &Path) -> Result<Self, LoadError> {
        let (names, objects) = (self.names.clone(), self.objects.clone());
        Ok(Self::new(names, objects, load_shared(folder)?, self.ok_probability, self.generation + 1))
    }

    /// The objects that are served.
    pub fn known(&self) -> impl Iterator<Item = &Arc<ObjectModel>> {
        self.objects.iter().flatten()
    }

    /// The object of a name.
    #[must_use]
    pub fn object(&self, name: &str) -> Option<&Arc<ObjectModel>> {
        self.known().find(|object| object.manifest.name == name)
    }

    /// The place of the object of a name.
    #[must_use]
    pub fn place_of(&self, name: &str) -> Option<usize> {
        let place = self.names.iter().position(|known| known == name)?;
        self.objects[place].as_ref().map(|_| place)
    }

    /// The detector that looks for the object of a place: the one that its own folder brings along, else the shared one, else
    /// the first that another object's folder brings along, by that object's name. One alone, since the scores of two are no
    /// common measure.
    #[must_use]
    pub fn detector_of(&self, place: usize) -> Option<&Arc<DetectorModel>> {
        let index = self.detector_of.get(place).copied().flatten()?;
        Some(&self.detectors[index].model)
    }

    /// What the detector of an object lets pass. Where no detector looks, a followed object is given up below this.
    #[must_use]
    pub fn least_score(&self, place: usize) -> f64 {
        self.detector_of(place).map_or(GIVEN_UP_BELOW, |detector| detector.manifest.score_threshold)
    }

    /// The detector of all objects that bring none along.
    #[must_use]
    pub fn shared_detector(&self) -> Option<&Arc<DetectorModel>> {
        self.shared.as_ref()
    }

    /// Names of the shared detector's classes that have no model folder.
    pub fn without_model(&self) -> impl Iterator<Item = &str> {
        let labels = self.shared.iter().flat_map(|shared| shared.manifest.labels.iter().flatten());
        labels.map(String::as_str).filter(|label| self.object(label).is_none())
    }

    /// Names of the objects that no detector looks for.
    pub fn without_detector(&self) -> impl Iterator<Item = &str> {
        let objects = self.objects.iter().zip(&self.detector_of).filter(|(_, detector)| detector.is_none());
        objects.filter_map(|(object, _)| object.as_ref().map(|object| object.manifest.name.as_str()))
    }

    /// Counts the changes that led to it.
    #[must_use]
    pub fn generation(&self) -> u64 {
        self.generation
    }

    /// SHA-256 of the detectors that objects bring along, by the objects' names.
    #[must_use]
    pub fn own_detectors(&self) -> BTreeMap<String, String> {
        let own = self.detectors.iter().filter_map(|one| Some((one.owner.clone()?, &one.model)));
        own.map(|(owner, model)| (owner, model.manifest.model_sha256.clone())).collect()
    }

    /// SHA-256 of each object's keypoint net, by name.
    #[must_use]
    pub fn keypoint_nets(&self) -> BTreeMap<String, String> {
        let of_object =
            |object: &Arc<ObjectModel>| (object.manifest.name.clone(), object.manifest.model_sha256.clone());
        self.known().map(of_object).collect()
    }
}

impl fmt::Debug for Library {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        formatter.debug_struct("Library").field("generation", &self.generation).finish_non_exhaustive()
    }
}

fn load_shared(folder: &Path) -> Result<Option<Arc<DetectorModel>>, LoadError> {
    let folder = folder.join(DETECTOR);
    if folder.is_dir() { DetectorModel::load(&folder).map(|model| Some(Arc::new(model))) } else { Ok(None) }
}

fn who_looks_for(name: &str, detectors: &[(Arc<DetectorModel>, Option<String>)]) -> Option<usize> {
    let knows = |(model, _): &&(Arc<DetectorModel>, Option<String>)| model.class_of(name).is_some();
    let own = detectors.iter().position(|one| one.1.as_deref() == Some(name) && knows(&one));
    own.or_else(|| detectors.iter().position(|one| knows(&one)))
}

fn set_ok_probability(object: &mut ObjectModel, ok_probability: Option<f64>) {
    let stated = object.manifest.trust.as_mut().filter(|trust| trust.probability.is_some());
    if let Some((trust, ok_probability)) = stated.zip(ok_probability) {
        trust.ok_probability = Some(ok_probability);
    }
}
