use serde::Serialize;

use super::pose_error::Deviation;
use super::statistics::{mean, median, share};

/// ADD(-S) below this share of the diameter is right.
const ADD_SHARE_OF_DIAMETER: f64 = 0.1;
/// Projections nearer than this on average are right.
const PROJECTION_PX: f64 = 5.0;
/// Degrees and centimetres that the field counts within.
const DEGREES_CENTIMETRES: [(u32, u32); 6] = [(2, 2), (5, 2), (5, 5), (10, 2), (10, 5), (10, 10)];
/// Thresholds of an average recall are 1 to 10 times a step.
const STEPS: u32 = 10;
/// A step of `AR_MSSD`, of the diameter.
const MSSD_STEP: f64 = 0.05;
/// A step of `AR_MSPD`, pixels in an image so wide.
const MSPD_STEP_PX: f64 = 5.0;
const MSPD_WIDTH_PX: f64 = 640.0;

/// One view of an object, and what was found there.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ScoredView {
    /// `None` where there is no pose: the view counts as wrong everywhere.
    pub deviation: Option<Deviation>,
    /// Of the object, metres.
    pub diameter_m: f64,
    /// Of the image, pixels.
    pub image_width_px: u32,
}

impl Deviation {
    /// Whether ADD(-S) is below a tenth of the diameter.
    #[must_use]
    pub fn is_right(&self, diameter_m: f64) -> bool {
        self.add_m < ADD_SHARE_OF_DIAMETER * diameter_m
    }
}

impl ScoredView {
    /// Whether ADD(-S) is below a tenth of the diameter.
    #[must_use]
    pub fn is_right(&self) -> bool {
        self.deviation.is_some_and(|deviation| deviation.is_right(self.diameter_m))
    }

    /// Share of the thresholds of `AR_MSSD` that the view is within, 0..1.
    #[must_use]
    pub fn recall_mssd(&self) -> f64 {
        self.recall(|deviation| deviation.mssd_m / (MSSD_STEP * self.diameter_m))
    }

    /// Share of the thresholds of `AR_MSPD` that the view is within, 0..1.
    #[must_use]
    pub fn recall_mspd(&self) -> f64 {
        self.recall(|deviation| deviation.mspd_px / (MSPD_STEP_PX * f64::from(self.image_width_px) / MSPD_WIDTH_PX))
    }

    fn recall(&self, in_steps: impl Fn(&Deviation) -> f64) -> f64 {
        let steps = self.deviation.as_ref().map_or(f64::INFINITY, in_steps);
        f64::from((1..=STEPS).map(|step| u32::from(steps < f64::from(step))).sum::<u32>()) / f64::from(STEPS)
    }
}

/// Accuracy over views, of one object or of several.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Recall {
    /// Views, with a pose or without.
    pub views: usize,
    /// Those with a pose.
    pub poses: usize,
    /// Share with ADD(-S) below a tenth of the diameter: Hinterstoisser et al. (ACCV 2012).
    pub add: f64,
    /// Share with projections within 5 pixels on average: Brachmann et al. (CVPR 2016).
    pub proj5: f64,
    /// Shares within n degrees and m centimetres: Shotton et al. (CVPR 2013) for 5° 5 cm.
    pub degrees_centimetres: Vec<DegreesCentimetres>,
    /// Mean over the thresholds 0.05, 0.10 to 0.50 of the diameter of the share with a smaller MSSD: Hodaň et al., BOP Challenge
    /// 2020 (ECCVW 2020), section 2.4.
    pub ar_mssd: f64,
    /// Mean over the thresholds 5 r, 10 r to 50 r pixels of the share with a smaller MSPD, where r is the image's width over 640.
    /// Ibidem.
    pub ar_mspd: f64,
    /// Mean of `AR_MSSD` and `AR_MSPD`: the average recall of BOP without VSD, which needs depth images.
    pub ar_without_vsd: f64,
    /// Median over all views; infinite (null in JSON) where half of them have no pose.
    pub median_add_m: f64,
    /// Likewise, to the nearest pose that looks like the true one.
    pub median_rotation_deg: f64,
    /// Likewise.
    pub median_translation_m: f64,
}

/// Share of views within so many degrees and centimetres.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct DegreesCentimetres {
    /// Largest angle, degrees.
    pub degrees: u32,
    /// Largest distance of the origins, centimetres.
    pub centimetres: u32,
    /// 0..1.
    pub share: f64,
}

