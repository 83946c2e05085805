//! What Python sees of the core. No Python type goes past these files.

mod scan;
mod scene;
mod shape;

use std::ops::Range;

use lidarsim_core::{Level, Point, slices};
use numpy::{PyReadonlyArray2, PyUntypedArrayMethods};
use pyo3::exceptions::PyValueError;
use pyo3::prelude::*;

pub use scene::PyScene;
pub use shape::PyShape;

pub type Points<'py> = PyReadonlyArray2<'py, f64>;

#[pymodule]
fn _native(m: &Bound<'_, PyModule>) -> PyResult<()> {
    m.add_class::<PyShape>()?;
    m.add_class::<PyScene>()?;
    m.add_class::<scan::PyPath>()?;
    m.add_class::<scene::PyAppearance>()?;
    m.add_function(wrap_pyfunction!(scan::scan, m)?)?;
    m.add_function(wrap_pyfunction!(scan::points_of, m)?)?;
    m.add_function(wrap_pyfunction!(scan::philox, m)?)?;
    m.add_function(wrap_pyfunction!(scan::normal_quantile, m)?)?;
    m.add_function(wrap_pyfunction!(shape::self_crossing, m)?)?;
    m.add_function(wrap_pyfunction!(threads, m)?)?;
    m.add_function(wrap_pyfunction!(isa, m)?)?;
    Ok(())
}

/// The number of threads that casts run on.
#[pyfunction]
fn threads() -> usize {
    lidarsim_core::threads()
}

/// The instruction set that casts use: scalar, avx2 or avx512.
#[pyfunction]
fn isa() -> PyResult<&'static str> {
    level().map(Level::name)
}

/// The instruction set that was asked for, or the best.
pub fn level() -> PyResult<Level> {
    Level::asked().map_err(PyValueError::new_err)
}

/// The rows of a C-contiguous (n, 3) array.
pub fn points<'a>(name: &str, array: &'a Points<'_>) -> PyResult<&'a [Point]> {
    let wrong = || {
        PyValueError::new_err(format!("{name}: expected a C-contiguous array of shape (n, 3), got {:?}", array.shape()))
    };
    let flat = array.as_slice().map_err(|_| wrong())?;
    if array.shape()[1] == 3 { Ok(flat.as_chunks().0) } else { Err(wrong()) }
}

/// The rays of two arrays, legal ones.
pub fn rays<'a>(origins: &'a Points<'_>, directions: &'a Points<'_>) -> PyResult<(&'a [Point], &'a [Point])> {
    let (o, d) = equal_points(origins, directions)?;
    legal_rays(o, d)?;
    Ok((o, d))
}

/// The rays of two arrays of equal length.
pub fn equal_points<'a>(origins: &'a Points<'_>, directions: &'a Points<'_>) -> PyResult<(&'a [Point], &'a [Point])> {
    let (o, d) = (points("origins", origins)?, points("directions", directions)?);
    if o.len() == d.len() {
        return Ok((o, d));
    }
    let message = "origins, directions: expected arrays of equal length, got";
    Err(PyValueError::new_err(format!("{message} {} and {}", o.len(), d.len())))
}

/// Names the first ray that is not finite or has a zero direction.
pub fn legal_rays(o: &[Point], d: &[Point]) -> PyResult<()> {
    for (name, vectors) in [("origins", o), ("directions", d)] {
        if let Some(i) = vectors.iter().position(|v| !v.iter().all(|x| x.is_finite())) {
            let j = vectors[i].iter().position(|x| !x.is_finite()).unwrap_or(0);
            return Err(PyValueError::new_err(format!(
                "{name}: expected finite numbers, got {name}[{i}][{j}] = {}",
                python_float(vectors[i][j])
            )));
        }
    }
    match d.iter().position(|v| *v == [0.0; 3]) {
        None => Ok(()),
        Some(i) => Err(PyValueError::new_err(format!(
            "directions: expected non-zero vectors, got directions[{i}] = (0, 0, 0)"
        ))),
    }
}

fn python_float(x: f64) -> String {
    if x.is_nan() { "nan".into() } else { x.to_string() }
}

/// Runs `work` over slices of `n` rays without the interpreter lock, and checks for signals between them.
pub fn interruptible(py: Python<'_>, n: usize, mut work: impl FnMut(Range<usize>) + Send) -> PyResult<()> {
    for slice in slices(n, 1) {
        py.detach(|| work(slice));
        py.check_signals()?;
    }
    Ok(())
}
