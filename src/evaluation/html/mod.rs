//! A report to look at: one file with plots and pictures, which loads nothing from elsewhere.

mod chart;
mod page;
mod picture;
mod plots;
mod references;

pub use page::page;
pub use picture::{Outline, Picture, Sheet, close_up};
pub use references::{ReferencesCurve, Spread, references_plot};
