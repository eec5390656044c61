//! `EstimateStream`: frames in, one response for each.

use std::pin::pin;
use std::sync::Arc;
use std::time::Instant;

use tokio::sync::{Mutex, mpsc, watch};
use tokio::task::JoinSet;
use tonic::{Code, Status, Streaming};
use tonic_types::{ErrorDetails, StatusExt as _};

use super::answer::{TrackedFrame, estimate, estimate_tracked};
use super::call::Call;
use super::failure::{code, outcome};
use super::timeout::expired;
use super::until::shutting_down;
use crate::estimator::BodyLease;
use crate::proto::estimate_stream_request::Kind;
use crate::proto::estimate_stream_response::Result as FrameResult;
use crate::proto::{EstimateStreamRequest, EstimateStreamResponse, Frame, FrameError, StreamSettings, Tracking};
use crate::server::api::proto::follow_options;
use crate::server::pending::Pending;
use crate::server::service::{Failure, FailureKind, Service, TrackedStream};
use crate::server::stop::stopped;

const DEFAULT_WINDOW: u32 = 4;
const MAX_WINDOW: u32 = 16;

type Responses = mpsc::Sender<Result<EstimateStreamResponse, Status>>;

/// A frame and the room that it takes, whether it waits or is worked on.
struct LeasedFrame {
    frame: Frame,
    body: Arc<BodyLease>,
    arrived: Instant,
    /// Counts it.
    pending: Pending,
}

/// One stream's frames.
pub(super) struct Frames {
    service: Arc<Service>,
    call: Call,
    responses: Responses,
    /// Frames in work. Dropped with a caller that leaves, and then no longer worked on.
    in_work: JoinSet<()>,
    /// With `latest_only`: the frame that comes next.
    waiting: Option<LeasedFrame>,
    latest_only: bool,
    window: usize,
    /// With `track`. Its frames are worked on one at a time, so nobody waits for it.
    tracked: Option<Arc<Mutex<TrackedStream>>>,
    started: bool,
}

impl Frames {
    pub(super) fn new(service: Arc<Service>, call: Call, responses: Responses) -> Self {
        Self {
            service,
            call,
            responses,
            in_work: JoinSet::new(),
            waiting: None,
            latest_only: false,
            window: DEFAULT_WINDOW as usize,
            tracked: None,
            started: false,
        }
    }

    /// Serves the stream until its client closes it, leaves, or the server stops.
    pub(super) async fn run(mut self, mut requests: Streaming<EstimateStreamRequest>, stopping: watch::Receiver<bool>) {
        let responses = self.responses.clone();
        let mut stopped = pin!(stopped(stopping));
        let mut expired = pin!(expired(self.call.deadline));
        // Of the stream itself: its frames are counted one by one.
        let pending = self.pending();
        let mut end = None;
        while end.is_none() || self.is_busy() {
            tokio::select! {
                // In the order in which frames come, the server reads no more than it works on.
                request = requests.message(), if end.is_none() && self.has_room() => match request {
                    Ok(Some(request)) => {
                        if let Err(failure) = self.take(request).await {
                            end = Some(Err(self.call.failed(failure).into()));
                        }
                    }
                    Ok(None) => end = Some(Ok(())),
                    Err(status) => end = Some(Err(with_info(status))),
                },
                Some(_) = self.in_work.join_next() => self.start_waiting(),
                () = &mut stopped, if end.is_none() => {
                    end = Some(Err(shutting_down()));
                }
                () = &mut expired, if end.is_none() => {
                    end = Some(Err(Status::deadline_exceeded("the time limit of the stream expired")));
                }
                () = responses.closed() => return pending.forget(),
            }
        }
        match end {
            Some(Err(status)) => {
                pending.answered(self.call.failure().map_or_else(|| outcome(&status), FailureKind::name), None);
                // A client that has left meanwhile is no fault.
                let _ = responses.send(Err(status)).await;
            }
            Some(Ok(())) | None => pending.forget(),
        }
    }
}

impl Frames {
    fn pending(&self) -> Pending {
        Pending::new(&self.service, "grpc", "EstimateStream", true, tracing::Span::current())
    }

    fn is_busy(&self) -> bool {
        !self.in_work.is_empty() || self.waiting.is_some()
    }

    fn has_room(&self) -> bool {
        self.latest_only || self.in_work.len() < self.window
    }

