//! The pulses of scan patterns, written to arrays that the caller provides.

use lidarsim_core::Point;
use lidarsim_core::patterns::{
    Arrays, Cycles, Formula, Mid360, OscillatingMirror, Palmer, Polar, Prism, Risley, Rotation, Run, fire,
};
use numpy::ndarray::Dimension;
use numpy::{
    Element, PyReadonlyArray1, PyReadwriteArray, PyReadwriteArray1, PyReadwriteArray2, PyUntypedArrayMethods,
};
use pyo3::exceptions::PyValueError;
use pyo3::prelude::*;

use crate::{Points, detached, elements, kernels, points};

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
    let directions = places(&mut directions)?;
    if [azimuths.len(), elevations.len()] != [directions.len(); 2] {
        return Err(unequal());
    }
    let formula = Formula::Polar(&Polar { azimuths, elevations });
    run(py, formula, Arrays { directions, ..Arrays::default() }).map(drop)
}

/// The cycles of a frame, as `lidarsim_core::patterns::Cycles` and `Run` describe them. The arrays of origins
/// have no rows if these do not turn with the head.
#[pyfunction]
#[expect(clippy::too_many_arguments, reason = "one call a frame")]
pub fn fire_cycles<'py>(
    py: Python<'py>,
    beams: Points<'py>,
    beam_origins: Points<'py>,
    firing_times: PyReadonlyArray1<'py, f64>,
    runs: Vec<(usize, f64, f64, f64)>,
    clock: [f64; 2],
    azimuth: [f64; 2],
    mut directions: PyReadwriteArray2<'py, f64>,
    mut origins: PyReadwriteArray2<'py, f64>,
    mut times: PyReadwriteArray1<'py, f64>,
) -> PyResult<()> {
    let (beams, beam_origins) = (points("beams", &beams)?, points("beam_origins", &beam_origins)?);
    let firing_times = elements("firing_times", &firing_times)?;
    let (directions, origins, times) =
        (places(&mut directions)?, places(&mut origins)?, numbers(&mut times)?);
    let run = |(columns, cycle, since, late)| Run { columns, cycle, since, late };
    let runs: Vec<Run> = runs.into_iter().map(run).collect();
    let columns = runs.iter().fold(0, |columns: usize, run| columns.saturating_add(run.columns));
    let (channels, pulses) = (beams.len(), beams.len().saturating_mul(columns));
    let turning = if beam_origins.is_empty() { 0 } else { 1 };
    if channels == 0
        || [firing_times.len(), beam_origins.len()] != [channels, turning * channels]
        || [directions.len(), times.len(), origins.len()] != [pulses, pulses, turning * pulses]
    {
        return Err(unequal());
    }
    let kernels = kernels(py)?;
    detached(py, || {
        let cycles = Cycles::new(beams, beam_origins, firing_times, &runs, clock, azimuth);
        let arrays = Arrays { directions, origins, times };
        fire(Formula::Cycles(&cycles), arrays, |piece| kernels.fire(piece));
    })
}

/// The directions of a beam on a cone of this half angle, rad.
#[pyfunction]
pub fn fire_palmer<'py>(
    py: Python<'py>,
    half_angle: f64,
    turns: Turns,
    mut directions: PyReadwriteArray2<'py, f64>,
) -> PyResult<()> {
    let arrays = Arrays { directions: places(&mut directions)?, ..Arrays::default() };
    run(py, Formula::Palmer(&Palmer::new(half_angle, rotation(turns, 0.0))), arrays).map(drop)
}

/// The directions of a beam that swings over a field of view, rad; `turn` of the time is that of reversals.
#[pyfunction]
pub fn fire_oscillating_mirror<'py>(
    py: Python<'py>,
    field_of_view: f64,
    turn: f64,
    turns: Turns,
    mut directions: PyReadwriteArray2<'py, f64>,
) -> PyResult<()> {
    let arrays = Arrays { directions: places(&mut directions)?, ..Arrays::default() };
    let mirror = OscillatingMirror::new(field_of_view, turn, rotation(turns, 0.0));
    run(py, Formula::OscillatingMirror(&mirror), arrays).map(drop)
}

/// The directions of the beams of a Mid-360: turns of the fast phase, and the tick of the first column.
#[pyfunction]
pub fn fire_mid360<'py>(
    py: Python<'py>,
    fast: Turns,
    tick: usize,
    mut directions: PyReadwriteArray2<'py, f64>,
) -> PyResult<()> {
    let arrays = Arrays { directions: places(&mut directions)?, ..Arrays::default() };
    run(py, Formula::Mid360(&Mid360::new(rotation(fast, 0.0), tick)), arrays).map(drop)
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
    let (beams, directions) = (points("beams", &beams)?, places(&mut directions)?);
    if beams.is_empty() || directions.len() % beams.len() != 0 {
        return Err(unequal());
    }
    let kernels = kernels(py)?;
    detached(py, || {
        let prism = |(tilts, turns, phase)| Prism { tilts, rotation: rotation(turns, phase) };
        let risley = Risley::new(beams, &prisms.into_iter().map(prism).collect::<Vec<_>>(), refractive_index);
        let arrays = Arrays { directions, ..Arrays::default() };
        fire(Formula::Risley(&risley), arrays, |piece| kernels.fire(piece))
    })
}

fn rotation((first, step): Turns, angle: f64) -> Rotation {
    Rotation::new(first, step, angle)
}

fn run(py: Python<'_>, formula: Formula, arrays: Arrays) -> PyResult<bool> {
    let kernels = kernels(py)?;
    detached(py, || fire(formula, arrays, |piece| kernels.fire(piece)))
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
