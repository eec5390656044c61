//! Room for what comes: asked for before memory is taken, given back when it is.
//!
//! Three budgets bound what all callers together can make the process hold: images from the moment they are whole until
//! they are answered, bytes of bodies from their announcement until nobody holds them any more, and bytes of pixels from
//! an image's header until its answer has left.

use std::sync::Arc;
use std::sync::atomic::{AtomicUsize, Ordering};
use std::time::Duration;

use thiserror::Error;
use tokio::sync::{OwnedSemaphorePermit, Semaphore};

/// How much there may be at once.
#[derive(Clone, Copy, Debug)]
pub struct Room {
    /// Images in work or waiting.
    pub images: usize,
    /// Bytes of bodies: encoded images, raw frames, and what comes with them.
    pub bytes: usize,
    /// Bytes of decoded images, and of decoding.
    pub pixel_bytes: usize,
}

impl Room {
    /// What pictures of answers may take of `pixel_bytes`.
    #[must_use]
    pub fn picture_bytes(&self) -> usize {
        self.pixel_bytes - self.pixel_bytes / 4
    }

    /// How many `bytes` there must be for a body of this size to find room: large ones leave an eighth to small ones.
    #[must_use]
    pub fn least_bytes(body: usize) -> usize {
        if body > SMALL_BODY { body.saturating_add(body.div_ceil(RESERVED_SHARE - 1)) } else { body }
    }
}

/// There is no room now.
#[derive(Clone, Copy, Debug, Error, PartialEq, Eq)]
pub enum Refusal {
    #[error("the queue is full: {limit} images are waiting or in progress ('queue'); retry later")]
    Images { limit: usize },
    #[error("no room for the body: all bodies together are limited to {limit} bytes ('queue_bytes'); retry later")]
    Bytes { limit: usize },
    #[error(
        "the server is busy: the image would be answered in about {} ms, after the time limit of the request; retry later, \
         or allow more time", expected.as_millis()
    )]
    Busy { expected: Duration },
    #[error(
        "the time limit of the request is too short: an image takes about {} ms at the moment; allow more time",
        alone.as_millis()
    )]
    Hasty { alone: Duration },
    #[error("all workers have failed or hang; the log of the server has the details")]
    NoWorkers,
}

/// A body up to this size may take the last eighth of the bytes: large bodies never keep the small ones out.
const SMALL_BODY: usize = 1 << 20;
const RESERVED_SHARE: usize = 8;
/// Semaphores count pixels in these, since a permit holds 32 bits.
const PIXEL_UNIT: u64 = 1024;

/// Gives room and takes it back. Clones share it.
#[derive(Clone, Debug)]
pub struct Admission {
    room: Room,
    images: Arc<Budget>,
    bytes: Arc<Budget>,
    pixels: Arc<Semaphore>,
    /// The part of them that pictures of answers may take: their readers may be slow, and others must go on.
    pictures: Arc<Semaphore>,
}

/// A counter that never passes its limit.
#[derive(Debug, Default)]
struct Budget {
    held: AtomicUsize,
}

impl Budget {
    fn take(&self, amount: usize, limit: usize) -> bool {
        let more = |held: usize| held.checked_add(amount).filter(|sum| *sum <= limit);
        self.held.fetch_update(Ordering::Relaxed, Ordering::Relaxed, more).is_ok()
    }

    fn give_back(&self, amount: usize) {
        self.held.fetch_sub(amount, Ordering::Relaxed);
    }

    fn held(&self) -> usize {
        self.held.load(Ordering::Relaxed)
    }
}

/// One image's place among those in work or waiting.
#[derive(Debug)]
pub struct Place(Arc<Budget>);

impl Drop for Place {
    fn drop(&mut self) {
        self.0.give_back(1);
    }
}

/// The bytes of one body. Decoding gives them back, unless somebody else holds them until the answer has left.
#[derive(Debug)]
pub struct BodyLease {
    admission: Admission,
    bytes: AtomicUsize,
}

/// The bytes of one image's pixels.
#[derive(Debug)]
pub struct PixelLease {
    pixels: OwnedSemaphorePermit,
    picture: Option<OwnedSemaphorePermit>,
}

