//! The HTTP front end.

mod batch;
mod failure;
mod form;
mod info;
mod objects;
mod observe;
mod page;
mod path;
mod picture;
mod poses;
mod query;
mod reference;
mod routes;
mod timeout;
mod upload;
mod views;

#[cfg(fuzzing)]
pub(super) use form::fuzz_form;
pub(super) use routes::FRONT_END;
pub use routes::openapi;
