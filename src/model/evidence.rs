use serde::{Deserialize, Serialize};

/// What speaks for and against one pose, in numbers: what trust is fitted on. Logarithms are natural.
///
/// Where a quantity does not exist, as the spread of a single crop, its field is NaN (`null` in JSON).
#[derive(Clone, Copy, Debug, Default, Deserialize, PartialEq, Serialize)]
pub struct Evidence {
    /// Logarithm of the object's extent at the pose's depth, of 100 px.
    pub size: f64,
    /// Logarithm of the root mean square distance of the crops' keypoints from their mean, of the crop's side.
    pub crops_apart: f64,
    /// Logarithm of the standard deviation, over the crops, of the logarithm of how far the keypoints are spread: depth, as the
    /// crops disagree about it.
    pub crops_scale: f64,
    /// Share of the crops that were left out, since they show the object in another way than most.
    pub crops_left_out: f64,
    /// Logarithm of how far the last look's keypoints lie from where it was cut for, of its side.
    pub look_moved: f64,
    /// Median of the keypoints' peaks.
    pub peak: f64,
    /// The least of them.
    pub least_peak: f64,
    /// Median of the second peaks' mass, of that of the first ones.
    pub second_peak: f64,
    /// Logarithm of how little the crops look like those of training, as the network says.
    pub unfamiliarity: f64,
    /// Logarithm of chi-square over degrees of freedom.
    pub residual: f64,
    /// Share of the keypoints that do not agree with the pose.
    pub outliers: f64,
    /// Posterior weight of other poses.
    pub rivals: f64,
    /// The detector's score.
    pub score: f64,
    /// Logarithm of the detector's box over the object's extent at the pose's depth.
    pub box_size: f64,
    /// Distance of the pose's centre from the box's, in larger box sides.
    pub box_shift: f64,
    /// 1 where the box touches the image's border, else 0.
    pub at_border: f64,
    /// Logarithm of the solver's standard deviation along the ray, of the diameter.
    pub sigma_depth: f64,
    /// The same across the ray.
    pub sigma_lateral: f64,
    /// Logarithm of the solver's standard deviation of the rotation, radians.
    pub sigma_rotation: f64,
    /// Mean of the box's pixels, 0..1.
    pub brightness: f64,
    /// Their standard deviation of brightness, 0..1.
    pub contrast: f64,
    /// Mean of how far the pixels' channels lie apart, 0..1.
    pub saturation: f64,
    /// Mean of red less blue, -1..1.
    pub warmth: f64,
    /// Mean of green less the mean of red and blue, -1..1.
    pub greenness: f64,
    /// Logarithm of the mean step of brightness between neighbouring pixels, over the contrast.
    pub sharpness: f64,
}

impl Evidence {
    /// Number of fields.
    pub const COUNT: usize = 25;

    /// Its fields by name.
    #[must_use]
    pub fn named(&self) -> [(&'static str, f64); Self::COUNT] {
        [
            ("size", self.size),
            ("crops_apart", self.crops_apart),
            ("crops_scale", self.crops_scale),
            ("crops_left_out", self.crops_left_out),
            ("look_moved", self.look_moved),
            ("peak", self.peak),
            ("least_peak", self.least_peak),
            ("second_peak", self.second_peak),
            ("unfamiliarity", self.unfamiliarity),
            ("residual", self.residual),
            ("outliers", self.outliers),
            ("rivals", self.rivals),
            ("score", self.score),
            ("box_size", self.box_size),
            ("box_shift", self.box_shift),
            ("at_border", self.at_border),
            ("sigma_depth", self.sigma_depth),
            ("sigma_lateral", self.sigma_lateral),
            ("sigma_rotation", self.sigma_rotation),
            ("brightness", self.brightness),
            ("contrast", self.contrast),
            ("saturation", self.saturation),
            ("warmth", self.warmth),
            ("greenness", self.greenness),
            ("sharpness", self.sharpness),
        ]
    }
}