impl Admission {
    #[must_use]
    pub fn new(room: Room) -> Self {
        let semaphore = |bytes: usize| {
            let units = usize::try_from((bytes as u64).div_ceil(PIXEL_UNIT)).unwrap_or(usize::MAX);
            Arc::new(Semaphore::new(units.clamp(1, Semaphore::MAX_PERMITS)))
        };
        let (pixels, pictures) = (semaphore(room.pixel_bytes), semaphore(room.picture_bytes()));
        Self { room, images: Arc::default(), bytes: Arc::default(), pixels, pictures }
    }

    #[must_use]
    pub fn room(&self) -> Room {
        self.room
    }

    /// Images in work or waiting.
    #[must_use]
    pub fn images(&self) -> usize {
        self.images.held()
    }

    /// Bytes of bodies that are held for somebody.
    #[must_use]
    pub fn bytes(&self) -> usize {
        self.bytes.held()
    }

    /// Whether an image that is still to come would find a place now.
    ///
    /// # Errors
    /// [`Refusal::Images`] where it would not.
    pub fn has_place(&self) -> Result<(), Refusal> {
        let limit = self.room.images;
        if self.images.held() < limit { Ok(()) } else { Err(Refusal::Images { limit }) }
    }

    /// A place for one image.
    ///
    /// # Errors
    /// [`Refusal::Images`] where all are taken.
    pub fn place(&self) -> Result<Place, Refusal> {
        let limit = self.room.images;
        let taken = self.images.take(1, limit);
        if taken { Ok(Place(Arc::clone(&self.images))) } else { Err(Refusal::Images { limit }) }
    }

    /// Room for a body of this many bytes.
    ///
    /// # Errors
    /// [`Refusal::Bytes`] where there is not so much.
    pub fn body(&self, bytes: usize) -> Result<BodyLease, Refusal> {
        let lease = self.empty_body();
        lease.grow_by(bytes)?;
        Ok(lease)
    }

    /// No room yet for a body that comes in parts: it grows.
    #[must_use]
    pub fn empty_body(&self) -> BodyLease {
        BodyLease { admission: self.clone(), bytes: AtomicUsize::new(0) }
    }

    /// Room for pixels, in the order in which it was asked for. More than all the room would never be free: ask before.
    pub async fn pixels(&self, bytes: u64, for_picture: bool) -> Option<PixelLease> {
        let units = u32::try_from(bytes.div_ceil(PIXEL_UNIT)).ok()?;
        // Closed never.
        let picture =
            if for_picture { Some(Arc::clone(&self.pictures).acquire_many_owned(units).await.ok()?) } else { None };
        let pixels = Arc::clone(&self.pixels).acquire_many_owned(units).await.ok()?;
        Some(PixelLease { pixels, picture })
    }
}

impl BodyLease {
    /// So many more bytes come.
    ///
    /// # Errors
    /// [`Refusal::Bytes`] where there is not so much room; what was held stays held.
    pub fn grow_by(&self, more: usize) -> Result<(), Refusal> {
        let limit = self.admission.room.bytes;
        let total = self.held().saturating_add(more);
        let reserved = if total > SMALL_BODY { limit / RESERVED_SHARE } else { 0 };
        if !self.admission.bytes.take(more, limit - reserved) {
            return Err(Refusal::Bytes { limit });
        }
        self.bytes.fetch_add(more, Ordering::Relaxed);
        Ok(())
    }

    /// At least so many bytes in all.
    ///
    /// # Errors
    /// As [`BodyLease::grow_by`].
    pub fn grow_to(&self, total: usize) -> Result<(), Refusal> {
        self.grow_by(total.saturating_sub(self.held()))
    }

    /// Takes so many bytes out, for a part of the body that is held longer or shorter than the rest.
    #[must_use]
    pub fn split(&self, bytes: usize) -> Self {
        let mut part = 0;
        let rest = |held: usize| {
            part = bytes.min(held);
            Some(held - part)
        };
        // Cannot fail: there is always a rest.
        let _ = self.bytes.fetch_update(Ordering::Relaxed, Ordering::Relaxed, rest);
        Self { admission: self.admission.clone(), bytes: AtomicUsize::new(part) }
    }

