//! The calls that are told apart, in the metrics and by what they may do.

/// One of our calls, or any other: bounded, however many paths clients make up.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Route {
    Estimate,
    EstimateStream,
    ListObjects,
    /// Health checks, reflection, and what is no call of ours: nobody's work waits for them.
    Other,
}

impl Route {
    pub(super) fn of(path: &str) -> Self {
        match path.strip_prefix("/posed.v1.PoseService/") {
            Some("Estimate") => Self::Estimate,
            Some("EstimateStream") => Self::EstimateStream,
            Some("ListObjects") => Self::ListObjects,
            Some(_) | None => Self::Other,
        }
    }

    pub(super) fn name(self) -> &'static str {
        match self {
            Self::Estimate => "Estimate",
            Self::EstimateStream => "EstimateStream",
            Self::ListObjects => "ListObjects",
            Self::Other => "other",
        }
    }

    /// One message, and the call is complete.
    pub(super) fn is_single(self) -> bool {
        matches!(self, Self::Estimate | Self::ListObjects)
    }

    pub(super) fn is_for_poses(self) -> bool {
        matches!(self, Self::Estimate | Self::EstimateStream)
    }
}
