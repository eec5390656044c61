use nalgebra::{Rotation3, Vector3};
use posed_core::geometry::{Pose, Symmetries};
use posed_core::views::{Sighting, associate};

use crate::scene::Scene;

const RADIUS_M: f64 = 0.05;

/// Objects of one kind on a table, sighted by cameras all around with errors as single views have: mostly in depth.
fn tray(scene: &mut Scene, objects: usize, views: usize) -> (Vec<Sighting>, Vec<usize>) {
    let mut places: Vec<Vector3<f64>> = Vec::new();
    while places.len() < objects {
        let place = Vector3::new(scene.normal() * 0.12, scene.normal() * 0.12, 0.0);
        if places.iter().all(|other| (other - place).norm() > 2.2 * RADIUS_M) {
            places.push(place);
        }
    }
    let poses: Vec<_> = places
        .iter()
        .map(|place| {
            let turn = Vector3::new(scene.normal(), scene.normal(), scene.normal());
            Pose::new(Rotation3::new(turn), *place)
        })
        .collect();
    let (mut sightings, mut truth) = (Vec::new(), Vec::new());
    for view in 0..views {
        let side = Vector3::new(scene.normal(), scene.normal(), 1.0);
        let camera = scene.seen_from(&side);
        // In another order in each view.
        for k in 0..objects {
            let object = (k + view * 3) % objects;
            let ray = (poses[object].translation() - camera.translation()).normalize();
            let shift = ray * (0.015 * scene.normal()) + Vector3::from_fn(|_, _| 0.003 * scene.normal());
            let turn = Vector3::from_fn(|_, _| 0.05 * scene.normal());
            sightings.push(Sighting {
                view,
                world_from_points: poses[object].perturbed(&shift, &turn),
                camera_in_world: *camera.translation(),
                camera_sigma_m: 1e-3,
            });
            truth.push(object);
        }
    }
    (sightings, truth)
}

#[test]
fn instances_of_one_kind_are_told_apart() {
    let (mut right, mut all) = (0, 0);
    for problem in 0..200 {
        let mut scene = Scene::new(70, problem);
        scene.world_from_points = Pose::identity();
        let objects = [1, 3, 5, 7][(problem % 4) as usize];
        let (sightings, truth) = tray(&mut scene, objects, 3);
        let groups = associate(&sightings, &Vector3::zeros(), RADIUS_M, &Symmetries::default());
        let mut seen: Vec<_> = groups.concat();
        seen.sort_unstable();
        assert!(seen.into_iter().eq(0..sightings.len()), "each sighting is in one group");
        for group in &groups {
            let views: Vec<_> = group.iter().map(|index| sightings[*index].view).collect();
            assert!(views.windows(2).all(|pair| pair[0] < pair[1]), "one of each view: {views:?}");
        }
        all += objects;
        right += groups
            .iter()
            .filter(|group| group.len() == 3 && group.iter().all(|index| truth[*index] == truth[group[0]]))
            .count();
    }
    println!("{right} of {all} instances");
    assert!(right as f64 > 0.97 * all as f64, "{right} of {all}");
}

/// A view that has an object flipped has seen it all the same; one that none of the others sees stands alone.
#[test]
fn a_flip_is_the_same_object_and_a_stranger_is_not() {
    for problem in 0..50 {
        let mut scene = Scene::new(71, problem);
        scene.world_from_points = Pose::identity();
        let (mut sightings, _) = tray(&mut scene, 1, 4);
        let flip = Pose::new(Rotation3::new(Vector3::x() * 3.0), Vector3::zeros());
        let upright = sightings[2].world_from_points;
        sightings[2].world_from_points = upright * flip;
        let aside = Vector3::new(0.3, 0.0, 0.0);
        sightings[3].world_from_points = sightings[3].world_from_points.perturbed(&aside, &Vector3::zeros());
        let groups = associate(&sightings, &Vector3::zeros(), RADIUS_M, &Symmetries::default());
        assert_eq!(groups, [vec![0, 1, 2], vec![3]], "{problem}");
    }
}

#[test]
fn nothing_is_nothing() {
    assert!(associate(&[], &Vector3::zeros(), RADIUS_M, &Symmetries::default()).is_empty());
}
