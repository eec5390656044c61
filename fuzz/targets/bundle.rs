//! Bundles of objects, as clients upload them.
#![no_main]

use libfuzzer_sys::fuzz_target;
use posed::model::unpack;

/// Disks are not what is tried here.
const LIMIT: u64 = 1 << 20;

fuzz_target!(|bytes: &[u8]| {
    let outer = tempfile::tempdir().expect("a temporary folder");
    let folder = outer.path().join("object");
    std::fs::create_dir(&folder).expect("a temporary folder");
    let _ = unpack(bytes, &folder, LIMIT);
    // Nothing of it lies elsewhere.
    assert_eq!(std::fs::read_dir(outer.path()).expect("the folder").count(), 1);
});
