//! From bytes to pixels: a few images at a time, each once there is room for what its header claims.

use std::sync::Arc;
use std::time::{Duration, Instant};

use image::RgbImage;
use thiserror::Error;
use tokio::sync::Semaphore;

use super::admission::{Admission, BodyLease, PixelLease};
use crate::vision::{DecodeError, DecodeOptions, Decoded, Exif, Image, decode, header};

/// An image that cannot be worked on.
#[derive(Debug, Error)]
pub(super) enum PrepareError {
    #[error(transparent)]
    Decode(#[from] DecodeError),
    #[error("needs more memory than all images together may use")]
    TooCostly { bytes: u64, limit: usize },
    #[error("decoding panicked")]
    Crashed,
}

/// A decoded image, and the room that it takes.
#[derive(Debug)]
pub(super) struct Pixels {
    pub image: RgbImage,
    pub exif: Exif,
    pub room: PixelLease,
    /// From the image's arrival until its decoding began.
    pub queued: Duration,
    pub decode: Duration,
}

/// What an image needs room for, whose picture is drawn and encoded after it was answered: it, what the encoder buffers, and
/// the file, which may be larger than its pixels.
const KEPT_IMAGES: u64 = 4;

/// The pool that decodes. Its threads are the async runtime's for blocking work.
#[derive(Clone, Debug)]
pub(super) struct Decoders {
    admission: Admission,
    free: Arc<Semaphore>,
    options: DecodeOptions,
}

impl Decoders {
    pub(super) fn new(admission: Admission, threads: usize, options: DecodeOptions) -> Self {
        Self { admission, free: Arc::new(Semaphore::new(threads)), options }
    }

    /// Decodes one image, in its turn. Dropping the future takes the image out, but for a decoder that has begun.
    ///
    /// `body` is the room of the image's bytes, let go once they are decoded.
    pub(super) async fn decode(
        &self,
        image: Image,
        body: Arc<BodyLease>,
        keep_image: bool,
        arrived: Instant,
    ) -> Result<Pixels, PrepareError> {
        let options = self.options;
        let (image, header) = self.run(move || header(&image, &options).map(|header| (image, header))).await??;
        let kept = header.rgb_bytes * if keep_image { KEPT_IMAGES } else { 1 };
        let room = self.admission.room();
        let limit = if keep_image { room.picture_bytes() } else { room.pixel_bytes };
        let bytes = header.decode_bytes.max(kept);
        if bytes > limit as u64 {
            return Err(PrepareError::TooCostly { bytes, limit });
        }
        let room = self.admission.pixels(bytes, keep_image).await.ok_or(PrepareError::Crashed)?;
        let decoded = self.run(move || {
            let start = Instant::now();
            let decoded = decode(&image, &options);
            drop((image, body));
            // The room goes with the pixels, also where the caller has left meanwhile.
            decoded.map(|decoded| (decoded, room, start))
        });
        let (Decoded { image, exif }, mut room, start) = decoded.await??;
        room.shrink_to(kept);
        Ok(Pixels { image, exif, room, queued: start - arrived, decode: start.elapsed() })
    }

    /// Decoders are fed by strangers: a panic is one image's.
    async fn run<T: Send + 'static>(&self, decode: impl FnOnce() -> T + Send + 'static) -> Result<T, PrepareError> {
        let turn = Arc::clone(&self.free).acquire_owned().await.map_err(|_| PrepareError::Crashed)?;
        let done = tokio::task::spawn_blocking(move || {
            let _turn = turn;
            decode()
        });
        done.await.map_err(|error| {
            tracing::error!(%error, "decoding an image panicked: it gets an error");
            PrepareError::Crashed
        })
    }
}
