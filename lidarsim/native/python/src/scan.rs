//! Scans: one call a frame, from pulses to the arrays of a scan, and from these to those of a point cloud.

use std::borrow::Cow;
use std::sync::Arc;

use lidarsim_core::measure::rng::{self, Stream};
use lidarsim_core::measure::{
    Appearance, BadPulse, Beam, Detection, Effects, Fault, Frame, Measurement, RangeSigma, Reflectivity, ReturnRows,
    Returns, Rows, Scan,
};
use lidarsim_core::{Cubic, Path, Point, Pose, Step, Velocity, memory};
use numpy::ndarray::Dimension;
use numpy::{
    Element, IntoPyArray, PyArray1, PyArray2, PyArrayMethods, PyReadonlyArray, PyReadonlyArray1, PyReadonlyArray2,
    PyReadonlyArray3, PyUntypedArrayMethods,
};
use pyo3::exceptions::PyValueError;
use pyo3::prelude::*;
use pyo3::types::{PyDict, PyList};

use crate::{Points, PyScene, detached, elements, level, points};

/// Half of the speed of light in vacuum, m/s: a range is half of a way.
const HALF_SPEED_OF_LIGHT: f64 = 299_792_458.0 / 2.0;

/// Where the sensor is at each time.
#[pyclass(frozen, name = "Path", module = "lidarsim._native")]
pub struct PyPath {
    path: Arc<Path>,
}

type Matrix = [[f64; 4]; 4];

fn pose([x, y, z, _]: Matrix) -> Pose {
    Pose::from_rows([x, y, z])
}

impl From<Path> for PyPath {
    fn from(path: Path) -> Self {
        PyPath { path: Arc::new(path) }
    }
}

#[pymethods]
impl PyPath {
    #[staticmethod]
    fn still(matrix: Matrix) -> Self {
        Path::Still(pose(matrix)).into()
    }

    /// Constant velocities in the moving frame, which is at `matrix` at time 0.
    #[staticmethod]
    fn twist(matrix: Matrix, linear: Point, angular: Point) -> Self {
        Path::Twist { start: pose(matrix), linear, angular }.into()
    }

    /// n rising times; the matrix at each, (n, 16); and how each leads to the next, (n - 1, 18): the three coefficients of
    /// the way, and those of the rotation vector.
    #[staticmethod]
    fn knots(
        py: Python<'_>,
        times: PyReadonlyArray1<'_, f64>,
        matrices: PyReadonlyArray2<'_, f64>,
        steps: PyReadonlyArray2<'_, f64>,
    ) -> PyResult<Self> {
        let n = times.len();
        if n == 0 || matrices.shape() != [n, 16] || steps.shape() != [n - 1, 18] {
            return Err(PyValueError::new_err(
                "times, matrices, steps: expected shapes (n,), (n, 16) and (n - 1, 18), n > 0",
            ));
        }
        let times = elements("times", &times)?;
        let matrices: &[[f64; 16]] = elements("matrices", &matrices)?.as_chunks().0;
        let steps: &[[f64; 18]] = elements("steps", &steps)?.as_chunks().0;
        let poses = matrices.iter().map(|m| pose(std::array::from_fn(|i| std::array::from_fn(|j| m[4 * i + j]))));
        let steps = steps.iter().map(|s| {
            let cubic = |first| Cubic(std::array::from_fn(|i| std::array::from_fn(|k| s[first + 3 * i + k])));
            Step { shift: cubic(0), turn: cubic(9) }
        });
        let path = detached(py, || {
            let (times, poses, steps) = (memory::copy(times), memory::collect(poses), memory::collect(steps));
            let end = times[n - 1];
            Path::Knots { times, poses, steps, end }
        })?;
        Ok(path.into())
    }

    /// The path of a sensor that is mounted so on what moves along this one.
    fn mounted(&self, matrix: Matrix) -> Self {
        self.path.mounted(&pose(matrix)).into()
    }

    /// The same poses over a span that goes on to `until`, at the velocities of its end.
    fn held(&self, until: f64) -> Self {
        self.path.held(until).into()
    }

    /// First and last time for which there is a pose.
    fn span(&self) -> (f64, f64) {
        self.path.span().into()
    }

