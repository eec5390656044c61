use std::borrow::Cow;

/// Why a JPEG is not whole.
#[derive(Debug)]
pub(in crate::vision) enum Fault {
    /// The file ends where more must follow.
    Ends,
    /// In words that follow "the image is damaged: ".
    Damaged(Cow<'static, str>),
}

impl From<&'static str> for Fault {
    fn from(words: &'static str) -> Self {
        Self::Damaged(words.into())
    }
}

impl From<String> for Fault {
    fn from(words: String) -> Self {
        Self::Damaged(words.into())
    }
}

pub(super) const SHORT: Fault = Fault::Damaged(Cow::Borrowed("one of its segments is too short"));
