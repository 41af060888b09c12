//! Exact form factors.
