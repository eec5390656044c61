use std::fmt;

/// Why an answer has no pose of something.
#[derive(Clone, Debug, PartialEq)]
pub enum Hint {
    /// No detector looks for it.
    NoLabel { object: String },
    /// It has no reference that can be used.
    NotCalibrated { object: String, problem: Option<String> },
    /// It was removed while the image waited.
    Gone { object: String },
    /// It has poses, but none that is trusted enough.
    BelowConfidence { object: String, poses: usize, min_confidence: f64 },
    /// It was seen only where another object was seen more clearly.
    Covered { object: String },
    /// Its detector has nothing above its threshold.
    Unseen { object: String, threshold: f64 },
    /// No detector has anything above its threshold; `None` where several have different ones.
    NothingSeen { threshold: Option<f64> },
    /// There is none.
    NoDetector,
    /// The image is one of a stream, and none of those that a detector looks at.
    NotLooked,
}

impl fmt::Display for Hint {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::NoLabel { object } => {
                write!(formatter, "{object}: not in the detector's labels; send its box ('boxes')")
            }
            Self::NotCalibrated { object, problem: None } => write!(formatter, "{object}: not calibrated"),
            Self::NotCalibrated { object, problem: Some(problem) } => write!(formatter, "{object}: {problem}"),
            Self::Gone { object } => write!(formatter, "{object}: no longer served"),
            Self::BelowConfidence { object, poses, min_confidence } => {
                write!(formatter, "{object}: {poses} found, none with 'min_confidence' ({min_confidence})")
            }
            Self::Covered { object } => {
                write!(formatter, "{object}: detected only where another object is, with a better score")
            }
            Self::Unseen { object, threshold } => {
                write!(formatter, "{object}: no detection above the threshold ({threshold})")
            }
            Self::NothingSeen { threshold: Some(threshold) } => {
                write!(formatter, "no detection above the threshold ({threshold})")
            }
            Self::NothingSeen { threshold: None } => write!(formatter, "no detection above the detectors' thresholds"),
            Self::NoDetector => write!(formatter, "there is no detector; send 'boxes'"),
            Self::NotLooked => write!(formatter, "the detector did not look at this frame ('detect_every')"),
        }
    }
}
