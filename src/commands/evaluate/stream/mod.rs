//! Scenes as streams that track.

mod replay;
mod table;

use std::error::Error;

use super::answers::new_estimator;
use super::options::{Asked, OutputArgs};
use super::pool::in_parallel;
use super::problems::Problems;
use super::scoring::known;
use crate::commands::output::print;
use crate::evaluation::scenes;
use crate::model::ObjectModel;
use replay::Replay;

pub(super) fn run(asked: &Asked, output: &OutputArgs) -> Result<(), Box<dyn Error>> {
    let (library, references) = asked.models.library()?;
    let load = |name: &String| ObjectModel::load(&asked.models.models, name);
    let models = asked.objects.iter().map(load).collect::<Result<Vec<_>, _>>()?;
    if let Some(name) = asked.objects.iter().find(|name| references.get(name).is_none()) {
        return Err(format!("object {name:?} is not calibrated; run `posed calibrate {name}`").into());
    }
    let known = models.iter().map(|model| known(asked, model)).collect::<Result<Vec<_>, _>>()?;
    let options = asked.dataset.options()?;
    let mut folders = Vec::new();
    for split in &asked.splits.splits {
        folders.extend(scenes(split, &options)?);
    }
    let runtime = asked.models.runtime_for(usize::from(asked.work.jobs))?;
    let replay = Replay { asked, known: &known, library: &library, options: &options };
    let estimator = || {
        let mut estimator = new_estimator(&library, &references, &runtime)?;
        estimator.warm_up().map_err(|error| error.to_string())?;
        Ok(estimator)
    };
    let replayed = in_parallel(&folders, &asked.work, asked.objects.join(", "), estimator, |estimator, folder| {
        replay.scene(estimator, folder).map_err(|error| error.to_string())
    })?;
    let mut problems = Problems::default();
    let replayed = problems.taken_from(replayed);
    problems.settle(&asked.work)?;
    problems.report();
    if replayed.iter().all(|scene| scene.objects.is_empty()) {
        return Err("no view of the objects can be scored; see --visible".into());
    }
    output.write_json(&replayed)?;
    print(format_args!("{}", table::tables(&replayed)));
    Ok(())
}
