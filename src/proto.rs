//! The gRPC messages, server and client, generated from `proto/posed/v1/pose.proto`.
#![allow(clippy::all, clippy::pedantic, missing_docs, unreachable_pub, reason = "generated code")]

tonic::include_proto!("posed.v1");