    /// Poses (n, 4, 4) at some times.
    fn at<'py>(&self, py: Python<'py>, times: PyReadonlyArray1<'py, f64>) -> PyResult<Bound<'py, PyAny>> {
        let times = elements("times", &times)?;
        let poses = detached(py, || {
            memory::collect(times.iter().map(|&time| {
                let [x, y, z] = self.path.at(time).rows();
                [x, y, z, [0.0, 0.0, 0.0, 1.0]]
            }))
        })?;
        Ok(poses.into_flattened().into_flattened().into_pyarray(py).reshape([times.len(), 4, 4])?.into_any())
    }

    /// Velocities (n, 2, 3) at times of the span: linear in the world, angular in the moving frame.
    fn velocity<'py>(&self, py: Python<'py>, times: PyReadonlyArray1<'py, f64>) -> PyResult<Bound<'py, PyAny>> {
        let times = elements("times", &times)?;
        let velocities = detached(py, || {
            memory::collect(times.iter().map(|&time| {
                let Velocity { linear, angular } = self.path.velocity(time);
                [linear, angular]
            }))
        })?;
        Ok(velocities.into_flattened().into_flattened().into_pyarray(py).reshape([times.len(), 2, 3])?.into_any())
    }
}

/// Label and reflectivity of each object of a scene.
#[pyclass(frozen, name = "Appearances", module = "lidarsim._native")]
pub struct PyAppearances {
    appearances: Vec<Appearance>,
}

#[pymethods]
impl PyAppearances {
    /// For each object its label, what its reflectivity is given per ("object", "face" or "vertex"), and the values of that.
    #[new]
    fn new(py: Python<'_>, objects: &Bound<'_, PyList>) -> PyResult<Self> {
        let count = objects.len();
        let mut appearances = detached(py, || memory::with_capacity(count))?;
        for object in objects.iter().take(count) {
            let (label, per, values): (u32, String, PyReadonlyArray1<'_, f64>) = object.extract()?;
            let values = elements("reflectivity", &values)?;
            let reflectivity = match (per.as_str(), values) {
                ("object", [value]) => Reflectivity::Object(*value),
                ("face", _) => Reflectivity::Face(detached(py, || memory::copy(values))?),
                ("vertex", _) => Reflectivity::Vertex(detached(py, || memory::copy(values))?),
                _ => {
                    return Err(PyValueError::new_err(
                        "reflectivity: expected one of an object, or some per face or vertex",
                    ));
                }
            };
            appearances.push(Appearance { label, reflectivity });
        }
        Ok(PyAppearances { appearances })
    }
}

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
    time: PyReadonlyArray1<'py, f64>,
    ring: PyReadonlyArray1<'py, u16>,
}

/// The same, of equal length.
struct Pulses<'a> {
    directions: &'a [Point],
    origins: &'a [Point],
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
    normal: Vec<[f32; 3]>,
    object_id: Vec<i32>,
    label: Vec<u32>,
    true_direction: Vec<Point>,
    status: Vec<u8>,
    return_count: Vec<u8>,
    /// Whether pulses need not go where they should, so that there are true directions.
    strays: bool,
}

impl ScanColumns {
    /// Unwinds if the system has no memory for the rows of so many pulses.
    fn expect_room(pulses: usize, most: usize, strays: bool) {
        let direction = if strays { size_of::<Point>() } else { 0 };
        let row = 3 * size_of::<f64>() + 7 * size_of::<f32>() + direction;
        memory::expect_room(pulses.saturating_mul(most).saturating_mul(row), || {
            format!("the returns of {pulses} pulses, {most} each")
        });
    }