    async fn take(&mut self, request: EstimateStreamRequest) -> Result<(), Failure> {
        let body = Arc::new(self.call.next_message());
        match request.kind {
            Some(Kind::Settings(settings)) => self.set(settings),
            Some(Kind::Frame(frame)) => {
                self.started = true;
                let frame = LeasedFrame { frame, body, arrived: Instant::now(), pending: self.pending() };
                if self.in_work.len() < self.window {
                    self.start(frame);
                } else if let Some(LeasedFrame { frame: replaced, pending, .. }) = self.waiting.replace(frame) {
                    pending.answered("replaced", None);
                    let message = "replaced by a newer frame ('latest_only')".to_owned();
                    let result = FrameResult::Error(FrameError { code: Code::Aborted.into(), message });
                    respond(&self.responses, replaced.frame_id, result, None).await;
                }
                Ok(())
            }
            None => Err(Failure::invalid("the message has neither 'settings' nor 'frame'; set one of them")),
        }
    }

    fn set(&mut self, settings: StreamSettings) -> Result<(), Failure> {
        if self.started {
            return Err(Failure::invalid("'settings' must be sent once, before the first frame"));
        }
        if settings.window > MAX_WINDOW {
            let window = settings.window;
            return Err(Failure::invalid(format!(
                "'window' is {window}; it must be between 1 and {MAX_WINDOW}, or 0 for the default"
            )));
        }
        if settings.tracking.is_some() && !settings.track {
            return Err(Failure::invalid("'tracking' is set, but 'track' is not; set both"));
        }
        if settings.track {
            let options = follow_options(&settings.tracking.unwrap_or_default());
            let tracked = self.service.track(options)?;
            self.tracked = Some(Arc::new(Mutex::new(tracked)));
        }
        self.started = true;
        self.latest_only = settings.latest_only;
        self.window = match (settings.latest_only || settings.track, settings.window) {
            (true, _) => 1,
            (false, 0) => DEFAULT_WINDOW as usize,
            (false, window) => window as usize,
        };
        Ok(())
    }

    fn start_waiting(&mut self) {
        if let Some(frame) = self.waiting.take() {
            self.start(frame);
        }
    }

    fn start(&mut self, frame: LeasedFrame) {
        let (service, responses) = (Arc::clone(&self.service), self.responses.clone());
        let tracked = self.tracked.clone();
        let LeasedFrame { frame: Frame { frame_id, request, capture_time }, body, arrived, pending } = frame;
        let deadline = service.deadline(None);
        let deadline = self.call.deadline.map_or(deadline, |of_stream| deadline.min(of_stream));
        self.in_work.spawn(async move {
            let message = request.unwrap_or_default();
            let answer = match tracked {
                Some(stream) => {
                    let frame = TrackedFrame { message, capture_time, body, arrived, deadline };
                    let answer = estimate_tracked(&service, &mut *stream.lock().await, frame).await;
                    answer.map(|(answer, tracking)| (answer, Some(tracking)))
                }
                None if capture_time.is_some() => Err(Failure::invalid(
                    "field 'capture_time' is set, but the stream does not track; set 'track' in its settings",
                )),
                None => estimate(&service, message, body, deadline).await.map(|answer| (answer, None)),
            };
            pending.answered(answer.as_ref().map_or_else(|failure| failure.kind.name(), |_| "ok"), None);
            let (result, tracking) = match answer {
                Ok((answer, tracking)) => (FrameResult::Answer(answer), tracking),
                Err(failure) => {
                    let error = FrameError { code: code(failure.kind).into(), message: failure.message };
                    (FrameResult::Error(error), None)
                }
            };
            respond(&responses, frame_id, result, tracking).await;
        });
    }
}

/// What tonic says of a message says no more than its code.
fn with_info(status: Status) -> Status {
    if !status.details().is_empty() {
        return status;
    }
    let setting = if status.code() == Code::OutOfRange { " ('max_body_bytes')" } else { "" };
    let (code, message) = (status.code(), format!("{}{setting}", status.message()));
    Status::with_error_details(code, message, ErrorDetails::with_error_info(outcome(&status), "posed", []))
}

async fn respond(responses: &Responses, frame_id: u64, result: FrameResult, tracking: Option<Tracking>) {
    // A client that has left meanwhile is no fault.
    let _ = responses.send(Ok(EstimateStreamResponse { frame_id, result: Some(result), tracking })).await;
}
