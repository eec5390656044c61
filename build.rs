//! Compiles the protocol with a pure Rust compiler, so that no `protoc` is needed.

use std::path::PathBuf;

use protox::prost::Message as _;

fn main() -> Result<(), Box<dyn std::error::Error>> {
    println!("cargo:rerun-if-changed=proto");
    let files = protox::compile(["posed/v1/pose.proto"], ["proto"])?;
    // For reflection: clients ask the server for the protocol.
    let descriptor = PathBuf::from(std::env::var("OUT_DIR")?).join("descriptor.bin");
    std::fs::write(descriptor, files.encode_to_vec())?;
    // Images are not copied out of their messages.
    tonic_prost_build::configure().bytes(".").codec_path("crate::proto::BoundedCodec").compile_fds(files)?;
    Ok(())
}