    /// With capacity for the rows of so many pulses.
    fn new(pulses: usize, most: usize, strays: bool) -> Self {
        ScanColumns::expect_room(pulses, most, strays);
        let rows = pulses.saturating_mul(most);
        ScanColumns {
            range: memory::with_capacity(rows),
            true_range: memory::with_capacity(rows),
            range_error: memory::with_capacity(rows),
            intensity: memory::with_capacity(rows),
            incidence: memory::with_capacity(rows),
            normal: memory::with_capacity(rows),
            object_id: memory::with_capacity(rows),
            label: memory::with_capacity(rows),
            true_direction: if strays { memory::with_capacity(rows) } else { Vec::new() },
            status: memory::with_capacity(pulses),
            return_count: memory::with_capacity(pulses),
            strays,
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
            normal: &mut self.normal.spare_capacity_mut()[..rows],
            object_id: &mut self.object_id.spare_capacity_mut()[..rows],
            label: &mut self.label.spare_capacity_mut()[..rows],
            true_direction: if self.strays { &mut self.true_direction.spare_capacity_mut()[..rows] } else { &mut [] },
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
            self.normal.set_len(rows);
            self.object_id.set_len(rows);
            self.label.set_len(rows);
            self.true_direction.set_len(if self.strays { rows } else { 0 });
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
        arrays.set_item("normal", self.normal.into_flattened().into_pyarray(py).reshape([shape[0], most, 3])?)?;
        arrays.set_item("object_id", self.object_id.into_pyarray(py).reshape(shape)?)?;
        arrays.set_item("label", self.label.into_pyarray(py).reshape(shape)?)?;
        arrays.set_item("status", self.status.into_pyarray(py))?;
        arrays.set_item("return_count", self.return_count.into_pyarray(py))?;
        if self.strays {
            let directions = self.true_direction.into_flattened().into_pyarray(py).reshape([shape[0], most, 3])?;
            arrays.set_item("true_direction", directions)?;
        }
        Ok(arrays)
    }
}

/// Raises MemoryError if there is none for a scan of so many pulses.
#[pyfunction]
pub fn expect_room(py: Python<'_>, pulses: usize, lidar: LidarParameters) -> PyResult<()> {
    let measurement = lidar.measurement()?;
    detached(py, || ScanColumns::expect_room(pulses, measurement.returns.most(), measurement.strays()))
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
    appearances: &PyAppearances,
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
    let (most, level) = (measurement.returns.most(), level(py)?);
    let measured = detached(py, || {
        let mut columns = ScanColumns::new(directions.len(), most, measurement.strays());
        scene.scene.prepare();
        let scan = Scan::new(&frame, &measurement, &appearances.appearances, &scene.scene, level);
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
            let [x, y, z] = frame.origins[i];
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

/// The attributes of `lidarsim.Scan` that a point cloud is made from.
#[derive(FromPyObject)]
pub struct ScanArrays<'py> {
    pulses: AllPulseArrays<'py>,
    time: f64,
    range: PyReadonlyArray2<'py, f64>,
    true_range: PyReadonlyArray2<'py, f64>,
    range_error: PyReadonlyArray2<'py, f64>,
    intensity: PyReadonlyArray2<'py, f32>,
    incidence: PyReadonlyArray2<'py, f32>,
    normal: PyReadonlyArray3<'py, f32>,
    object_id: PyReadonlyArray2<'py, i32>,
    label: PyReadonlyArray2<'py, u32>,
    return_count: PyReadonlyArray1<'py, u8>,
}

#[derive(FromPyObject)]
struct AllPulseArrays<'py> {
    directions: Points<'py>,
    origins: Points<'py>,
    time: PyReadonlyArray1<'py, f64>,
    ring: PyReadonlyArray1<'py, u16>,
    column: PyReadonlyArray1<'py, u32>,
}

/// In which coordinates points are given.
#[derive(Clone, Copy)]
enum Coordinates {
    /// Of the sensor when it fired the pulse.
    Sensor,
    /// Of the sensor at one moment.
    Moment(Pose),
    World,
}

/// The fields of `lidarsim.PointCloud`, an entry a return. `frame`: "sensor" or "world"; `moment`: the time, on the clock of
/// the path, whose sensor frame the points of "sensor" are put in, if it is one for all.
#[pyfunction]
pub fn points_of<'py>(
    py: Python<'py>,
    scan: ScanArrays<'py>,
    path: &PyPath,
    frame: &str,
    moment: Option<f64>,
) -> PyResult<Bound<'py, PyDict>> {
    let path: &Path = &path.path;
    let coordinates = match (frame, path, moment) {
        ("world", ..) => Coordinates::World,
        ("sensor", Path::Still(_), _) | ("sensor", _, None) => Coordinates::Sensor,
        ("sensor", _, Some(time)) => Coordinates::Moment(path.at(time)),
        _ => return Err(PyValueError::new_err(format!("frame: unknown {frame:?}"))),
    };
    let pulses = &scan.pulses;
    let (n, most) = (scan.return_count.len(), scan.range.shape()[1]);
    let directions = of_length(n, points("pulses.directions", &pulses.directions)?)?;
    let origins = of_length(n, points("pulses.origins", &pulses.origins)?)?;
    let (times, rings) = (column(n, &pulses.time)?, column(n, &pulses.ring)?);
    let columns = column(n, &pulses.column)?;
    let counts = column(n, &scan.return_count)?;
    let (range, true_range) = (column(n * most, &scan.range)?, column(n * most, &scan.true_range)?);
    let (range_error, intensity) = (column(n * most, &scan.range_error)?, column(n * most, &scan.intensity)?);
    let (incidence, object_id) = (column(n * most, &scan.incidence)?, column(n * most, &scan.object_id)?);
    let label = column(n * most, &scan.label)?;
    let normals: &[[f32; 3]] = of_length(n * most, column(n * most * 3, &scan.normal)?.as_chunks().0)?;

