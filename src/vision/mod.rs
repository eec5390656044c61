//! From encoded bytes to network inputs, and from answers to pictures. Knows neither models nor servers.

mod decode;
mod overlay;
mod resample;

pub use decode::{DecodeError, ImageLimits, decode};
pub use overlay::{Mark, draw_marks, encode_png};
pub use resample::{BoundingBox, ResampleError, Resampled, crop_square, letterbox};
