//! The gRPC front end.

mod admit;
mod answer;
mod call;
mod calls;
mod failure;
mod route;
mod routes;
mod stream;
mod timeout;
mod until;
mod upload;

pub(super) use routes::FRONT_END;
