use thiserror::Error;

/// What is known of the motions, of the measurements, and how long a track goes on without any.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Options {
    /// By how much the velocity of a moving object changes within a second, one sigma, m/s. It grows with the square root of time.
    pub velocity_change_m_s: f64,
    /// The same of its turning, rad/s.
    pub turn_change_rad_s: f64,
    /// For so long the errors of the measurements are alike, seconds: frames of one such time count as one measurement.
    pub error_memory_s: f64,
    /// For so long a track goes on without a measurement, seconds; at least for [`Options::MIN_COAST_FRAMES`] frames.
    pub max_coast_s: f64,
    /// For so long a lost track may be found again, seconds.
    pub forget_s: f64,
}

/// Options that mean nothing.
#[derive(Clone, Copy, Debug, Error, PartialEq)]
#[error("'{field}' is {value}; it must be a number from {least} to {most}")]
pub struct OptionsError {
    /// Its name.
    pub field: &'static str,
    /// What it is.
    pub value: f64,
    /// The least that it may be.
    pub least: f64,
    /// The most that it may be.
    pub most: f64,
}

impl Default for Options {
    fn default() -> Self {
        Self { velocity_change_m_s: 0.5, turn_change_rad_s: 3.0, error_memory_s: 0.2, max_coast_s: 0.5, forget_s: 60.0 }
    }
}

impl Options {
    /// A track that is not measured in fewer frames goes on, however much time passes between them.
    pub const MIN_COAST_FRAMES: u32 = 3;

    /// Refuses what means nothing.
    ///
    /// # Errors
    /// [`OptionsError`] names the field and its range.
    pub fn check(&self) -> Result<(), OptionsError> {
        for (field, value, least, most) in [
            ("velocity_change_m_s", self.velocity_change_m_s, 1e-3, 100.0),
            ("turn_change_rad_s", self.turn_change_rad_s, 1e-3, 1000.0),
            ("error_memory_s", self.error_memory_s, 0.0, 10.0),
            ("max_coast_s", self.max_coast_s, 0.0, 60.0),
            ("forget_s", self.forget_s, 0.0, 3600.0),
        ] {
            // False for NaN.
            if !(least..=most).contains(&value) {
                return Err(OptionsError { field, value, least, most });
            }
        }
        Ok(())
    }
}
