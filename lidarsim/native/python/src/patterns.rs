//! The pulses of scan patterns, written to arrays that the caller provides, which become read-only.

use lidarsim_core::patterns::{
    Arrays, Channels, CycleRun, Cycles, Formula, Mid360, OscillatingMirror, Palmer, Polar, Prism, Risley,
    Rotation, fire,
};
use lidarsim_core::{Point, memory};
use numpy::ndarray::Dimension;
use numpy::{
    Element, PyReadonlyArray1, PyReadwriteArray, PyReadwriteArray1, PyReadwriteArray2, PyUntypedArrayMethods,
};
use pyo3::exceptions::PyValueError;
use pyo3::prelude::*;

use crate::{Points, detach, elements, kernels, points};

/// The phase at the first tick of a frame, and what each adds, both in units of 2⁻¹²⁸ of a turn.
type Turns = (u128, u128);

/// Directions at azimuths and elevations, rad.
#[pyfunction]
pub fn fire_polar<'py>(
    py: Python<'py>,
    azimuths: PyReadonlyArray1<'py, f64>,
    elevations: PyReadonlyArray1<'py, f64>,
    mut directions: PyReadwriteArray2<'py, f64>,
) -> PyResult<()> {
    let (azimuths, elevations) = (elements("azimuths", &azimuths)?, elements("elevations", &elevations)?);
    if [azimuths.len(), elevations.len()] != [places(&mut directions)?.len(); 2] {
        return Err(unequal());
    }
    run(py, Formula::Polar(&Polar { azimuths, elevations }), directions)
}

/// Channels that fire in cycles, in firing order.
#[pyclass(frozen, name = "Channels", module = "lidarsim._native")]
pub struct PyChannels(Channels);

#[pymethods]
impl PyChannels {
    /// Beams and origins are those at the azimuth 0; there are no origins if these do not turn with the head.
    /// The firing times are since the start of a cycle.
    #[new]
    #[pyo3(signature = (beams, firing_times, origins=None))]
    fn new<'py>(
        py: Python<'py>,
        beams: Points<'py>,
        firing_times: PyReadonlyArray1<'py, f64>,
        origins: Option<Points<'py>>,
    ) -> PyResult<Self> {
        let (beams, firing_times) = (points("beams", &beams)?, elements("firing_times", &firing_times)?);
        let origins = origins.as_ref().map(|origins| points("origins", origins)).transpose()?;
        let count = beams.len();
        if count == 0 || firing_times.len() != count || origins.is_some_and(|each| each.len() != count) {
            return Err(unequal());
        }
        let origins = origins.unwrap_or_default();
        detach(py, || PyChannels(Channels::new(beams, origins, firing_times)))
    }

    /// Writes the cycles of a frame, as `lidarsim_core::patterns::Cycles` and `CycleRun` describe them, and
    /// makes the arrays read-only.
    #[pyo3(signature = (runs, clock, azimuth, directions, times, origins=None))]
    #[expect(clippy::too_many_arguments, reason = "one call a frame")]
    fn fire<'py>(
        &self,
        py: Python<'py>,
        runs: Vec<(usize, f64, f64, f64)>,
        clock: [f64; 2],
        azimuth: [f64; 2],
        mut directions: PyReadwriteArray2<'py, f64>,
        mut times: PyReadwriteArray1<'py, f64>,
        mut origins: Option<PyReadwriteArray2<'py, f64>>,
    ) -> PyResult<()> {
        let (PyChannels(channels), kernels) = (self, kernels(py)?);
        let arrays = Arrays {
            directions: places(&mut directions)?,
            origins: origins.as_mut().map(places).transpose()?.unwrap_or_default(),
            times: numbers(&mut times)?,
        };
        let columns = runs.iter().fold(0, |columns: usize, run| columns.saturating_add(run.0));
        let pulses = channels.count().saturating_mul(columns);
        let turning = if channels.has_origins() { pulses } else { 0 };
        if [arrays.directions.len(), arrays.origins.len(), arrays.times.len()] != [pulses, turning, pulses] {
            return Err(unequal());
        }
        detach(py, || {
            let run = |(columns, cycle, since, late)| CycleRun { columns, cycle, since, late };
            let runs = memory::collect(runs.into_iter().map(run));
            let cycles = Cycles::new(channels, &runs, clock, azimuth);
            fire(Formula::Cycles(&cycles), arrays, |piece| kernels.fire(piece));
        })?;
        directions.make_nonwriteable();
        times.make_nonwriteable();
        origins.map(PyReadwriteArray2::make_nonwriteable);
        Ok(())
    }
}

