//! Forms of images and a part `request`.
#![no_main]

use libfuzzer_sys::fuzz_target;

fuzz_target!(|bytes: &[u8]| posed::server::fuzzing::form(bytes));
