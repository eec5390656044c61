//! The page, in a real browser, with the real server and the shipped models. It needs Debian's `chromium` and
//! `chromium-driver` (`scripts/install-chromium.sh`) and axe-core (`scripts/fetch-axe.sh`); `make test` sees to both.
#![allow(clippy::unwrap_used, clippy::panic, reason = "a test fails by panicking")]

mod accessible;
mod browser;
mod clicks;
mod files;
mod geometry;
mod live;
mod pictures;
#[path = "../support/mod.rs"]
mod support;
mod token;
mod tries;
mod video;
