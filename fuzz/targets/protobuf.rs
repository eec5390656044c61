//! Messages of the gRPC API.
#![no_main]

use libfuzzer_sys::fuzz_target;

fuzz_target!(|bytes: &[u8]| posed::server::fuzzing::protobuf_request(bytes));
