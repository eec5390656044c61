//! The part `request` of forms.
#![no_main]

use libfuzzer_sys::fuzz_target;

fuzz_target!(|bytes: &[u8]| posed::server::fuzzing::json_request(bytes));
