//! The calls that are told apart, in the metrics and by what they may do.

use crate::server::service::Scope;

/// One of our calls, or any other: bounded, however many paths clients make up.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Route {
    Estimate,
    EstimateStream,
    EstimateViews,
    ListObjects,
    /// Health checks.
    Health,
    /// Reflection, and what is no call of ours.
    Other,
}

impl Route {
    pub(super) fn of(path: &str) -> Self {
        match path.strip_prefix("/posed.v1.PoseService/") {
            Some("Estimate") => Self::Estimate,
            Some("EstimateStream") => Self::EstimateStream,
            Some("EstimateViews") => Self::EstimateViews,
            Some("ListObjects") => Self::ListObjects,
            None if path.starts_with("/grpc.health.v1.Health/") => Self::Health,
            Some(_) | None => Self::Other,
        }
    }

    pub(super) fn name(self) -> &'static str {
        match self {
            Self::Estimate => "Estimate",
            Self::EstimateStream => "EstimateStream",
            Self::EstimateViews => "EstimateViews",
            Self::ListObjects => "ListObjects",
            Self::Health => "health",
            Self::Other => "other",
        }
    }

    /// One message, and the call is complete.
    pub(super) fn is_single(self) -> bool {
        matches!(self, Self::Estimate | Self::EstimateViews | Self::ListObjects)
    }

    /// Nobody's work waits for the others.
    pub(super) fn is_ours(self) -> bool {
        !matches!(self, Self::Health | Self::Other)
    }

    /// What a token must be good for; health checks need none.
    pub(super) fn needs(self) -> Option<Scope> {
        match self {
            Self::Health => None,
            Self::ListObjects | Self::Other => Some(Scope::Any),
            Self::Estimate | Self::EstimateStream | Self::EstimateViews => Some(Scope::Estimate),
        }
    }

    pub(super) fn is_for_poses(self) -> bool {
        matches!(self, Self::Estimate | Self::EstimateStream | Self::EstimateViews)
    }
}
