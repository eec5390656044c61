use std::fmt;
use std::str::FromStr;

use serde::{Serialize, Serializer};

/// A range of visible fractions. Its upper end belongs to the next range, unless it is 1.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct VisibleRange {
    low: f64,
    high: f64,
}

impl VisibleRange {
    pub const ALL: Self = Self { low: 0.0, high: 1.0 };
    pub const MOSTLY_VISIBLE: Self = Self { low: 0.7, high: 1.0 };
    pub const HALF_HIDDEN: Self = Self { low: 0.3, high: 0.7 };

    #[must_use]
    pub fn contains(&self, visible_fraction: f64) -> bool {
        (self.low..self.high).contains(&visible_fraction) || (self.high >= 1.0 && visible_fraction >= self.high)
    }
}

impl FromStr for VisibleRange {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let number = |text: &str| text.trim().parse().ok().filter(|value| (0.0..=1.0).contains(value));
        let ends = text.split_once("..").and_then(|(low, high)| Some((number(low)?, number(high)?)));
        match ends {
            Some((low, high)) if low < high => Ok(Self { low, high }),
            _ => Err("must be LOW..HIGH with 0 <= LOW < HIGH <= 1, such as 0.3..0.7".into()),
        }
    }
}

impl fmt::Display for VisibleRange {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(formatter, "{}..{}", self.low, self.high)
    }
}

impl Serialize for VisibleRange {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        serializer.collect_str(self)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn neighbouring_ranges_share_nothing_and_leave_nothing_out() {
        let [hidden, seen]: [VisibleRange; 2] = ["0.3..0.7", "0.7..1"].map(|text| text.parse().unwrap());
        for (fraction, expected) in
            [(0.29, (false, false)), (0.3, (true, false)), (0.7, (false, true)), (1.0, (false, true))]
        {
            assert_eq!((hidden.contains(fraction), seen.contains(fraction)), expected, "{fraction}");
        }
        assert_eq!(hidden.to_string(), "0.3..0.7");
    }

    #[test]
    fn what_is_no_range_is_refused() {
        for text in ["", "0.3", "0.7..0.3", "0.5..0.5", "-0.1..1", "0..1.5", "nan..1", "0..=1"] {
            assert!(text.parse::<VisibleRange>().is_err(), "{text}");
        }
    }
}
