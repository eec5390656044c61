#![doc = include_str!("../README.md")]
#![forbid(unsafe_code)]
#![warn(missing_docs)]

pub mod calibration;
pub mod geometry;
pub mod pnp;
pub mod tracking;
pub mod views;

pub use nalgebra;
