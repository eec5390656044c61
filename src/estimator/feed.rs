//! Images into a network, as its manifest states.

use half::f16;

use crate::model::{Channels, ElementType, Input, Layout, Network, Outputs, PixelFormat, RuntimeError};
use crate::vision::{Arrangement, arrange};

/// Runs a network on a batch of images of one size; `rgb` holds them one after another.
pub(super) fn run(
    network: &mut dyn Network,
    format: &PixelFormat,
    rgb: &[u8],
    [width, height]: [usize; 2],
) -> Result<Outputs, RuntimeError> {
    let pixels = width * height;
    let batch = rgb.len() / (3 * pixels);
    let to = Arrangement { planar: format.layout == Layout::Nchw, bgr: format.channels == Channels::Bgr };
    let shape = if to.planar { [batch, 3, height, width] } else { [batch, height, width, 3] };
    let (mean, std) = (format.mean.unwrap_or([0.0; 3]), format.std.unwrap_or([1.0; 3]));
    let scaled = [0, 1, 2].map(|channel| ((255.0 * std[channel]).recip(), mean[channel] / std[channel]));
    let normalised = |channel: usize, byte: u8| {
        let (scale, shift) = scaled[channel];
        f32::from(byte) * scale - shift
    };
    match format.dtype {
        ElementType::Uint8 if !to.planar && !to.bgr => network.run(Input::Bytes { shape, values: rgb }),
        ElementType::Uint8 => network.run(Input::Bytes { shape, values: &arrange(rgb, pixels, to, |_, byte| byte) }),
        ElementType::Float32 => network.run(Input::Floats { shape, values: &arrange(rgb, pixels, to, normalised) }),
        ElementType::Float16 => {
            let half = |channel, byte| f16::from_f32(normalised(channel, byte));
            network.run(Input::Halves { shape, values: &arrange(rgb, pixels, to, half) })
        }
    }
}
