#![allow(clippy::cast_possible_truncation, reason = "small test images")]

use image::Rgb;
use proptest::prelude::*;

use super::*;

fn layout(text: &str) -> RawLayout {
    text.parse().unwrap()
}

fn raw(layout: RawLayout, data: Vec<u8>) -> Result<RawImage, RawError> {
    RawImage::new(layout, data.into())
}

/// Rows of pixels, each filled up to the step with what is no pixel.
fn padded(rows: impl IntoIterator<Item = Vec<u8>>, step: usize) -> Vec<u8> {
    rows.into_iter()
        .flat_map(|mut row| {
            row.resize(step, 171);
            row
        })
        .collect()
}

fn any_image() -> impl Strategy<Value = RgbImage> {
    (1_u32..20, 1_u32..20).prop_flat_map(|(width, height)| {
        let data = proptest::collection::vec(any::<u8>(), 3 * (width * height) as usize);
        data.prop_map(move |data| RgbImage::from_raw(width, height, data).unwrap())
    })
}

proptest! {
    #[test]
    fn orders_of_channels_and_paddings_give_the_same_pixels(image in any_image(), padding in 0_u32..9) {
        type Stored = fn(&Rgb<u8>) -> Vec<u8>;
        let encodings: [(RawEncoding, Stored); 4] = [
            (RawEncoding::Rgb8, |Rgb([r, g, b])| vec![*r, *g, *b]),
            (RawEncoding::Bgr8, |Rgb([r, g, b])| vec![*b, *g, *r]),
            (RawEncoding::Rgba8, |Rgb([r, g, b])| vec![*r, *g, *b, 9]),
            (RawEncoding::Bgra8, |Rgb([r, g, b])| vec![*b, *g, *r, 9]),
        ];
        for (encoding, stored) in encodings {
            let (width, height) = image.dimensions();
            let step = width * stored(&Rgb([0; 3])).len() as u32 + padding;
            let data = padded(image.rows().map(|row| row.flat_map(stored).collect()), step as usize);
            let raw = raw(RawLayout { encoding, width, height, step: Some(step) }, data).unwrap();
            prop_assert_eq!((raw.width(), raw.height()), image.dimensions());
            prop_assert_eq!(raw.to_rgb(), image.clone());
        }
    }
}

#[test]
fn grey_is_all_three_channels() {
    let image = raw(layout("mono8:2x2:3"), vec![1, 2, 99, 3, 4, 99]).unwrap().to_rgb();
    assert_eq!(image.into_raw(), [1, 1, 1, 2, 2, 2, 3, 3, 3, 4, 4, 4]);
}

#[test]
fn patterns_are_named_after_their_first_pixels() {
    // A sensor that sees 200 in red, 100 in green and 50 in blue.
    for (name, first_rows) in [
        ("bayer_rggb8", [[200, 100], [100, 50]]),
        ("bayer_bggr8", [[50, 100], [100, 200]]),
        ("bayer_gbrg8", [[100, 50], [200, 100]]),
        ("bayer_grbg8", [[100, 200], [50, 100]]),
    ] {
        let rows = (0..4).map(|y| (0..6).map(|x| first_rows[y % 2][x % 2]).collect());
        let image = raw(layout(&format!("{name}:6x4:9")), padded(rows, 9)).unwrap().to_rgb();
        assert!(image.pixels().all(|pixel| pixel.0 == [200, 100, 50]), "{name}: {image:?}");
    }
}

/// Y, U, V and the RGB that they are in BT.601's limited range.
const COLOURS: [([u8; 3], [u8; 3]); 5] = [
    ([81, 90, 240], [255, 0, 0]),
    ([145, 54, 34], [0, 255, 0]),
    ([41, 240, 110], [0, 0, 255]),
    ([16, 128, 128], [0, 0, 0]),
    ([235, 128, 128], [255, 255, 255]),
];

