//! The pulses that would hit instances, and those that reach them.

use lidarsim_core::measure::{NominalPulses, Targets, UNKNOWN};
use lidarsim_core::{NO_INSTANCE, Scene, memory, span};
use numpy::{IntoPyArray, PyArray1, PyReadonlyArray1, PyReadonlyArray2, PyUntypedArrayMethods};
use pyo3::exceptions::PyValueError;
use pyo3::prelude::*;

use crate::scan::{PulseArrays, Pulses};
use crate::{PyPath, PyScene, detach, elements, kernels};

type Coverage<'py> = (
    Bound<'py, PyArray1<u64>>,
    Bound<'py, PyArray1<u64>>,
    Bound<'py, PyArray1<u64>>,
    Bound<'py, PyArray1<f64>>,
);

/// Four arrays, of `count` instances each: how many of the nominal pulses would hit it if it stood alone; how
/// many of these reach it; the number of its returns; and the mean time of its returns, or else of the pulses
/// that would hit it, since the start of the frame.
///
/// `instances` is the instance of each object of the scene, or 2³² − 1; `asked` is a scene of the objects of
/// these instances, and the instance of each of its objects. `returns` are the object of each return,
/// (n, most), and the number of returns of each pulse. `first` is the object that each pulse hits
/// first, −1 for none within `max_range` and −2 if unknown; absent if all are unknown.
#[pyfunction]
#[expect(clippy::too_many_arguments, reason = "one call a scan")]
pub fn coverage<'py>(
    py: Python<'py>,
    scene: &PyScene,
    path: &PyPath,
    pulses: PulseArrays<'py>,
    start: f64,
    instances: (PyReadonlyArray1<'py, u32>, usize),
    asked: (PyRef<'py, PyScene>, PyReadonlyArray1<'py, u32>),
    max_range: f64,
    returns: (PyReadonlyArray2<'py, i32>, PyReadonlyArray1<'py, u8>),
    first: Option<PyReadonlyArray1<'py, i32>>,
) -> PyResult<Coverage<'py>> {
    let Pulses { directions, origins, times, .. } = pulses.slices()?;
    let (instances, count) = (elements("instances", &instances.0)?, instances.1);
    let (whole, alone, instances_alone) = (&scene.scene, &asked.0.scene, elements("asked", &asked.1)?);
    let first = first.as_ref().map(|first| elements("first", first)).transpose()?;
    let (objects, return_counts) =
        (elements("object_id", &returns.0)?, elements("return_count", &returns.1)?);
    let (n, known) = (directions.len(), whole.objects().len());
    let are_of = |instances: &[u32], scene: &Scene| {
        instances.len() == scene.objects().len()
            && instances.iter().all(|instance| *instance == NO_INSTANCE || (*instance as usize) < count)
    };
    if !are_of(instances, whole)
        || !are_of(instances_alone, alone)
        || return_counts.len() != n
        || returns.0.shape()[0] != n
        || first.is_some_and(|first| first.len() != n)
        || first.unwrap_or_default().iter().chain(objects).any(|object| *object >= known as i32)
    {
        return Err(PyValueError::new_err(
            "instances, returns, first: expected one for each object and pulse",
        ));
    }
    let kernels = kernels(py)?;
    let span = span(times).map(|time| (start + time).clamp(f64::MIN, f64::MAX));
    let path = &path.path;
    let pulses = NominalPulses { origins, directions, times, start, path, first, return_counts, objects };
    let found = detach(py, || {
        whole.prepare();
        alone.prepare();
        let casts = first.is_none_or(|first| first.contains(&UNKNOWN));
        let world = casts.then(|| whole.during(span));
        let asked = (&alone.during(span), instances_alone);
        let targets = Targets { world: world.as_ref(), instances, asked, count, max_range };
        let found = pulses.coverage(targets, |piece| kernels.cover(piece));
        (
            memory::collect(found.iter().map(|instance| instance.covering.count)),
            memory::collect(found.iter().map(|instance| instance.reached)),
            memory::collect(found.iter().map(|instance| instance.returns.count)),
            memory::collect(found.iter().map(|instance| instance.mean_time())),
        )
    })?;
    let (covered, reached, points, time) = found;
    Ok((covered.into_pyarray(py), reached.into_pyarray(py), points.into_pyarray(py), time.into_pyarray(py)))
}
