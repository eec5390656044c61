//! Which poses of which views belong together, and what becomes of each group.

use std::sync::Arc;

use nalgebra::Vector3;
use posed_core::geometry::sigmas;
use posed_core::pnp::Status;
use posed_core::views::{Sighting, ViewsOptions, associate};

use super::elsewhere;
use super::fused::{FusedPose, PosedCamera};
use super::instance::{Instance, Seen};
use crate::estimator::answer::{Estimate, ObjectPose};
use crate::model::{Catalogue, ObjectModel};

/// One pose of each object that several images show: `cameras` are those of `estimates`, in order. An object that one view
/// shows is answered as that view has it. The most trusted poses come first. Objects whose reference went out of force
/// meanwhile are missing, as are poses of a model that has been replaced between two views.
#[must_use]
pub fn fuse(cameras: &[PosedCamera], estimates: &[&Estimate]) -> Vec<FusedPose> {
    let catalogues = estimates.iter().map(|estimate| &estimate.catalogue);
    let Some(newest) = catalogues.max_by_key(|catalogue| catalogue.library.generation()) else { return Vec::new() };
    let Catalogue { library, references } = &**newest;
    let in_force: Vec<_> = library
        .objects
        .iter()
        .enumerate()
        .filter_map(|(place, model)| {
            let model = model.as_ref()?;
            Some((place, model, references.get(&model.manifest.name)?))
        })
        .collect();
    let (mut kinds, mut lost) = (Vec::with_capacity(in_force.len()), Vec::new());
    for (place, model, in_force) in &in_force {
        let offset = &in_force.reference.offset;
        let all: Vec<Seen<'_>> = seen(*place, model, cameras, estimates);
        let (placed, nowhere): (Vec<_>, Vec<_>) = all.into_iter().partition(|seen| is_sighting(seen.found));
        let groups = groups(model, &placed).into_iter();
        let groups = groups.map(|group| group.into_iter().map(|index| placed[index]).collect());
        kinds.push(groups.map(|seen| Instance { model, offset, seen }).collect::<Vec<_>>());
        lost.extend(nowhere.into_iter().map(|seen| Instance { model, offset, seen: vec![seen] }.fused()));
    }
    let borne_out = elsewhere::borne_out(kinds.iter().flatten());
    let mut fused = lost;
    for instances in &kinds {
        let mut of_kind: Vec<FusedPose> = instances.iter().map(Instance::fused).collect();
        elsewhere::doubt(instances, &borne_out, &mut of_kind);
        fused.extend(of_kind);
    }
    elsewhere::doubt_lone(&mut fused);
    fused.sort_by(|a, b| {
        let views = |fused: &FusedPose| fused.views.iter().filter(|view| view.left_out.is_none()).count();
        let by_views = || views(b).cmp(&views(a));
        a.verdict.status.cmp(&b.verdict.status).then_with(by_views).then_with(|| b.confidence.total_cmp(&a.confidence))
    });
    fused
}

/// All poses of one object.
fn seen<'a>(
    object: usize,
    model: &Arc<ObjectModel>,
    cameras: &'a [PosedCamera],
    estimates: &[&'a Estimate],
) -> Vec<Seen<'a>> {
    let has_model = |estimate: &Estimate| {
        estimate.catalogue.library.objects.get(object).and_then(Option::as_ref).is_some_and(|o| Arc::ptr_eq(o, model))
    };
    let views = cameras.iter().zip(estimates).enumerate().filter(|(_, (_, estimate))| has_model(estimate));
    let of_view = |(view, (camera, estimate)): (usize, (&'a PosedCamera, &&'a Estimate))| {
        let estimate: &'a Estimate = estimate;
        let size = (estimate.width, estimate.height);
        let of_object = estimate.poses.iter().enumerate().filter(move |(_, found)| found.detection.object == object);
        of_object.map(move |(place, found)| Seen { view, place, found, camera, optics: &estimate.camera, size })
    };
    views.flat_map(of_view).collect()
}

/// A rejected pose says not even where the object is.
fn is_sighting(found: &ObjectPose) -> bool {
    found.pose.is_some() && found.verdict.status != Status::Rejected
}

fn groups(model: &ObjectModel, seen: &[Seen<'_>]) -> Vec<Vec<usize>> {
    let sighting = |seen: &Seen<'_>| {
        let solved = seen.found.pose.as_ref()?;
        let camera_from_object = solved.camera_from_object;
        let (place, turn) = sigmas(&seen.camera.covariance.unwrap_or(ViewsOptions::default().camera_covariance));
        Some(Sighting {
            view: seen.view,
            world_from_points: seen.camera.world_from_camera * camera_from_object,
            camera_in_world: *seen.camera.world_from_camera.translation(),
            camera_sigma_m: place + turn * camera_from_object.translation().norm(),
        })
    };
    let sightings: Vec<Sighting> = seen.iter().filter_map(sighting).collect();
    // Where the objects are is compared at the middle of their keypoints, as the first view has it.
    let middle = seen.first().and_then(|first| {
        let solved = first.found.pose.as_ref()?;
        let keypoints = model.manifest.keypoints_scaled_by(solved.keypoints_scale);
        let centre = keypoints.iter().sum::<Vector3<f64>>() / keypoints.len() as f64;
        let camera_from_keypoints = solved.observed.modes.first()?.camera_from_points;
        Some(solved.camera_from_object.inverse().transform(&camera_from_keypoints.transform(&centre)))
    });
    associate(&sightings, &middle.unwrap_or_default(), 0.5 * model.manifest.diameter_m, &model.symmetries)
}
