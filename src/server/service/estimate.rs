//! Poses of one image: room, time, the queue.

use std::sync::Arc;
use std::time::{Duration, Instant};

use super::failure::Failure;
use super::options::Options;
use super::state::Service;
use crate::estimator::{Abandoned, Answer, BodyLease, Guide, QueueError, Refusal, Work};
use crate::vision::Image;

/// One image to be looked at.
pub(crate) struct PoseWork<'a> {
    pub image: Image,
    /// The room that its bytes take.
    pub body: Arc<BodyLease>,
    pub options: &'a Options,
    /// What earlier images of its stream say.
    pub guide: Option<&'a Guide>,
    /// For a picture of the answer.
    pub keep_image: bool,
    pub deadline: Instant,
}

impl Service {
    /// Room for a body, asked for before it is read: of its announced length, or of none, to grow as it comes.
    pub(crate) fn admit(&self, announced: Option<u64>, deadline: Instant) -> Result<Arc<BodyLease>, Failure> {
        let limit = self.limits.max_body_bytes;
        let bytes = match announced.map(usize::try_from) {
            None => 0,
            Some(Ok(bytes)) if bytes <= limit => bytes,
            Some(_) => return Err(Failure::body_too_large(limit)),
        };
        let admission = self.queue.admission();
        let body = self.queue.may_come(deadline).and_then(|()| admission.body(bytes));
        body.map(Arc::new).map_err(|refusal| self.refused(refusal))
    }

    /// Room for a body that comes in messages: none yet.
    pub(crate) fn lease(&self) -> Arc<BodyLease> {
        Arc::new(self.queue.admission().empty_body())
    }

    /// Room for a message that is announced. One that is a request of its own, with a deadline, needs a place, too.
    pub(crate) fn admit_message(
        &self,
        body: &BodyLease,
        bytes: usize,
        request: Option<Instant>,
    ) -> Result<(), Failure> {
        let place = request.map_or(Ok(()), |deadline| self.queue.may_come(deadline));
        place.and_then(|()| body.grow_by(bytes)).map_err(|refusal| self.refused(refusal))
    }

    pub(super) fn refused(&self, refusal: Refusal) -> Failure {
        self.queue.stats().refuse();
        refusal.into()
    }

    /// Poses from one image.
    pub(crate) async fn estimate(&self, work: PoseWork<'_>) -> Result<Answer, Failure> {
        let PoseWork { image, body, options, guide, keep_image, deadline } = work;
        let Options { camera, selection, .. } = options;
        let (camera, selection) = (camera.clone(), selection.clone());
        let guide = guide.cloned();
        let work = Work { image, body: Some(body), camera, selection, guide, keep_image, deadline };
        let answer = self.queue.estimate(work).await?;
        self.metrics.answer(&answer);
        Ok(answer)
    }

    /// Poses from one image of a batch. Images of batches wait for each other, and so leave a part of the queue to others.
    pub(crate) async fn estimate_in_turn(&self, work: PoseWork<'_>) -> Result<Answer, Failure> {
        let turn = tokio::time::timeout_at(work.deadline.into(), self.batch_turns.acquire()).await;
        // Never closed.
        let _turn = turn.map_err(|_| QueueError::from(Abandoned::Expired))?;
        self.estimate(work).await
    }

    /// When a request's time is over: what it asks for, within the limit.
    pub(crate) fn deadline(&self, asked: Option<Duration>) -> Instant {
        let time = asked.map_or(self.limits.timeout, |asked| asked.min(self.limits.max_timeout));
        Instant::now() + time
    }
}
