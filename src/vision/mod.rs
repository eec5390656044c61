//! From encoded bytes to network inputs, and from answers to pictures. Knows neither models nor servers.

mod crop;
mod decode;
mod heatmap;
mod overlay;
mod region;
mod resample;
mod tensor;

pub use crop::crop_squares;
pub use decode::{DecodeError, DecodeOptions, Decoded, Exif, OrientationPolicy, decode};
pub use heatmap::{Peak, find_peak};
pub use overlay::{Mark, PoseMark, draw_marks, encode};
pub use region::{BoundingBox, Square};
pub use resample::{Letterbox, ResampleError, Resampled, letterbox};
pub use tensor::to_planes;
