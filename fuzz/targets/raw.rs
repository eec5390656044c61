//! Raw frames: a layout in text, a line feed, pixels.
#![no_main]

use libfuzzer_sys::fuzz_target;
use posed::vision::{DecodeOptions, Image, RawImage, RawLayout, decode};

fuzz_target!(|bytes: &[u8]| {
    let Some(end) = bytes.iter().position(|byte| *byte == b'\n') else { return };
    let (layout, pixels) = (&bytes[..end], &bytes[end + 1..]);
    let Some(layout) = std::str::from_utf8(layout).ok().and_then(|text| text.parse::<RawLayout>().ok()) else { return };
    if let Ok(raw) = RawImage::new(layout, pixels.to_vec().into()) {
        let _ = decode(&Image::Raw(raw), &DecodeOptions::default());
    }
});
