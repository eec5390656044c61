//! The gRPC messages, server and client, generated from `proto/posed/v1/pose.proto`.
#![allow(clippy::all, clippy::pedantic, missing_docs, unreachable_pub, reason = "generated code")]

mod codec;

pub use codec::BoundedCodec;

tonic::include_proto!("posed.v1");

/// The protocol itself, encoded: for reflection.
pub const FILE_DESCRIPTOR_SET: &[u8] = tonic::include_file_descriptor_set!("descriptor");
