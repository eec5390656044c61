use std::collections::BTreeMap;

use serde::{Deserialize, Serialize};

use super::file::Invalid;
use crate::model::Evidence;

/// How an object's evidence becomes honest covariances and a probability: `posed-train trust` fits it on views that the network
/// has not learned from.
#[derive(Clone, Debug, Deserialize, Serialize)]
#[serde(deny_unknown_fields)]
pub struct Trust {
    /// Of each kind of evidence that is used the least and the largest value that the fit has seen. What lies beyond is taken
    /// for the end: a fit says nothing about what it has not seen. What is not known is taken for the middle.
    pub ranges: BTreeMap<String, [f64; 2]>,
    /// What the solver's standard deviations are multiplied by.
    pub covariance: CovarianceTrust,
    /// The logit of the probability that the pose is right: that its ADD(-S) is below a tenth of the diameter. `None` where too
    /// few views could tell: then only covariances are known.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub probability: Option<Linear>,
    /// A pose whose probability is below this is not `ok`.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub ok_probability: Option<f64>,
}

/// Logarithms of factors, for the parts of a pose's error.
#[derive(Clone, Debug, Deserialize, Serialize)]
#[serde(deny_unknown_fields)]
pub struct CovarianceTrust {
    /// Along the ray to the object.
    pub depth: Linear,
    /// Across it.
    pub lateral: Linear,
    pub rotation: Linear,
}

/// A linear function of evidence.
#[derive(Clone, Debug, Deserialize, Serialize)]
#[serde(deny_unknown_fields)]
pub struct Linear {
    pub constant: f64,
    /// By kind of evidence.
    #[serde(default)]
    pub weights: BTreeMap<String, f64>,
}

/// Factors of standard deviations beyond e^4 either way are no calibration.
const MAX_LOG_FACTOR: f64 = 4.0;

impl Trust {
    /// Factors of the solver's standard deviations: along the ray, across it, and of the rotation.
    #[must_use]
    pub fn factors(&self, evidence: &Evidence) -> [f64; 3] {
        let CovarianceTrust { depth, lateral, rotation } = &self.covariance;
        [depth, lateral, rotation].map(|part| self.value(part, evidence).clamp(-MAX_LOG_FACTOR, MAX_LOG_FACTOR).exp())
    }

    /// That the pose is right, 0..1.
    #[must_use]
    pub fn probability(&self, evidence: &Evidence) -> Option<f64> {
        self.probability.as_ref().map(|logit| (1.0 + (-self.value(logit, evidence)).exp()).recip())
    }

    /// A setting that is a probability.
    ///
    /// # Errors
    /// In words that say what it must be.
    pub fn parse_probability(text: &str) -> Result<f64, String> {
        let number = text.parse().ok().filter(|number| (0.0..=1.0).contains(number));
        number.ok_or_else(|| "it must be a number from 0 to 1".into())
    }

    fn value(&self, linear: &Linear, evidence: &Evidence) -> f64 {
        let terms = evidence.named().into_iter().filter_map(|(name, value)| {
            let [least, most] = *self.ranges.get(name)?;
            let known = if value.is_nan() { f64::midpoint(least, most) } else { value.clamp(least, most) };
            Some(linear.weights.get(name)? * known)
        });
        linear.constant + terms.sum::<f64>()
    }

    pub(super) fn check(&self) -> Result<(), Invalid> {
        let names = Evidence::default().named().map(|(name, _)| name);
        if let Some(name) = self.ranges.keys().find(|name| !names.contains(&name.as_str())) {
            return Err((
                "trust.ranges",
                format!("has {name:?}, which is no evidence; known are {}", names.join(", ")),
            ));
        }
        let ordered = |[least, most]: &[f64; 2]| least.is_finite() && most.is_finite() && least <= most;
        if let Some((name, range)) = self.ranges.iter().find(|(_, range)| !ordered(range)) {
            return Err((
                "trust.ranges",
                format!("has {range:?} for {name:?}; give the least value, then the largest"),
            ));
        }
        let CovarianceTrust { depth, lateral, rotation } = &self.covariance;
        let parts = [
            ("trust.covariance.depth", depth),
            ("trust.covariance.lateral", lateral),
            ("trust.covariance.rotation", rotation),
        ];
        let probability = self.probability.iter().map(|linear| ("trust.probability", linear));
        for (field, linear) in parts.into_iter().chain(probability) {
            if let Some(name) = linear.weights.keys().find(|name| !self.ranges.contains_key(*name)) {
                return Err((field, format!("has a weight for {name:?}, which has no range in 'trust.ranges'")));
            }
            if !linear.weights.values().chain([&linear.constant]).all(|value| value.abs() <= 1e6) {
                return Err((field, "has a number beyond 1e6".into()));
            }
        }
        match (&self.probability, self.ok_probability) {
            (Some(_), Some(least)) if (0.0..=1.0).contains(&least) => Ok(()),
            (Some(_), Some(least)) => Err(("trust.ok_probability", format!("is {least}; it must be between 0 and 1"))),
            (Some(_), None) => Err(("trust.ok_probability", "is missing; 'trust.probability' needs it".into())),
            (None, Some(_)) => Err(("trust.probability", "is missing; 'trust.ok_probability' needs it".into())),
            (None, None) => Ok(()),
        }
    }
}
