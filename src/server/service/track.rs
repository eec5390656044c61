//! A stream that tracks: what its frames must have in common, and what its answers say.

use std::sync::Arc;
use std::time::{Duration, Instant};

use posed_core::geometry::{Camera, Pose};

use super::failure::Failure;
use super::options::Options;
use super::state::Service;
use crate::estimator::{Estimate, FollowOptions, Follower, Guide, Tracked};

const DETECT_EVERY: std::ops::RangeInclusive<u32> = 1..=1000;

/// The tracks of one stream.
pub(crate) struct TrackedStream {
    follower: Follower,
    began: Instant,
    /// What the first frame had, and all others must have.
    first: Option<First>,
    /// When and where the camera last was.
    last: Option<(f64, Pose)>,
}

/// Metres between two frames, and metres a second, that no camera jumps or moves.
const MOST_JUMP_M: f64 = 10.0;
const MOST_SPEED: f64 = 20.0;

struct First {
    camera: Camera,
    has_time: bool,
    has_world: bool,
}

/// A frame that may come next.
pub(crate) struct NextFrame {
    pub guide: Guide,
    time_s: f64,
    has_time: bool,
    world_from_camera: Pose,
    arrived: Instant,
}

/// All that is followed, as of one frame.
pub(crate) struct Tracking {
    /// Seconds of the caller's clock, or since the stream began.
    pub capture_time: f64,
    /// From the frame's arrival to its answer.
    pub delay: Duration,
    pub detected: bool,
    pub tracks: Vec<Tracked>,
}

impl Service {
    /// Begins to follow objects.
    pub(crate) fn track(&self, options: FollowOptions) -> Result<TrackedStream, Failure> {
        if !DETECT_EVERY.contains(&options.detect_every) {
            let (every, least, most) = (options.detect_every, DETECT_EVERY.start(), DETECT_EVERY.end());
            return Err(Failure::invalid(format!(
                "field 'detect_every' is {every}; it must be between {least} and {most}, or 0 for the default"
            )));
        }
        let follower = Follower::new(Arc::clone(&self.catalogue().library), options);
        let follower = follower.map_err(|error| Failure::invalid(format!("field {error}, or 0 for the default")))?;
        Ok(TrackedStream { follower, began: Instant::now(), first: None, last: None })
    }
}

impl TrackedStream {
    /// What is expected of the next frame. Nothing changes: one that fails is as if it had never come.
    pub(crate) fn next(
        &self,
        options: &Options,
        capture_time: Option<f64>,
        arrived: Instant,
    ) -> Result<NextFrame, Failure> {
        self.check(options, capture_time)?;
        let time_s = capture_time.unwrap_or_else(|| (arrived - self.began).as_secs_f64());
        let wrong = |error| Failure::invalid(format!("field 'capture_time' {error}"));
        self.follower.check_time(time_s).map_err(wrong)?;
        let world_from_camera = options.frames.world_from_camera.unwrap_or_else(Pose::identity);
        self.check_motion(time_s, &world_from_camera)?;
        let guide = self.follower.guide(time_s, &world_from_camera, &options.selection);
        Ok(NextFrame { guide, time_s, has_time: capture_time.is_some(), world_from_camera, arrived })
    }

    fn check(&self, options: &Options, capture_time: Option<f64>) -> Result<(), Failure> {
        let Some(first) = &self.first else { return Ok(()) };
        let mixed = |field: &str| {
            Failure::invalid(format!(
                "field '{field}' is in some frames of the stream and not in others; set it in all of them, or in none"
            ))
        };
        if first.has_time != capture_time.is_some() {
            return Err(mixed("capture_time"));
        }
        if first.has_world != options.frames.world_from_camera.is_some() {
            return Err(mixed("world_from_camera"));
        }
        if !first.has_world && first.camera != options.camera {
            return Err(Failure::invalid(
                "the camera is not that of the stream's first frame; open a stream for each camera, or set \
                 'world_from_camera' in all frames: then cameras may change",
            ));
        }
        Ok(())
    }

    /// Nothing is followed from a camera that is said to jump. Other cameras may look in turn, so that a few metres mean
    /// nothing.
    fn check_motion(&self, time_s: f64, world_from_camera: &Pose) -> Result<(), Failure> {
        let Some((before_s, before)) = &self.last else { return Ok(()) };
        let (moved, passed) = ((world_from_camera.translation() - before.translation()).norm(), time_s - before_s);
        if moved > MOST_JUMP_M && moved > MOST_SPEED * passed {
            return Err(Failure::invalid(format!(
                "field 'world_from_camera' is {moved:.1} m from that of the frame before it, {passed:.3} s ago: \
                 'translation_x_m' and its like seem to be in millimetres; give metres, or open another stream"
            )));
        }
        Ok(())
    }

    /// Takes the answer to a frame.
    pub(crate) fn take(
        &mut self,
        frame: &NextFrame,
        options: &Options,
        estimate: &Estimate,
    ) -> Result<Tracking, Failure> {
        let NextFrame { guide, time_s, has_time, world_from_camera, arrived } = frame;
        let wrong = |error| Failure::invalid(format!("field 'capture_time' {error}"));
        let tracks = self.follower.take(*time_s, world_from_camera, guide, estimate).map_err(wrong)?;
        self.last = Some((*time_s, *world_from_camera));
        self.first.get_or_insert_with(|| First {
            camera: options.camera.clone(),
            has_time: *has_time,
            has_world: options.frames.world_from_camera.is_some(),
        });
        Ok(Tracking { capture_time: *time_s, delay: arrived.elapsed(), detected: guide.detect, tracks })
    }
}
