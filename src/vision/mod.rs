//! From encoded bytes or raw pixels to network inputs, and from answers to pictures. Knows neither models nor servers.

mod crop;
mod decode;
mod disk;
mod error;
mod header;
mod heatmap;
mod jpeg;
mod options;
mod overlay;
mod raw;
mod region;
mod resample;
mod source;
mod tensor;

pub use crop::{MAX_CANVAS_BYTES, crop_squares};
pub use decode::{Decoded, Exif, decode};
pub use disk::{FileError, read_image};
pub use error::DecodeError;
pub use header::{Header, header};
pub use heatmap::{Peak, find_peak};
pub use options::{DecodeOptions, OrientationPolicy};
pub use overlay::{AXIS_COLOURS, Mark, PoseMark, box_corners, box_edges, draw_marks, encode, status_colour};
pub use raw::{RawEncoding, RawError, RawImage, RawLayout};
pub use region::{BoundingBox, Square};
pub use resample::{Fit, Letterbox, ResampleError, Resampled, letterbox};
pub use source::Image;
pub use tensor::{Arrangement, arrange};
