use super::super::shots::Shot;
use crate::evaluation::VisibleRange;
use posed_core::geometry::Pose;

/// Two views place one object no farther apart, metres.
const SAME_PLACE_M: f64 = 2e-3;

/// One object of a scene.
pub(super) struct Instance {
    scene: usize,
    pub(super) world_from_object: Pose,
    /// The images that show enough of it.
    pub(super) views: Vec<usize>,
}

impl Instance {
    /// All instances of an object, in the order in which they are met.
    pub(super) fn all_of(shots: &[&Shot], obj_id: u32, visible: &[VisibleRange]) -> Vec<Self> {
        let mut all: Vec<Self> = Vec::new();
        for (index, shot) in shots.iter().enumerate() {
            for truth in shot.truths.iter().filter(|truth| truth.obj_id == obj_id) {
                let same = |one: &&mut Self| {
                    let apart = one.world_from_object.translation() - truth.world_from_object.translation();
                    one.scene == shot.scene && apart.norm() < SAME_PLACE_M
                };
                let counts = visible.iter().any(|range| range.contains(truth.visible));
                let views = if counts { vec![index] } else { Vec::new() };
                if let Some(known) = all.iter_mut().find(same) {
                    known.views.extend(views);
                } else {
                    all.push(Self { scene: shot.scene, world_from_object: truth.world_from_object, views });
                }
            }
        }
        all
    }
}
