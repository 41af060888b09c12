//! Accuracy of solutions: error bars, estimates of other errors, and comparison with path and light tracing.

pub mod adaptive;
pub mod bias;
pub mod comparison;
pub mod discretisation;
pub mod error_bars;
pub mod lambert;
pub mod memory;
pub mod patch_search;
pub mod refinement;
pub mod regions;
pub mod solved;
pub mod survey;
pub mod tradeoff;
pub mod validation;
