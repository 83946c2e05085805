//! Arithmetic: numbers with error bounds, and the SIMD registers that hold several of them.

pub mod elementary;
pub mod error_free;
pub mod expansion;
pub mod number;
pub mod root;
pub mod simd;
pub mod turns;
