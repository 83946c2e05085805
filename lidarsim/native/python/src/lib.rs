//! The interface of the core to Python. No Python type leaves these files.

mod affine;
mod cloud;
mod coverage;
mod many;
mod object;
mod path;
mod patterns;
mod plain;
mod scan;
mod scene;
mod shape;
mod texture;
mod waveforms;

use std::any::Any;
use std::env;
use std::num::NonZero;
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::sync::atomic::{AtomicUsize, Ordering};

use lidarsim_core::memory::OutOfMemory;
use lidarsim_core::stop::{self, Stopped};
use lidarsim_core::{Kernels, Level, Point, with_room};
use numpy::ndarray::{ArrayD, ArrayView, Dimension};
use numpy::{
    Element, IntoPyArray, PyArray, PyArrayMethods, PyReadonlyArray, PyReadonlyArray2, PyUntypedArrayMethods,
};
use pyo3::PyClass;
use pyo3::exceptions::{PyKeyboardInterrupt, PyMemoryError, PyRuntimeError, PyValueError};
use pyo3::prelude::*;
use pyo3::pyclass::boolean_struct::True;

pub use affine::PyAffine;
pub use object::PySceneObject;
pub use path::PyPath;
pub use scene::PyScene;
pub use shape::PyShape;
pub use texture::{PyTexture, PyTextureMap};

pub type Points<'py> = PyReadonlyArray2<'py, f64>;

#[pymodule]
fn _native(m: &Bound<'_, PyModule>) -> PyResult<()> {
    m.add("__version__", env!("CARGO_PKG_VERSION"))?;
    m.add_class::<PyShape>()?;
    m.add_class::<PyAffine>()?;
    m.add_class::<PySceneObject>()?;
    m.add_class::<PyScene>()?;
    m.add_class::<PyPath>()?;
    m.add_class::<PyTexture>()?;
    m.add_class::<PyTextureMap>()?;
    m.add_function(wrap_pyfunction!(scan::scan, m)?)?;
    m.add_class::<scan::PyReceiver>()?;
    m.add_function(wrap_pyfunction!(many::scan_many, m)?)?;
    m.add_function(wrap_pyfunction!(many::first_not_rigid, m)?)?;
    m.add_function(wrap_pyfunction!(many::is_plain_pose, m)?)?;
    m.add_function(wrap_pyfunction!(scan::expect_room, m)?)?;
    m.add_function(wrap_pyfunction!(scan::air_echoes, m)?)?;
    m.add_function(wrap_pyfunction!(scan::scan_columns, m)?)?;
    m.add_function(wrap_pyfunction!(cloud::points_of, m)?)?;
    m.add_function(wrap_pyfunction!(coverage::coverage, m)?)?;
    m.add_function(wrap_pyfunction!(waveforms::waveforms, m)?)?;
    m.add_function(wrap_pyfunction!(scan::philox, m)?)?;
    m.add_function(wrap_pyfunction!(scan::normal_quantile, m)?)?;
    m.add_function(wrap_pyfunction!(shape::self_crossing, m)?)?;
    m.add_function(wrap_pyfunction!(object::place, m)?)?;
    m.add_class::<patterns::PyChannels>()?;
    m.add_function(wrap_pyfunction!(patterns::fire_mid360, m)?)?;
    m.add_function(wrap_pyfunction!(patterns::fire_oscillating_mirror, m)?)?;
    m.add_function(wrap_pyfunction!(patterns::fire_palmer, m)?)?;
    m.add_function(wrap_pyfunction!(patterns::fire_polar, m)?)?;
    m.add_function(wrap_pyfunction!(patterns::fire_risley, m)?)?;
    m.add_function(wrap_pyfunction!(plain::are_plain_points, m)?)?;
    m.add_function(wrap_pyfunction!(plain::plain_matrix, m)?)?;
    m.add_function(wrap_pyfunction!(plain::plain_vector, m)?)?;
    m.add_function(wrap_pyfunction!(threads, m)?)?;
    m.add_function(wrap_pyfunction!(set_threads, m)?)?;
    m.add_function(wrap_pyfunction!(isa, m)?)?;
    Ok(())
}

/// The number of threads that casts run on.
#[pyfunction]
fn threads(py: Python<'_>) -> PyResult<usize> {
    use_threads(py)?;
    Ok(lidarsim_core::threads())
}

/// Sets the number of threads in place of `LIDARSIM_THREADS`; `None` follows that again.
#[pyfunction]
fn set_threads(count: Option<NonZero<usize>>) {
    THREADS.store(count.map_or(0, NonZero::get), Ordering::Relaxed);
}

