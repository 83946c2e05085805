//! The pulses that would hit things, and those that reach them.

use lidarsim_core::measure::{NominalPulses, Targets};
use lidarsim_core::{memory, span};
use numpy::{IntoPyArray, PyArray1, PyReadonlyArray1};
use pyo3::exceptions::PyValueError;
use pyo3::prelude::*;

use crate::scan::{PulseArrays, Pulses};
use crate::{PyPath, PyScene, detached, elements, kernels};

type Coverage<'py> = (Bound<'py, PyArray1<u64>>, Bound<'py, PyArray1<u64>>, Bound<'py, PyArray1<f64>>);

/// Three arrays, of `count` things each: how many of the nominal pulses would hit it if it stood alone, how
/// many of these reach it, and the mean time of the former since the start of the frame, nan if there are
/// none.
///
/// `things` is the thing of each object of the scene, or 2³² − 1. `first` is the object that each pulse hits
/// first, −1 for none within `max_range` and −2 if unknown; absent if all are unknown.
#[pyfunction]
#[expect(clippy::too_many_arguments, reason = "one call a scan")]
pub fn coverage<'py>(
    py: Python<'py>,
    scene: &PyScene,
    path: &PyPath,
    pulses: PulseArrays<'py>,
    start: f64,
    things: PyReadonlyArray1<'py, u32>,
    count: usize,
    max_range: f64,
    first: Option<PyReadonlyArray1<'py, i32>>,
) -> PyResult<Coverage<'py>> {
    let Pulses { directions, origins, times, .. } = pulses.slices()?;
    let things = elements("things", &things)?;
    let first = first.as_ref().map(|first| elements("first", first)).transpose()?;
    let objects = scene.scene.objects().len();
    if things.len() != objects
        || first.is_some_and(|first| first.len() != directions.len())
        || first.is_some_and(|first| first.iter().any(|object| *object >= objects as i32))
    {
        return Err(PyValueError::new_err("things, first: expected one for each object and each pulse"));
    }
    let kernels = kernels(py)?;
    let pulses = NominalPulses { origins, directions, times, start, path: &path.path, first };
    let found = detached(py, || {
        scene.scene.prepare();
        let span = if scene.scene.moves() { span(times) } else { [0.0; 2] };
        let world = &scene.scene.during(span.map(|time| (start + time).clamp(f64::MIN, f64::MAX)));
        let targets = Targets { world, things, count, max_range };
        let found = pulses.coverage(targets, |piece| kernels.cover(piece));
        (
            memory::collect(found.iter().map(|thing| thing.covered)),
            memory::collect(found.iter().map(|thing| thing.reached)),
            memory::collect(found.iter().map(|thing| thing.mean_time())),
        )
    })?;
    Ok((found.0.into_pyarray(py), found.1.into_pyarray(py), found.2.into_pyarray(py)))
}
