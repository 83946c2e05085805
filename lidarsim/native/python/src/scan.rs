//! Scans: one call a frame, from pulses to the arrays of a scan.

use lidarsim_core::measure::rng::{self, Stream};
use lidarsim_core::measure::{
    BadPulse, Beam, Detection, Effects, Fault, Frame, Measurement, Origins, RangeSigma, Returns, Rows, Scan,
};
use lidarsim_core::{Path, Point, memory, span};
use numpy::{IntoPyArray, PyArray1, PyArray2, PyArrayMethods, PyReadonlyArray1, PyReadonlyArray2};
use pyo3::exceptions::PyValueError;
use pyo3::prelude::*;
use pyo3::types::PyDict;

use crate::{Points, PyPath, PyScene, detached, elements, level, points};

/// Half of the speed of light in vacuum, m/s: a range is half of a way.
const HALF_SPEED_OF_LIGHT: f64 = 299_792_458.0 / 2.0;

/// The attributes of `lidarsim.Lidar` that a scan needs, besides its pattern.
#[derive(FromPyObject)]
pub struct LidarParameters {
    measurement: Parameters,
    #[pyo3(attribute("measurement"))]
    effects: EffectParameters,
    min_range: f64,
    max_range: f64,
    range_offset: OffsetParameter,
}

#[derive(FromPyObject)]
enum OffsetParameter {
    Number(f64),
    Rings(Vec<f64>),
}

/// The attributes of `lidarsim.Measurement` that are effects of a single number.
struct EffectParameters(Effects);

impl<'py> FromPyObject<'_, 'py> for EffectParameters {
    type Error = PyErr;

    fn extract(measurement: Borrowed<'_, 'py, PyAny>) -> PyResult<Self> {
        Effects::by_name(|name| measurement.getattr(name)?.extract()).map(EffectParameters)
    }
}

/// The other attributes of `lidarsim.Measurement`.
#[derive(FromPyObject)]
struct Parameters {
    range_sigma: SigmaParameter,
    range_sigma_slope: f64,
    detection: Option<DetectionParameters>,
    beam: Option<BeamParameters>,
    returns: ReturnsParameter,
}

#[derive(FromPyObject)]
enum SigmaParameter {
    Number(f64),
    Table(Vec<[f64; 2]>),
}

#[derive(FromPyObject)]
struct DetectionParameters {
    reflectivity: f64,
    range: f64,
}

#[derive(FromPyObject)]
struct BeamParameters {
    divergence_azimuth: f64,
    divergence_elevation: f64,
    pulse_length: f64,
    rays: usize,
}

#[derive(FromPyObject)]
enum ReturnsParameter {
    Nearest(usize),
    Name(String),
}

impl LidarParameters {
    fn measurement(self) -> PyResult<Measurement> {
        let LidarParameters { measurement: parameters, effects, min_range, max_range, range_offset } = self;
        let returns = match parameters.returns {
            ReturnsParameter::Nearest(n) => Returns::Nearest(n),
            ReturnsParameter::Name(name) => match name.as_str() {
                "strongest" => Returns::Strongest,
                "first" => Returns::First,
                "last" => Returns::Last,
                "dual" => Returns::Dual,
                _ => return Err(PyValueError::new_err(format!("returns: unknown {name:?}"))),
            },
        };
        Ok(Measurement {
            effects: effects.0,
            detection: parameters.detection.map(|d| Detection { reflectivity: d.reflectivity, range: d.range }),
            range_sigma: match parameters.range_sigma {
                SigmaParameter::Number(a) => RangeSigma::Formula { a, b: parameters.range_sigma_slope },
                SigmaParameter::Table(rows) => RangeSigma::Table(rows),
            },
            beam: parameters.beam.map(|b| {
                Beam::new([b.divergence_azimuth, b.divergence_elevation], b.rays, HALF_SPEED_OF_LIGHT * b.pulse_length)
            }),
            returns,
            range_offset: match range_offset {
                OffsetParameter::Number(0.0) => Vec::new(),
                OffsetParameter::Number(offset) => vec![offset],
                OffsetParameter::Rings(offsets) => offsets,
            },
            min_range,
            max_range,
        })
    }
}

