//! Arithmetic: numbers that know how far they may be wrong, side by side in the registers of the processor.

pub mod elementary;
pub mod expansion;
pub mod number;
pub mod root;
pub mod simd;