/// The instruction set that casts use: scalar, avx2 or avx512.
#[pyfunction]
fn isa(py: Python<'_>) -> PyResult<&'static str> {
    level(py).map(Level::name)
}

/// The instruction set that `LIDARSIM_ISA` requests, or the best.
///
/// Only this function and [`requested_threads`] read the environment, with the interpreter lock held, as
/// Python writes it with the lock.
fn level(_: Python<'_>) -> PyResult<Level> {
    let Some(name) = env::var_os("LIDARSIM_ISA") else { return Ok(Level::best()) };
    let name = name.to_string_lossy();
    match Level::from_name(&name) {
        Some(level) if level <= Level::best() => Ok(level),
        Some(_) => Err(PyValueError::new_err(format!("LIDARSIM_ISA: this machine has no {name}"))),
        None => Err(argument_error("LIDARSIM_ISA", "scalar, avx2 or avx512", format!("{name:?}"))),
    }
}

/// The kernels for the instruction set of `level`.
pub fn kernels(py: Python<'_>) -> PyResult<&'static dyn Kernels> {
    Ok(match level(py)? {
        #[cfg(target_arch = "x86_64")]
        Level::Avx2 => lidarsim_avx2::KERNELS,
        #[cfg(target_arch = "x86_64")]
        Level::Avx512 => lidarsim_avx512::KERNELS,
        _ => lidarsim_portable::KERNELS,
    })
}

/// The number of threads that this process has set; 0 for that of `LIDARSIM_THREADS`.
static THREADS: AtomicUsize = AtomicUsize::new(0);

/// Greatest `LIDARSIM_THREADS`; a cast with thousands of threads only starts and ends them.
const MOST_THREADS: usize = 1024;

/// Applies the number of threads that is set, else `LIDARSIM_THREADS`, unless that is empty.
fn use_threads(_: Python<'_>) -> PyResult<()> {
    let asked = match THREADS.load(Ordering::Relaxed) {
        0 => requested_threads()?,
        set => Some(set),
    };
    lidarsim_core::use_threads(asked);
    Ok(())
}

/// The number of threads that `LIDARSIM_THREADS` requests, if any.
fn requested_threads() -> PyResult<Option<usize>> {
    let Some(text) = env::var_os("LIDARSIM_THREADS").filter(|text| !text.is_empty()) else { return Ok(None) };
    let text = text.to_string_lossy();
    match text.parse() {
        Ok(count @ 1..=MOST_THREADS) => Ok(Some(count)),
        _ => Err(argument_error(
            "LIDARSIM_THREADS",
            &format!("an integer from 1 to {MOST_THREADS}"),
            format!("{text:?}"),
        )),
    }
}

/// Runs work of the core, and every such call goes through here, with the interpreter lock released.
///
/// # Errors
///
/// The error that a signal handler raises, such as `KeyboardInterrupt`, which stops the work. MemoryError if
/// an array cannot be allocated. RuntimeError if the work panics, which is a bug in the core.
pub fn detach<R: Send>(py: Python<'_>, work: impl FnOnce() -> R + Send) -> PyResult<R> {
    let (mut work, mut outcome) = (Some(work), None);
    run_detached(py, &mut || outcome = work.take().map(|work| work()))?;
    outcome.ok_or_else(|| take_error(py))
}

/// [`detach`], compiled once for all kinds of work.
fn run_detached(py: Python<'_>, work: &mut (dyn FnMut() + Send)) -> PyResult<()> {
    use_threads(py)?;
    match py.detach(|| catch_unwind(AssertUnwindSafe(|| stop::until(has_signal, || with_room(work))))) {
        Ok(Some(())) => Ok(()),
        Ok(None) => Err(take_error(py)),
        Err(why) => Err(panic_error(py, &*why)),
    }
}

/// Lets Python handle pending signals. Returns whether one raised an error; [`take_error`] returns it.
fn has_signal() -> bool {
    let handled = Python::try_attach(|py| py.check_signals().map_err(|error| error.restore(py)));
    handled.is_some_and(|handled| handled.is_err())
}

fn take_error(py: Python<'_>) -> PyErr {
    PyErr::take(py).unwrap_or_else(|| PyKeyboardInterrupt::new_err(()))
}

/// The error for the payload of a panic.
fn panic_error(py: Python<'_>, why: &(dyn Any + Send)) -> PyErr {
    if why.is::<Stopped>() {
        return take_error(py);
    }
    if let Some(OutOfMemory { bytes, purpose }) = why.downcast_ref() {
        return PyMemoryError::new_err(format!("out of memory: {bytes} bytes for {purpose}"));
    }
    let text = why.downcast_ref::<&str>().copied().or_else(|| why.downcast_ref().map(String::as_str));
    PyRuntimeError::new_err(format!("a fault in lidarsim, please report it: {}", text.unwrap_or("unknown")))
}

/// The error of an argument that cannot be used; see `lidarsim.errors.ArgumentValueError`.
pub fn argument_error(argument: &str, expected: &str, got: impl Into<String>) -> PyErr {
    let error = |py: Python<'_>| {
        let class = py.import("lidarsim.errors")?.getattr("ArgumentValueError")?;
        class.call1((argument, expected, got.into())).map(PyErr::from_value)
    };
    Python::attach(|py| error(py).unwrap_or_else(|why| why))
}

/// The elements of an array, which must be aligned and C-contiguous; the package ensures this.
///
/// Arrays are read in place. If another thread writes to one meanwhile, the values are unspecified, or a
/// RuntimeError results.
pub fn elements<'a, T: Element, D: Dimension>(
    name: &str,
    array: &'a PyReadonlyArray<'_, T, D>,
) -> PyResult<&'a [T]> {
    let wrong = |_| PyValueError::new_err(format!("{name}: expected an aligned, C-contiguous array"));
    array.as_slice().map_err(wrong)
}

