//! The waveforms of the pulses of a scan.

use lidarsim_core::measure::{Recorder, Samples};
use lidarsim_core::memory;
use numpy::{IntoPyArray, PyArray1, PyReadonlyArray1};
use pyo3::prelude::*;

use crate::scan::{PulseArrays, Shot, measurement_of};
use crate::{PyPath, PyScene, kernels};

type Waveforms<'py> = (Bound<'py, PyArray1<i64>>, Bound<'py, PyArray1<i64>>, Bound<'py, PyArray1<f32>>);

/// Fires pulses as `scan` does and samples their waveforms, every `period` seconds: the number of the first
/// sample of each, (n,), where the samples of each begin and the last ends, (n + 1,), and all samples.
///
/// The other arguments are those of `scan`.
#[pyfunction]
#[pyo3(signature = (scene, path, pulses, indices, lidar, start, draws, period, max_range, atmosphere=None,
    ignored=None))]
#[expect(clippy::too_many_arguments, reason = "one call a scan")]
pub fn waveforms<'py>(
    py: Python<'py>,
    scene: &PyScene,
    path: &PyPath,
    pulses: PulseArrays<'py>,
    indices: Option<PyReadonlyArray1<'py, u64>>,
    lidar: &Bound<'py, PyAny>,
    start: f64,
    draws: (u64, u32, u32),
    period: f64,
    max_range: f64,
    atmosphere: Option<&Bound<'py, PyAny>>,
    ignored: Option<PyReadonlyArray1<'py, i64>>,
) -> PyResult<Waveforms<'py>> {
    let measurement = measurement_of(lidar, atmosphere)?;
    let kernels = kernels(py)?;
    let shot = Shot { scene, path, pulses, indices, start, draws, ignored };
    let (first, ends, values) = shot.fire(py, &measurement, |scan| {
        let recorder = Recorder::new(period, max_range);
        let Samples { windows, values } = scan.record(recorder, |batch| kernels.record(batch))?;
        let mut ends = memory::with_capacity(windows.len() + 1);
        ends.push(0);
        ends.extend(windows.iter().scan(0, |end, window| {
            *end += window.count as i64;
            Some(*end)
        }));
        Ok((memory::collect(windows.iter().map(|window| window.first)), ends, values))
    })?;
    Ok((first.into_pyarray(py), ends.into_pyarray(py), values.into_pyarray(py)))
}
