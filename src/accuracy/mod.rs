//! How right the answer is: error bars, and the comparison with the referee.

pub mod error_bars;
