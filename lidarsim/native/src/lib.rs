//! The core of lidarsim: exact ray casting and per-pulse measurement.

mod affine;
mod bind;
mod blocks;
mod bvh;
mod doubt;
mod elementary;
mod finish;
mod local;
mod measure;
mod memory;
mod number;
mod order;
mod pair;
mod parallel;
mod pose;
mod ray;
mod refine;
mod rng;
mod root;
mod scene;
mod search;
mod shapes;
mod simd;
mod simple;
#[cfg(test)]
mod testing;
mod trace;
mod traversal;
mod vector;

use pyo3::prelude::*;

#[pymodule]
fn _native(m: &Bound<'_, PyModule>) -> PyResult<()> {
    bind::register(m)
}
