//! The gRPC front end.

mod answer;
mod calls;
mod failure;
mod routes;
mod stream;
mod timeout;
mod upload;

pub(super) use routes::FRONT_END;