/// The attributes of `lidarsim.patterns.Pulses` that a scan needs.
#[derive(FromPyObject)]
pub struct PulseArrays<'py> {
    directions: Points<'py>,
    origins: Points<'py>,
    #[pyo3(attribute("_origin"))]
    origin: Option<Point>,
    time: PyReadonlyArray1<'py, f64>,
    ring: PyReadonlyArray1<'py, u16>,
}

/// The same, of equal length.
struct Pulses<'a> {
    directions: &'a [Point],
    origins: Origins<'a>,
    times: &'a [f64],
    rings: &'a [u16],
}

impl PulseArrays<'_> {
    fn slices(&self) -> PyResult<Pulses<'_>> {
        let (directions, origins) =
            (points("pulses.directions", &self.directions)?, points("pulses.origins", &self.origins)?);
        let (times, rings) = (elements("pulses.time", &self.time)?, elements("pulses.ring", &self.ring)?);
        if [origins.len(), times.len(), rings.len()] != [directions.len(); 3] {
            return Err(PyValueError::new_err(format!(
                "pulses: expected directions, origins, time and ring of equal length, got {}, {}, {} and {}",
                directions.len(),
                origins.len(),
                times.len(),
                rings.len()
            )));
        }
        let origins = self.origin.map_or(Origins::Each(origins), Origins::One);
        Ok(Pulses { directions, origins, times, rings })
    }
}

/// What a scan gives: each array has capacity for all pulses, and its length when it is filled.
struct ScanColumns {
    range: Vec<f64>,
    true_range: Vec<f64>,
    range_error: Vec<f64>,
    intensity: Vec<f32>,
    incidence: Vec<f32>,
    normal: Vec<f32>,
    object_id: Vec<i32>,
    instance: Vec<u32>,
    label: Vec<u32>,
    true_direction: Vec<Point>,
    radial_velocity: Vec<f32>,
    status: Vec<u8>,
    return_count: Vec<u8>,
    /// Whether pulses need not go where they should, so that there are true directions.
    strays: bool,
    /// Whether sensor or scene moves, so that there are radial velocities.
    moves: bool,
}

impl ScanColumns {
    /// Unwinds if the system has no memory for the rows of so many pulses.
    fn expect_room(pulses: usize, most: usize, strays: bool, moves: bool) {
        let direction = if strays { size_of::<Point>() } else { 0 };
        let row = 3 * size_of::<f64>() + (8 + usize::from(moves)) * size_of::<f32>() + direction;
        memory::expect_room(pulses.saturating_mul(most).saturating_mul(row), || {
            format!("the returns of {pulses} pulses, {most} each")
        });
    }

    /// With capacity for the rows of so many pulses.
    fn new(pulses: usize, most: usize, strays: bool, moves: bool) -> Self {
        ScanColumns::expect_room(pulses, most, strays, moves);
        let rows = pulses.saturating_mul(most);
        ScanColumns {
            range: memory::with_capacity(rows),
            true_range: memory::with_capacity(rows),
            range_error: memory::with_capacity(rows),
            intensity: memory::with_capacity(rows),
            incidence: memory::with_capacity(rows),
            normal: memory::with_capacity(3 * rows),
            object_id: memory::with_capacity(rows),
            instance: memory::with_capacity(rows),
            label: memory::with_capacity(rows),
            true_direction: if strays { memory::with_capacity(rows) } else { Vec::new() },
            radial_velocity: if moves { memory::with_capacity(rows) } else { Vec::new() },
            status: memory::with_capacity(pulses),
            return_count: memory::with_capacity(pulses),
            strays,
            moves,
        }
    }

