//! Form factors.
pub mod exact;