impl Recall {
    /// `None` without views.
    #[must_use]
    pub fn of(views: &[ScoredView]) -> Option<Self> {
        let found = || views.iter().filter_map(|view| view.deviation);
        let within = |right: &dyn Fn(&Deviation) -> bool| {
            share(found().filter(|deviation| right(deviation)).count(), views.len())
        };
        let all = |value: fn(&Deviation) -> f64| {
            median(views.iter().map(|view| view.deviation.as_ref().map_or(f64::INFINITY, value)))
        };
        let degrees_centimetres = DEGREES_CENTIMETRES.iter().map(|&(degrees, centimetres)| {
            let (most_deg, most_m) = (f64::from(degrees), f64::from(centimetres) / 100.0);
            let share = within(&|deviation| deviation.rotation_deg < most_deg && deviation.translation_m < most_m)?;
            Some(DegreesCentimetres { degrees, centimetres, share })
        });
        let ar_mssd = mean(views.iter().map(ScoredView::recall_mssd))?;
        let ar_mspd = mean(views.iter().map(ScoredView::recall_mspd))?;
        Some(Self {
            views: views.len(),
            poses: found().count(),
            add: share(views.iter().filter(|view| view.is_right()).count(), views.len())?,
            proj5: within(&|deviation| deviation.projection_px < PROJECTION_PX)?,
            degrees_centimetres: degrees_centimetres.collect::<Option<_>>()?,
            ar_mssd,
            ar_mspd,
            ar_without_vsd: f64::midpoint(ar_mssd, ar_mspd),
            median_add_m: all(|deviation| deviation.add_m)?,
            median_rotation_deg: all(|deviation| deviation.rotation_deg)?,
            median_translation_m: all(|deviation| deviation.translation_m)?,
        })
    }

    /// The share within so many degrees and centimetres, if it is among those that are counted.
    #[must_use]
    pub fn within(&self, degrees: u32, centimetres: u32) -> Option<f64> {
        let this = |one: &&DegreesCentimetres| (one.degrees, one.centimetres) == (degrees, centimetres);
        self.degrees_centimetres.iter().find(this).map(|one| one.share)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn view(deviation: Option<Deviation>, image_width_px: u32) -> ScoredView {
        ScoredView { deviation, diameter_m: 0.1, image_width_px }
    }

    fn deviation() -> Deviation {
        Deviation {
            add_m: 0.009,
            projection_px: 5.5,
            mssd_m: 0.012,
            mspd_px: 12.0,
            rotation_deg: 4.0,
            translation_m: 0.03,
        }
    }

    #[test]
    fn thresholds_are_those_of_the_field() {
        let recall = Recall::of(&[view(Some(deviation()), 640)]).unwrap();
        assert_eq!((recall.add, recall.proj5), (1.0, 0.0));
        let within = |degrees, centimetres| recall.within(degrees, centimetres);
        assert_eq!([within(2, 2), within(5, 2), within(10, 2)], [Some(0.0); 3]);
        assert_eq!([within(5, 5), within(10, 5), within(10, 10)], [Some(1.0); 3]);
        assert_eq!(within(3, 3), None);
        // 0.012 is below 0.015, the third of ten, and 12 below 15.
        assert!((recall.ar_mssd - 0.8).abs() < 1e-12 && (recall.ar_mspd - 0.8).abs() < 1e-12);
        // In an image of twice the width, 12 pixels are 6.
        let recall = Recall::of(&[view(Some(deviation()), 1280)]).unwrap();
        assert!((recall.ar_mspd - 0.9).abs() < 1e-12 && (recall.ar_without_vsd - 0.85).abs() < 1e-12);
    }

    #[test]
    fn an_error_at_a_threshold_is_not_below_it() {
        let at = Deviation { mspd_px: 15.0, add_m: 0.1 * 0.1, projection_px: 5.0, ..deviation() };
        let recall = Recall::of(&[view(Some(at), 640)]).unwrap();
        assert!((recall.ar_mspd - 0.7).abs() < 1e-12);
        assert_eq!((recall.add, recall.proj5), (0.0, 0.0));
    }

    #[test]
    fn a_view_without_a_pose_is_wrong_everywhere() {
        let recall = Recall::of(&[view(Some(deviation()), 640), view(None, 640), view(None, 640)]).unwrap();
        assert_eq!((recall.views, recall.poses), (3, 1));
        let third = 1.0 / 3.0;
        assert!((recall.add - third).abs() < 1e-12 && (recall.ar_mssd - 0.8 * third).abs() < 1e-12);
        assert!((recall.within(5, 5).unwrap() - third).abs() < 1e-12);
        assert!(recall.median_add_m.is_infinite());
        assert_eq!(serde_json::to_value(&recall).unwrap()["median_add_m"], serde_json::Value::Null);
        assert_eq!(Recall::of(&[]), None);
        let recall = Recall::of(&[view(None, 640)]).unwrap();
        assert_eq!((recall.add, recall.proj5, recall.ar_without_vsd), (0.0, 0.0, 0.0));
    }
}