    /// The rows of all pulses.
    fn rows(&mut self, pulses: usize, most: usize) -> Rows<'_> {
        let rows = pulses * most;
        Rows {
            range: &mut self.range.spare_capacity_mut()[..rows],
            true_range: &mut self.true_range.spare_capacity_mut()[..rows],
            range_error: &mut self.range_error.spare_capacity_mut()[..rows],
            intensity: &mut self.intensity.spare_capacity_mut()[..rows],
            incidence: &mut self.incidence.spare_capacity_mut()[..rows],
            normal: &mut self.normal.spare_capacity_mut()[..3 * rows],
            object_id: &mut self.object_id.spare_capacity_mut()[..rows],
            instance: &mut self.instance.spare_capacity_mut()[..rows],
            label: &mut self.label.spare_capacity_mut()[..rows],
            true_direction: if self.strays { &mut self.true_direction.spare_capacity_mut()[..rows] } else { &mut [] },
            radial_velocity: if self.moves { &mut self.radial_velocity.spare_capacity_mut()[..rows] } else { &mut [] },
            status: &mut self.status.spare_capacity_mut()[..pulses],
            return_count: &mut self.return_count.spare_capacity_mut()[..pulses],
        }
    }

    /// # Safety
    ///
    /// The rows of so many pulses must have been written.
    unsafe fn are_written(&mut self, pulses: usize, most: usize) {
        let rows = pulses * most;
        // SAFETY: there is capacity for as many, and the caller has written them.
        unsafe {
            self.range.set_len(rows);
            self.true_range.set_len(rows);
            self.range_error.set_len(rows);
            self.intensity.set_len(rows);
            self.incidence.set_len(rows);
            self.normal.set_len(3 * rows);
            self.object_id.set_len(rows);
            self.instance.set_len(rows);
            self.label.set_len(rows);
            self.true_direction.set_len(if self.strays { rows } else { 0 });
            self.radial_velocity.set_len(if self.moves { rows } else { 0 });
            self.status.set_len(pulses);
            self.return_count.set_len(pulses);
        }
    }

    fn into_dict(self, py: Python<'_>, most: usize) -> PyResult<Bound<'_, PyDict>> {
        let shape = [self.status.len(), most];
        let arrays = PyDict::new(py);
        arrays.set_item("range", self.range.into_pyarray(py).reshape(shape)?)?;
        arrays.set_item("true_range", self.true_range.into_pyarray(py).reshape(shape)?)?;
        arrays.set_item("range_error", self.range_error.into_pyarray(py).reshape(shape)?)?;
        arrays.set_item("intensity", self.intensity.into_pyarray(py).reshape(shape)?)?;
        arrays.set_item("incidence", self.incidence.into_pyarray(py).reshape(shape)?)?;
        arrays.set_item("normal", self.normal.into_pyarray(py).reshape([shape[0], most, 3])?)?;
        arrays.set_item("object_id", self.object_id.into_pyarray(py).reshape(shape)?)?;
        arrays.set_item("instance", self.instance.into_pyarray(py).reshape(shape)?)?;
        arrays.set_item("label", self.label.into_pyarray(py).reshape(shape)?)?;
        arrays.set_item("status", self.status.into_pyarray(py))?;
        arrays.set_item("return_count", self.return_count.into_pyarray(py))?;
        if self.strays {
            let directions = self.true_direction.into_flattened().into_pyarray(py).reshape([shape[0], most, 3])?;
            arrays.set_item("true_direction", directions)?;
        }
        if self.moves {
            arrays.set_item("radial_velocity", self.radial_velocity.into_pyarray(py).reshape(shape)?)?;
        }
        Ok(arrays)
    }
}

/// Raises MemoryError if there is none for a scan of so many pulses.
#[pyfunction]
pub fn expect_room(py: Python<'_>, pulses: usize, lidar: LidarParameters) -> PyResult<()> {
    let measurement = lidar.measurement()?;
    detached(py, || ScanColumns::expect_room(pulses, measurement.most_returns(), measurement.strays(), false))
}

