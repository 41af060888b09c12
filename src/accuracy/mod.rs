//! How right the answer is: error bars, and the comparison with the referee.

pub mod comparison;
pub mod error_bars;
pub mod survey;
pub mod validation;