/// An array of this shape over values, which it takes.
pub fn into_array<'py, T: Element>(
    py: Python<'py>,
    values: Vec<T>,
    shape: &[usize],
) -> PyResult<Bound<'py, PyAny>> {
    let array = ArrayD::from_shape_vec(shape, values);
    let array = array.map_err(|wrong| PyValueError::new_err(wrong.to_string()))?;
    Ok(array.into_pyarray(py).into_any())
}

/// A read-only array over values of an object, which it keeps alive.
pub fn view<'py, C, T: Element, D: Dimension>(
    owner: &Bound<'py, C>,
    values: ArrayView<'_, T, D>,
) -> Bound<'py, PyArray<T, D>>
where
    C: PyClass<Frozen = True>,
{
    // SAFETY: the values belong to the owner, which is frozen, and the array holds a reference to it.
    let array = unsafe { PyArray::borrow_from_array(&values, owner.clone().into_any()) };
    array.readwrite().make_nonwriteable();
    array
}

/// The rows of such an array, of shape (n, 3).
pub fn points<'a>(name: &str, array: &'a Points<'_>) -> PyResult<&'a [Point]> {
    let flat = elements(name, array)?;
    match array.shape() {
        [_, 3] => Ok(flat.as_chunks().0),
        other => Err(argument_error(name, "shape (n, 3)", format!("{other:?}"))),
    }
}

/// The rays of two arrays, all legal.
pub fn rays<'a>(origins: &'a Points<'_>, directions: &'a Points<'_>) -> PyResult<(&'a [Point], &'a [Point])> {
    let (o, d) = equal_points(origins, directions)?;
    legal_rays(o, d)?;
    Ok((o, d))
}

/// The rays of two arrays of equal length.
pub fn equal_points<'a>(
    origins: &'a Points<'_>,
    directions: &'a Points<'_>,
) -> PyResult<(&'a [Point], &'a [Point])> {
    let (o, d) = (points("origins", origins)?, points("directions", directions)?);
    if o.len() == d.len() {
        return Ok((o, d));
    }
    let got = format!("{} and {}", o.len(), d.len());
    Err(argument_error("origins, directions", "arrays of equal length", got))
}

/// Names the first ray that is not finite or has a zero direction.
pub fn legal_rays(o: &[Point], d: &[Point]) -> PyResult<()> {
    for (name, vectors) in [("origins", o), ("directions", d)] {
        if let Some(i) = vectors.iter().position(|v| !v.iter().all(|x| x.is_finite())) {
            let j = vectors[i].iter().position(|x| !x.is_finite()).unwrap_or(0);
            let got = format!("{name}[{i}][{j}] = {}", python_float(vectors[i][j]));
            return Err(argument_error(name, "finite numbers", got));
        }
    }
    match d.iter().position(|v| *v == [0.0; 3]) {
        None => Ok(()),
        Some(i) => {
            Err(argument_error("directions", "non-zero vectors", format!("directions[{i}] = (0, 0, 0)")))
        }
    }
}

fn python_float(x: f64) -> String {
    if x.is_nan() { "nan".into() } else { x.to_string() }
}