/// Fires the pulses of a frame and measures what comes back: the arrays of `lidarsim.Scan`, of shape (n, most).
///
/// `indices`: which pulses of the whole frame these are, if they are not all in order.
/// `draws`: seed, sensor and frame.
#[pyfunction]
#[expect(clippy::too_many_arguments, reason = "one call a scan")]
pub fn scan<'py>(
    py: Python<'py>,
    scene: &PyScene,
    path: &PyPath,
    pulses: PulseArrays<'py>,
    indices: Option<PyReadonlyArray1<'py, u64>>,
    lidar: LidarParameters,
    start: f64,
    draws: (u64, u32, u32),
) -> PyResult<Bound<'py, PyDict>> {
    let Pulses { directions, origins, times, rings } = pulses.slices()?;
    let indices = indices.as_ref().map(|indices| elements("indices", indices)).transpose()?;
    let measurement = lidar.measurement()?;
    check_rings(rings, &measurement.range_offset)?;
    let stream = Stream::new(draws.0, draws.1, draws.2);
    let frame = Frame { origins, directions, times, rings, indices, start, path: &path.path, stream };
    let (most, level) = (measurement.most_returns(), level(py)?);
    let moves = scene.scene.moves() || !matches!(frame.path, Path::Still(_));
    let measured = detached(py, || {
        let mut columns = ScanColumns::new(directions.len(), most, measurement.strays(), moves);
        scene.scene.prepare();
        // Rounding keeps the order of times; one that overflows is refused. Where nothing moves, it does not matter when.
        let span = if scene.scene.moves() { span(times) } else { [0.0; 2] };
        let world = scene.scene.during(span.map(|time| (start + time).clamp(f64::MIN, f64::MAX)));
        let scan = Scan::new(&frame, &measurement, &scene.appearances, &world, level);
        scan.share(&mut columns.rows(directions.len(), most))?;
        // SAFETY: all pulses are measured, and none was bad, so that all of their rows were written.
        unsafe { columns.are_written(directions.len(), most) };
        Ok(columns)
    })?;
    measured.map_err(|bad| PyValueError::new_err(explain(bad, &frame)))?.into_dict(py, most)
}

/// Of one offset for all rings there is nothing to look up.
fn check_rings(rings: &[u16], offsets: &[f64]) -> PyResult<()> {
    let unknown = |ring: &u16| offsets.len() > 1 && usize::from(*ring) >= offsets.len();
    match rings.iter().position(unknown) {
        None => Ok(()),
        Some(i) => Err(PyValueError::new_err(format!(
            "range_offset: expected an offset for each ring of the pulses, got {} of them and pulses.ring[{i}] = {}",
            offsets.len(),
            rings[i]
        ))),
    }
}

fn explain(BadPulse { pulse: i, fault }: BadPulse, frame: &Frame) -> String {
    match fault {
        Fault::Direction => {
            let [x, y, z] = frame.directions[i];
            format!("pulses.directions: expected unit vectors, got pulses.directions[{i}] = ({x}, {y}, {z})")
        }
        Fault::Origin => {
            let [x, y, z] = frame.origins.of(i);
            format!("pulses.origins: expected finite numbers, got pulses.origins[{i}] = ({x}, {y}, {z})")
        }
        Fault::Time => {
            let ([first, last], time) = (frame.path.span(), frame.start + frame.times[i]);
            let pulse = frame.indices.map_or(i as u64, |indices| indices[i]);
            format!(
                "pose: expected a trajectory over all pulses, got one from {first} to {last} s and pulse {pulse} at {time} s"
            )
        }
    }
}

/// Philox4x32-10 of each counter (n, 4) with one key.
#[pyfunction]
pub fn philox<'py>(
    py: Python<'py>,
    counters: PyReadonlyArray2<'py, u32>,
    key: [u32; 2],
) -> PyResult<Bound<'py, PyArray2<u32>>> {
    let counters: &[[u32; 4]] = elements("counters", &counters)?.as_chunks().0;
    let words = detached(py, || memory::collect(counters.iter().map(|&counter| rng::philox(counter, key))))?;
    words.into_flattened().into_pyarray(py).reshape([counters.len(), 4])
}

/// The inverse of the normal distribution.
#[pyfunction]
pub fn normal_quantile<'py>(py: Python<'py>, p: PyReadonlyArray1<'py, f64>) -> PyResult<Bound<'py, PyArray1<f64>>> {
    let p = elements("p", &p)?;
    Ok(detached(py, || memory::collect(p.iter().map(|&p| rng::normal_quantile(p))))?.into_pyarray(py))
}
