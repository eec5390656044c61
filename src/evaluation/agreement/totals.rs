use serde::Serialize;

use super::deviation::ViewDeviation;
use super::scene::{JudgedObservation, SceneAgreement};
use posed_core::pnp::Status;

/// What all scenes tell of one object.
#[derive(Clone, Debug, Serialize)]
pub struct Totals {
    /// Images that were looked at.
    pub images: usize,
    /// Objects that were seen in two images or more.
    pub instances: usize,
    /// Poses, of any status.
    pub answers: usize,
    /// Poses with status `ok`.
    pub ok: usize,
    /// Of these, those that disagree with the other views: the wrong answers that a robot would act on.
    pub ok_disagreeing: usize,
    /// Of those that disagree, the flipped ones.
    pub ok_flipped: usize,
    /// `ok` where no other image sees the object: nothing says whether they are right.
    pub ok_alone: usize,
    /// Poses of any status that disagree, that are flipped, and that no other image sees.
    pub disagreeing: usize,
    pub flipped: usize,
    pub alone: usize,
    /// Instances in which no two views agree.
    pub without_consensus: usize,
    /// Median over all compared poses of [`super::Instance::view_angle_deg`].
    pub view_angle_deg: Option<f64>,
    /// Deviations of poses with status `ok`; `None` without any.
    pub spread_of_ok: Option<Spread>,
    /// Deviations of all poses.
    pub spread_of_all: Option<Spread>,
}

/// How far poses are from what the other views say.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Spread {
    pub views: usize,
    pub translation_m: Quantiles,
    /// Along the ray, without its sign.
    pub depth_m: Quantiles,
    pub lateral_m: Quantiles,
    pub rotation_deg: Quantiles,
    /// Of [`super::Nees::total`].
    pub nees_mean: f64,
    pub nees_median: f64,
    /// Means by degree of freedom, 1 each if the covariances are true.
    pub nees_depth: f64,
    pub nees_lateral: f64,
    pub nees_rotation: f64,
    /// Share within the 95 % ellipsoid, 0..1.
    pub within_95: f64,
    /// Median along the ray with its sign, and the share of poses beyond the others: 0.5 if nothing is wrong with the scale.
    pub depth_bias_m: f64,
    pub share_too_far: f64,
}

/// Median and 90th percentile.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Quantiles {
    pub median: f64,
    pub p90: f64,
}

impl Totals {
    /// Of scenes with so many images together.
    #[must_use]
    pub fn of(images: usize, scenes: &[SceneAgreement]) -> Self {
        let judged: Vec<&JudgedObservation> = scenes.iter().flat_map(SceneAgreement::judged).collect();
        let alone = || scenes.iter().flat_map(|scene| &scene.alone);
        let is_ok = |one: &&&JudgedObservation| one.found.status == Status::Ok;
        let disagrees = |one: &&&JudgedObservation| one.deviation.disagrees;
        let flipped = |one: &&&JudgedObservation| one.deviation.flipped;
        let instances = || scenes.iter().flat_map(|scene| &scene.instances);
        let angles =
            instances().flat_map(|instance| vec![instance.view_angle_deg; instance.observations.len()]).collect();
        let ok_alone = alone().filter(|found| found.status == Status::Ok).count();
        Self {
            images,
            instances: instances().count(),
            answers: judged.len() + alone().count(),
            ok: judged.iter().filter(is_ok).count() + ok_alone,
            ok_disagreeing: judged.iter().filter(is_ok).filter(disagrees).count(),
            ok_flipped: judged.iter().filter(is_ok).filter(flipped).count(),
            ok_alone,
            disagreeing: judged.iter().filter(disagrees).count(),
            flipped: judged.iter().filter(flipped).count(),
            alone: alone().count(),
            without_consensus: instances().filter(|instance| instance.support < 2).count(),
            view_angle_deg: Quantiles::of(angles).map(|angles| angles.median),
            spread_of_ok: Spread::of(judged.iter().filter(is_ok).map(|one| &one.deviation)),
            spread_of_all: Spread::of(judged.iter().map(|one| &one.deviation)),
        }
    }
}

impl Spread {
    /// `None` without deviations.
    pub fn of<'a>(deviations: impl Iterator<Item = &'a ViewDeviation>) -> Option<Self> {
        let all: Vec<_> = deviations.collect();
        let values = |value: fn(&ViewDeviation) -> f64| all.iter().map(|one| value(one)).collect::<Vec<_>>();
        let mean = |value: fn(&ViewDeviation) -> f64| values(value).iter().sum::<f64>() / all.len() as f64;
        let nees = Quantiles::of(values(|one| one.nees.total))?;
        Some(Self {
            views: all.len(),
            translation_m: Quantiles::of(values(|one| one.translation_m))?,
            depth_m: Quantiles::of(values(|one| one.depth_m.abs()))?,
            lateral_m: Quantiles::of(values(|one| one.lateral_m))?,
            rotation_deg: Quantiles::of(values(|one| one.rotation_deg))?,
            nees_mean: mean(|one| one.nees.total),
            nees_median: nees.median,
            nees_depth: mean(|one| one.nees.depth),
            nees_lateral: mean(|one| one.nees.lateral / 2.0),
            nees_rotation: mean(|one| one.nees.rotation / (one.nees.degrees_of_freedom - 3) as f64),
            within_95: mean(|one| f64::from(u8::from(one.nees.within_95))),
            depth_bias_m: Quantiles::of(values(|one| one.depth_m))?.median,
            share_too_far: mean(|one| f64::from(u8::from(one.depth_m > 0.0))),
        })
    }
}

impl Quantiles {
    /// `None` without values. Each is one of the values: the first that so many are not above.
    #[must_use]
    pub fn of(mut values: Vec<f64>) -> Option<Self> {
        values.sort_by(f64::total_cmp);
        let quantile = |percent: usize| values.get((values.len() * percent).div_ceil(100).checked_sub(1)?).copied();
        Some(Self { median: quantile(50)?, p90: quantile(90)? })
    }
}
