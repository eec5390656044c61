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

/// What is wrong with entropy-coded data: a byte, for it is asked after every code.
#[derive(Clone, Copy, Debug)]
pub(super) enum Lost {
    /// The file ends.
    FileEnds,
    DataEnd,
    Code,
    Range,
    Block,
}

impl From<Lost> for Fault {
    fn from(lost: Lost) -> Self {
        match lost {
            Lost::FileEnds => Self::Ends,
            Lost::DataEnd => "its data end early: some bytes were lost or changed".into(),
            Lost::Code => "its data hold a code that does not exist: some bytes were lost or changed".into(),
            Lost::Range => "a value is beyond its range: some bytes were lost or changed".into(),
            Lost::Block => "a block has too many values: some bytes were lost or changed".into(),
        }
    }
}
