use std::fmt;

/// How the pixels of a raw image lie in memory, by its name in ROS (`sensor_msgs/image_encodings`).
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum RawEncoding {
    Rgb8,
    Bgr8,
    Rgba8,
    Bgra8,
    Mono8,
    BayerRggb8,
    BayerBggr8,
    BayerGbrg8,
    BayerGrbg8,
    /// A plane of luma, then one of interleaved chroma for 2x2 pixels each.
    Nv12,
    /// Y U Y V for two pixels: YUYV.
    Yuv422Yuy2,
}

impl RawEncoding {
    pub const ALL: [Self; 11] = [
        Self::Rgb8,
        Self::Bgr8,
        Self::Rgba8,
        Self::Bgra8,
        Self::Mono8,
        Self::BayerRggb8,
        Self::BayerBggr8,
        Self::BayerGbrg8,
        Self::BayerGrbg8,
        Self::Nv12,
        Self::Yuv422Yuy2,
    ];

    /// Its name in ROS.
    #[must_use]
    pub const fn name(self) -> &'static str {
        match self {
            Self::Rgb8 => "rgb8",
            Self::Bgr8 => "bgr8",
            Self::Rgba8 => "rgba8",
            Self::Bgra8 => "bgra8",
            Self::Mono8 => "mono8",
            Self::BayerRggb8 => "bayer_rggb8",
            Self::BayerBggr8 => "bayer_bggr8",
            Self::BayerGbrg8 => "bayer_gbrg8",
            Self::BayerGrbg8 => "bayer_grbg8",
            Self::Nv12 => "nv12",
            Self::Yuv422Yuy2 => "yuv422_yuy2",
        }
    }

    /// Bytes of a pixel in its row; of NV12, in a row of luma.
    pub(super) const fn bytes_per_pixel(self) -> u32 {
        match self {
            Self::Rgb8 | Self::Bgr8 => 3,
            Self::Rgba8 | Self::Bgra8 => 4,
            Self::Yuv422Yuy2 => 2,
            Self::Mono8 | Self::BayerRggb8 | Self::BayerBggr8 | Self::BayerGbrg8 | Self::BayerGrbg8 | Self::Nv12 => 1,
        }
    }

    /// Width and height of the pixels that share their colours: the sides of an image are multiples of these.
    pub(super) const fn cell(self) -> (u32, u32) {
        match self {
            Self::Rgb8 | Self::Bgr8 | Self::Rgba8 | Self::Bgra8 | Self::Mono8 => (1, 1),
            Self::Yuv422Yuy2 => (2, 1),
            Self::BayerRggb8 | Self::BayerBggr8 | Self::BayerGbrg8 | Self::BayerGrbg8 | Self::Nv12 => (2, 2),
        }
    }
}

impl fmt::Display for RawEncoding {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        formatter.pad(self.name())
    }
}
