//! What Python sees of the core. No Python type goes past these files.

mod scene;
mod shape;

use numpy::{PyReadonlyArray2, PyUntypedArrayMethods};
use pyo3::exceptions::PyValueError;
use pyo3::prelude::*;

use crate::parallel;
use crate::simd::Level;
use crate::vector::Point;

pub use scene::PyScene;
pub use shape::PyShape;

pub type Points<'py> = PyReadonlyArray2<'py, f64>;

/// Rays a thread takes at a time: enough that neighbours can be sorted together, few enough that all threads stay busy.
pub fn chunk(rays: usize) -> usize {
    rays.div_ceil(4 * parallel::threads()).clamp(1 << 10, 1 << 15)
}

/// Rays between two looks at pending signals, so that Ctrl-C ends a long cast.
const SLICE: usize = 1 << 18;

pub fn register(m: &Bound<'_, PyModule>) -> PyResult<()> {
    m.add_class::<PyShape>()?;
    m.add_class::<PyScene>()?;
    m.add_function(wrap_pyfunction!(shape::self_crossing, m)?)?;
    m.add_function(wrap_pyfunction!(threads, m)?)?;
    m.add_function(wrap_pyfunction!(isa, m)?)?;
    Ok(())
}

/// The number of threads that casts run on.
#[pyfunction]
fn threads() -> usize {
    parallel::threads()
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

/// The rays of two arrays of equal length; names the first that is not finite or has a zero direction.
pub fn rays<'a>(origins: &'a Points<'_>, directions: &'a Points<'_>) -> PyResult<(&'a [Point], &'a [Point])> {
    let (o, d) = (points("origins", origins)?, points("directions", directions)?);
    if o.len() != d.len() {
        return Err(PyValueError::new_err(format!(
            "origins, directions: expected arrays of equal length, got {} and {}",
            o.len(),
            d.len()
        )));
    }
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
        None => Ok((o, d)),
        Some(i) => Err(PyValueError::new_err(format!(
            "directions: expected non-zero vectors, got directions[{i}] = (0, 0, 0)"
        ))),
    }
}

fn python_float(x: f64) -> String {
    if x.is_nan() { "nan".into() } else { x.to_string() }
}

/// Runs `work` over slices of 0..n without the interpreter lock, and looks for Ctrl-C between them.
pub fn interruptible(py: Python<'_>, n: usize, mut work: impl FnMut(std::ops::Range<usize>) + Send) -> PyResult<()> {
    for start in (0..n).step_by(SLICE) {
        py.detach(|| work(start..n.min(start + SLICE)));
        py.check_signals()?;
    }
    Ok(())
}