/// The directions of a beam on a cone of this half angle, rad.
#[pyfunction]
pub fn fire_palmer<'py>(
    py: Python<'py>,
    half_angle: f64,
    turns: Turns,
    directions: PyReadwriteArray2<'py, f64>,
) -> PyResult<()> {
    run(py, Formula::Palmer(&Palmer::new(half_angle, rotation(turns, 0.0))), directions)
}

/// The directions of a beam that swings over a field of view, rad; `turn` of the time is that of reversals.
#[pyfunction]
pub fn fire_oscillating_mirror<'py>(
    py: Python<'py>,
    field_of_view: f64,
    turn: f64,
    turns: Turns,
    directions: PyReadwriteArray2<'py, f64>,
) -> PyResult<()> {
    let mirror = OscillatingMirror::new(field_of_view, turn, rotation(turns, 0.0));
    run(py, Formula::OscillatingMirror(&mirror), directions)
}

/// The directions of the beams of a Mid-360: turns of the fast phase, and the tick of the first column.
#[pyfunction]
pub fn fire_mid360<'py>(
    py: Python<'py>,
    fast: Turns,
    tick: usize,
    directions: PyReadwriteArray2<'py, f64>,
) -> PyResult<()> {
    run(py, Formula::Mid360(&Mid360::new(rotation(fast, 0.0), tick)), directions)
}

/// The directions of unit vectors behind prisms. A prism is the tilts of its faces, its turns, and its phase,
/// rad. False if one of the faces reflects a beam totally.
#[pyfunction]
pub fn fire_risley<'py>(
    py: Python<'py>,
    beams: Points<'py>,
    prisms: Vec<([f64; 2], Turns, f64)>,
    refractive_index: f64,
    mut directions: PyReadwriteArray2<'py, f64>,
) -> PyResult<bool> {
    let (beams, kernels) = (points("beams", &beams)?, kernels(py)?);
    let arrays = Arrays { directions: places(&mut directions)?, ..Arrays::default() };
    if beams.is_empty() || !arrays.directions.len().is_multiple_of(beams.len()) {
        return Err(unequal());
    }
    let through = detach(py, || {
        let prism = |(tilts, turns, phase)| Prism { tilts, rotation: rotation(turns, phase) };
        let risley = Risley::new(beams, &memory::collect(prisms.into_iter().map(prism)), refractive_index);
        fire(Formula::Risley(&risley), arrays, |piece| kernels.fire(piece))
    })?;
    directions.make_nonwriteable();
    Ok(through)
}

fn rotation((first, step): Turns, angle: f64) -> Rotation {
    Rotation::new(first, step, angle)
}

/// Writes the directions of a frame, and makes their array read-only.
fn run<'py>(py: Python<'py>, formula: Formula, mut directions: PyReadwriteArray2<'py, f64>) -> PyResult<()> {
    let kernels = kernels(py)?;
    let arrays = Arrays { directions: places(&mut directions)?, ..Arrays::default() };
    detach(py, || fire(formula, arrays, |piece| kernels.fire(piece)))?;
    directions.make_nonwriteable();
    Ok(())
}

fn numbers<'a, T: Element, D: Dimension>(array: &'a mut PyReadwriteArray<'_, T, D>) -> PyResult<&'a mut [T]> {
    array.as_slice_mut().map_err(|_| PyValueError::new_err("expected an aligned, C-contiguous array"))
}

/// The rows of an array of shape (n, 3).
fn places<'a>(array: &'a mut PyReadwriteArray2<'_, f64>) -> PyResult<&'a mut [Point]> {
    match array.shape() {
        [_, 3] => Ok(numbers(array)?.as_chunks_mut().0),
        _ => Err(unequal()),
    }
}

fn unequal() -> PyErr {
    PyValueError::new_err("expected arrays of shape (n, 3), with an entry for each pulse")
}