    fn held(&self) -> usize {
        self.bytes.load(Ordering::Relaxed)
    }
}

impl Drop for BodyLease {
    fn drop(&mut self) {
        self.admission.bytes.give_back(self.held());
    }
}

impl PixelLease {
    /// Gives back all but so many bytes.
    pub fn shrink_to(&mut self, bytes: u64) {
        let units = usize::try_from(bytes.div_ceil(PIXEL_UNIT)).unwrap_or(usize::MAX);
        for held in [Some(&mut self.pixels), self.picture.as_mut()].into_iter().flatten() {
            if let Some(rest) = held.num_permits().checked_sub(units).filter(|rest| *rest > 0) {
                drop(held.split(rest));
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use std::task::Poll;

    use super::*;

    const MIB: usize = 1 << 20;

    fn admission(images: usize, bytes: usize, pixel_bytes: usize) -> Admission {
        Admission::new(Room { images, bytes, pixel_bytes })
    }

    #[test]
    fn places_come_back() {
        let admission = admission(2, MIB, MIB);
        let places = [admission.place().unwrap(), admission.place().unwrap()];
        assert_eq!(admission.place().unwrap_err(), Refusal::Images { limit: 2 });
        assert!(admission.has_place().is_err());
        drop(places);
        assert!(admission.has_place().is_ok());
        assert_eq!(admission.images(), 0);
    }

    #[test]
    fn large_bodies_leave_the_last_eighth_to_small_ones() {
        let admission = admission(2, 64 * MIB, MIB);
        assert!(Room::least_bytes(8 * MIB) <= 64 * MIB);
        let large: Vec<_> = std::iter::from_fn(|| admission.body(8 * MIB).ok()).collect();
        assert_eq!(large.len(), 7);
        let small: Vec<_> = std::iter::from_fn(|| admission.body(MIB).ok()).collect();
        assert_eq!(small.len(), 8);
        drop((large, small));
        assert_eq!(admission.bytes(), 0);
    }

    #[test]
    fn the_largest_body_finds_room() {
        for body in [1, MIB, MIB + 1, 16 * MIB, 12_345_678] {
            let least = Room::least_bytes(body);
            assert!(admission(1, least, 1).body(body).is_ok(), "{body}");
        }
    }

    #[test]
    fn a_body_that_grows_is_held_to_the_same_limit() {
        let admission = admission(2, 16 * MIB, MIB);
        let growing = admission.body(0).unwrap();
        assert!(growing.grow_to(14 * MIB).is_ok());
        assert_eq!(growing.grow_to(15 * MIB), Err(Refusal::Bytes { limit: 16 * MIB }));
        let part = growing.split(4 * MIB);
        drop(growing);
        assert_eq!(admission.bytes(), 4 * MIB);
        drop(part);
        assert_eq!(admission.bytes(), 0);
    }

    /// However many pictures wait for their readers, a quarter is left to others.
    #[tokio::test]
    async fn pictures_leave_room_for_others() {
        let admission = admission(2, MIB, 8 * MIB);
        let picture = admission.pixels(6 * MIB as u64, true).await.unwrap();
        let mut other_picture = tokio_test::task::spawn(admission.pixels(MIB as u64, true));
        assert!(other_picture.poll().is_pending());
        let mut other = tokio_test::task::spawn(admission.pixels(2 * MIB as u64, false));
        assert!(other.poll().is_ready());
        drop(picture);
        assert!(other_picture.poll().is_ready());
    }

    #[tokio::test]
    async fn pixels_wait_for_room() {
        let admission = admission(2, MIB, 8 * MIB);
        let mut first = admission.pixels(6 * MIB as u64, false).await.unwrap();
        let mut waiting = tokio_test::task::spawn(admission.pixels(4 * MIB as u64, false));
        assert!(waiting.poll().is_pending());
        first.shrink_to(2 * MIB as u64);
        let Poll::Ready(second) = waiting.poll() else { panic!("there is room") };
        drop(first);
        let mut all = tokio_test::task::spawn(admission.pixels(8 * MIB as u64, false));
        assert!(all.poll().is_pending());
        drop(second);
        assert!(all.poll().is_ready());
    }
}