/// Each half of the image of another colour, so that neither planes nor rows may be confused.
#[test]
fn yuv_is_read_in_limited_range() {
    for (yuv, rgb) in COLOURS {
        for (other, other_rgb) in COLOURS {
            for step in [40, 43, 64] {
                let halves = |[y, u, v]: [u8; 3]| (vec![y; 40], [u, v].repeat(20));
                let (top, bottom) = (halves(yuv), halves(other));
                let luma = [vec![top.0; 4], vec![bottom.0; 4]].concat();
                let chroma = [vec![top.1; 2], vec![bottom.1; 2]].concat();
                let data = padded(luma.into_iter().chain(chroma), step);
                let nv12 = raw(layout(&format!("nv12:40x8:{step}")), data).unwrap().to_rgb();
                let row = |[y, u, v]: [u8; 3]| [y, u, y, v].repeat(10);
                let rows = [vec![row(yuv); 4], vec![row(other); 4]].concat();
                let data = padded(rows, 40 + step);
                let yuy2 = raw(layout(&format!("yuv422_yuy2:20x8:{}", 40 + step)), data).unwrap().to_rgb();
                for image in [nv12, yuy2] {
                    for (_, y, pixel) in image.enumerate_pixels() {
                        let wanted = if y < 4 { rgb } else { other_rgb };
                        let off = (0..3).map(|c| pixel[c].abs_diff(wanted[c])).max().unwrap();
                        assert!(off <= 2, "{yuv:?} over {other:?}, step {step}, row {y}: {pixel:?}");
                    }
                }
            }
        }
    }
}

/// The two luma values of a YUY2 cell are those of its pixels, from left to right.
#[test]
fn luma_keeps_its_order() {
    let yuy2 = raw(layout("yuv422_yuy2:2x1"), vec![16, 128, 235, 128]).unwrap().to_rgb();
    assert!(yuy2.get_pixel(0, 0)[1] < 3 && yuy2.get_pixel(1, 0)[1] > 252, "{yuy2:?}");
}

#[test]
fn a_layout_is_read() {
    let step = Some(3848);
    assert_eq!(layout("bgr8:1280x720:3848"), RawLayout { encoding: RawEncoding::Bgr8, width: 1280, height: 720, step });
    for encoding in RawEncoding::ALL {
        assert_eq!(layout(&format!("{encoding}:64x48")), RawLayout { encoding, width: 64, height: 48, step: None });
    }
    for text in
        ["", "bgr8", "bgr8:64", "bgr8:64x", "bgr8:64x48:", "bgr8:64x48:192:1", "bgr8:-64x48", "bgr8:64x5000000000"]
    {
        assert_eq!(text.parse::<RawLayout>(), Err(RawError::Layout(text.to_owned())));
    }
    let unknown = "yuv420:64x48".parse::<RawLayout>().unwrap_err().to_string();
    assert!(unknown.contains("\"yuv420\"") && unknown.contains("bayer_rggb8") && unknown.contains("nv12"), "{unknown}");
}

#[test]
fn what_does_not_fit_is_refused_by_name() {
    let refused = |text: &str, length: usize| raw(layout(text), vec![0; length]).unwrap_err();
    assert_eq!(refused("rgb8:0x4", 0), RawError::Empty { width: 0, height: 4 });
    assert_eq!(refused("rgb8:4x0", 0), RawError::Empty { width: 4, height: 0 });
    for (text, length) in
        [("nv12:5x4", 30), ("nv12:4x5", 30), ("yuv422_yuy2:5x4", 40), ("bayer_rggb8:5x4", 20), ("bayer_grbg8:4x1", 4)]
    {
        assert!(matches!(refused(text, length), RawError::Odd { .. }), "{text}");
    }
    for text in ["rgb8:4x4:11", "rgba8:4x4:15", "mono8:4x4:3", "nv12:4x4:3", "yuv422_yuy2:4x4:7", "bayer_bggr8:4x4:3"] {
        let said = refused(text, 64).to_string();
        assert!(said.contains("'step'"), "{said}");
    }
    for (text, right) in
        [("rgb8:4x3", 36), ("rgb8:4x3:14", 42), ("nv12:4x4", 24), ("nv12:4x4:7", 42), ("yuv422_yuy2:4x3", 24)]
    {
        assert!(raw(layout(text), vec![0; right]).is_ok(), "{text}");
        for length in [0, right - 1, right + 1] {
            let said = refused(text, length).to_string();
            assert!(said.contains(&format!("has {length} bytes")) && said.contains(&right.to_string()), "{said}");
        }
    }
}

/// Products of sizes that no type holds are refused like others.
#[test]
fn enormous_sizes_are_refused() {
    for text in ["rgba8:4294967295x4294967295", "nv12:4294967294x4294967294", "mono8:1x4294967295:4294967295"] {
        assert!(raw(layout(text), vec![0; 4]).is_err(), "{text}");
    }
}
