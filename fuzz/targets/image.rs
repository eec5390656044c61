//! JPEG, PNG and WebP files: whatever comes, an image of the size that the header told, or an error.
#![no_main]

use libfuzzer_sys::fuzz_target;
use posed::vision::{DecodeOptions, Image, OrientationPolicy, decode, header};

fuzz_target!(|bytes: &[u8]| {
    let options =
        DecodeOptions { max_side_px: 512, max_pixels: 1 << 17, exif_orientation: OrientationPolicy::Ignore };
    let image = Image::Encoded(bytes.to_vec().into());
    if let Ok(decoded) = decode(&image, &options) {
        let header = header(&image, &options).expect("what is decoded has a header");
        assert_eq!(decoded.image.dimensions(), (header.width, header.height));
    }
});
