use std::error::Error;
use std::fs::{self, File};
use std::path::{Path, PathBuf};
use std::sync::Arc;

use clap::{Args, Subcommand};

use super::models::ModelArgs;
use super::output::say;
use crate::estimator::{Update, load_candidate};
use crate::model::{Catalogue, KeypointManifest, Library, References, Runtime, Staged, Store, unpack};

#[derive(Args, Debug)]
pub(super) struct Objects {
    #[command(subcommand)]
    action: Action,
}

#[derive(Debug, Subcommand)]
enum Action {
    /// Put an object into the models folder, in place of the one of its name. It is loaded and run first: what cannot be served
    /// changes nothing.
    Add(Add),
    /// Remove the folder of an object. Its calibration in the folder of references stays.
    Remove(Remove),
    /// List the objects, and what each still needs.
    List(List),
}

#[derive(Args, Debug)]
struct Add {
    /// A bundle (`NAME.posed`), or a folder with `object.json` and `keypoints.onnx`.
    #[arg(required = true)]
    sources: Vec<PathBuf>,
    #[command(flatten)]
    models: ModelArgs,
}

#[derive(Args, Debug)]
struct Remove {
    /// Names of the objects.
    #[arg(required = true)]
    names: Vec<String>,
    /// Models folder.
    #[arg(long, env = "POSED_MODELS", default_value = "models")]
    models: PathBuf,
}

#[derive(Args, Debug)]
struct List {
    /// Models folder.
    #[arg(long, env = "POSED_MODELS", default_value = "models")]
    models: PathBuf,
    /// Folder with the reference `<object>.json` of each calibrated object.
    #[arg(long, env = "POSED_REFERENCE", default_value = "reference")]
    reference: PathBuf,
}

impl Objects {
    pub(super) fn run(self) -> Result<(), Box<dyn Error>> {
        match self.action {
            Action::Add(add) => add.run(),
            Action::Remove(remove) => remove.run(),
            Action::List(list) => list.run(),
        }
    }
}

impl Add {
    fn run(&self) -> Result<(), Box<dyn Error>> {
        let runtime = self.models.runtime()?;
        let store = Store::at(&self.models.models);
        store.check_writable()?;
        store.tidy();
        for source in &self.sources {
            let added = self.add(source, &store, &runtime);
            added.map_err(|error| format!("{}: {error}; nothing has changed", source.display()))?;
        }
        Ok(())
    }

    fn add(&self, source: &Path, store: &Store, runtime: &Runtime) -> Result<(), Box<dyn Error>> {
        let staged = store.stage()?;
        let scratch = format!("{}/", staged.folder().display());
        let loaded = self.stage(source, &staged, store, runtime);
        let (name, catalogue) = loaded.map_err(|error| error.to_string().replace(&scratch, ""))?;
        let replaced = store.home(&name).is_dir();
        store.put(staged, &name)?;
        say!("{name} was {} in {}", if replaced { "replaced" } else { "added" }, self.models.models.display());
        tell_needs(&catalogue, &name, &self.models.models);
        Ok(())
    }

    /// The object as it will be served, checked.
    fn stage(
        &self,
        source: &Path,
        staged: &Staged,
        store: &Store,
        runtime: &Runtime,
    ) -> Result<(String, Arc<Catalogue>), Box<dyn Error>> {
        let folder = staged.folder();
        let name = if source.is_dir() {
            copy(source, folder)?;
            KeypointManifest::read(&folder.join("object.json"))?.name
        } else {
            let limit = source.metadata()?.len();
            unpack(File::open(source)?, folder, limit)?.name
        };
        let object = load_candidate(folder, &store.home(&name), &name, runtime)?;
        if let Some(problem) = object.reference_problem() {
            return Err(problem.into());
        }
        let before = Library::load_or_empty(&self.models.models)?;
        let library = Arc::new(before.with(object));
        let references = Arc::new(References::load_usable(&self.models.reference, &library)?);
        let catalogue = Arc::new(Catalogue { library, references });
        Update::prepare(Some(&before), &catalogue, runtime)?;
        Ok((name, catalogue))
    }
}

impl Remove {
    fn run(&self) -> Result<(), Box<dyn Error>> {
        let store = Store::at(&self.models);
        for name in &self.names {
            // A name, and no path.
            if !Library::folders(&self.models)?.contains(name) {
                return Err(format!("there is no object {name:?} in {}", self.models.display()).into());
            }
            store.remove(name)?;
            say!("{name} was removed from {}", self.models.display());
        }
        Ok(())
    }
}

impl List {
    fn run(&self) -> Result<(), Box<dyn Error>> {
        let library = Library::load_or_empty(&self.models)?;
        let references = References::load_usable(&self.reference, &library)?;
        say!("{:<16} {:<10} {:<10} {:>8}  {:<64}", "object", "calibrated", "detector", "diameter", "sha256");
        for object in library.known() {
            let manifest = &object.manifest;
            let name = &manifest.name;
            let calibrated = if references.get(name).is_some() { "yes" } else { "no" };
            let detector = match library.place_of(name).and_then(|place| library.detector_of(place)) {
                None => "none",
                Some(detector) if object.detector.as_ref().is_some_and(|own| Arc::ptr_eq(own, detector)) => "own",
                Some(_) => "shared",
            };
            let diameter = format!("{:.0} mm", 1e3 * manifest.diameter_m);
            say!("{name:<16} {calibrated:<10} {detector:<10} {diameter:>8}  {}", manifest.model_sha256);
        }
        for object in library.known() {
            if let Some(problem) = references.problem(&object.manifest.name) {
                say!("{}: {problem}", object.manifest.name);
            }
        }
        Ok(())
    }
}

/// What the object lacks.
fn tell_needs(catalogue: &Catalogue, name: &str, models: &Path) {
    let Catalogue { library, references } = catalogue;
    if references.get(name).is_none() {
        let problem = references.problem(name);
        say!("{}", problem.unwrap_or_else(|| format!("it has no reference: run `posed calibrate {name}`")));
    }
    if library.without_detector().any(|other| other == name) {
        say!("no detector in {} has its label: requests must send its box ('boxes')", models.display());
    }
}

/// The files of an object's folder, and of those that may be in it.
fn copy(from: &Path, to: &Path) -> Result<(), Box<dyn Error>> {
    if !from.join("object.json").is_file() {
        return Err("it has no object.json; give a bundle, or the folder of an object".into());
    }
    copy_files(from, to)?;
    for inner in ["detector", "reference"].into_iter().filter(|inner| from.join(inner).is_dir()) {
        fs::create_dir(to.join(inner))?;
        copy_files(&from.join(inner), &to.join(inner))?;
    }
    Ok(())
}

fn copy_files(from: &Path, to: &Path) -> Result<(), Box<dyn Error>> {
    for entry in fs::read_dir(from).map_err(|error| format!("cannot read {}: {error}", from.display()))? {
        let path = entry?.path();
        if path.is_file() {
            let target = to.join(path.file_name().unwrap_or_default());
            fs::copy(&path, &target).map_err(|error| format!("cannot copy {}: {error}", path.display()))?;
            File::open(&target)?.sync_all()?;
        }
    }
    Ok(())
}