    let returns = detached(py, || ReturnRows::new(counts, most))?;
    // Not copied where there is but one: to read back in one piece what was written in several takes long.
    let pose = |pulse: usize| match path {
        Path::Still(pose) => Cow::Borrowed(pose),
        _ => Cow::Owned(path.at(scan.time + times[pulse])),
    };
    let place = |row: usize, pulse: usize| {
        let local: Point = std::array::from_fn(|k| origins[pulse][k] + directions[pulse][k] * range[row]);
        match coordinates {
            Coordinates::Sensor => local,
            Coordinates::Moment(at) => pose(pulse).relative_to(&at).place(local),
            Coordinates::World => pose(pulse).place(local),
        }
    };
    let turn = |row: usize, pulse: usize| {
        let normal = normals[row].map(f64::from);
        let turned = match coordinates {
            Coordinates::Sensor => pose(pulse).turn_back(normal),
            Coordinates::Moment(at) => at.turn_back(normal),
            Coordinates::World => normal,
        };
        turned.map(|x| x as f32)
    };
    let fields = PyDict::new(py);
    let shape = [returns.count(), 3];
    fields.set_item("xyz", gather(py, &returns, place)?.into_flattened().into_pyarray(py).reshape(shape)?)?;
    fields.set_item("range", gather(py, &returns, |row, _| range[row])?.into_pyarray(py))?;
    fields.set_item("true_range", gather(py, &returns, |row, _| true_range[row])?.into_pyarray(py))?;
    fields.set_item("intensity", gather(py, &returns, |row, _| intensity[row])?.into_pyarray(py))?;
    fields.set_item("time", gather(py, &returns, |_, pulse| times[pulse])?.into_pyarray(py))?;
    fields.set_item("ring", gather(py, &returns, |_, pulse| rings[pulse])?.into_pyarray(py))?;
    fields.set_item("column", gather(py, &returns, |_, pulse| columns[pulse])?.into_pyarray(py))?;
    fields.set_item(
        "return_number",
        gather(py, &returns, |row, pulse| (row - pulse * most + 1) as u8)?.into_pyarray(py),
    )?;
    fields.set_item("return_count", gather(py, &returns, |_, pulse| counts[pulse])?.into_pyarray(py))?;
    fields.set_item("object_id", gather(py, &returns, |row, _| object_id[row])?.into_pyarray(py))?;
    fields.set_item("label", gather(py, &returns, |row, _| label[row])?.into_pyarray(py))?;
    fields.set_item("normal", gather(py, &returns, turn)?.into_flattened().into_pyarray(py).reshape(shape)?)?;
    fields.set_item("incidence", gather(py, &returns, |row, _| incidence[row])?.into_pyarray(py))?;
    fields.set_item("range_error", gather(py, &returns, |row, _| range_error[row])?.into_pyarray(py))?;
    Ok(fields)
}

/// The elements of a C-contiguous array that has so many.
fn column<'a, T: Element, D: Dimension>(n: usize, array: &'a PyReadonlyArray<'_, T, D>) -> PyResult<&'a [T]> {
    of_length(n, elements("scan", array)?)
}

fn of_length<T>(n: usize, slice: &[T]) -> PyResult<&[T]> {
    if slice.len() == n { Ok(slice) } else { Err(PyValueError::new_err("scan: expected arrays as a scan gives them")) }
}

/// A value of each return, by its row and its pulse.
fn gather<T: Send>(py: Python<'_>, returns: &ReturnRows, value: impl Fn(usize, usize) -> T + Sync) -> PyResult<Vec<T>> {
    let value = &value;
    detached(py, || {
        let mut values = memory::with_capacity(returns.count());
        returns.gather(&mut values.spare_capacity_mut()[..returns.count()], value);
        // SAFETY: the place of each return was written.
        unsafe { values.set_len(returns.count()) };
        values
    })
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
