//! Scans: one call per frame takes pulses to the arrays of a scan.

use std::sync::{Arc, Mutex, PoisonError};

use lidarsim_core::measure::rng::{self, Stream};
use lidarsim_core::measure::{
    BadPulse, Fault, Frame, Layout, LightTransport, Measurement, Parameters, Scan, ScanColumns, Value,
};
use lidarsim_core::{Origins, Path, Point, memory, span};
use numpy::{
    Element, IntoPyArray, PyArray1, PyArray2, PyArrayDescr, PyArrayMethods, PyReadonlyArray1,
    PyReadonlyArray2,
};
use pyo3::exceptions::PyValueError;
use pyo3::intern;
use pyo3::prelude::*;
use pyo3::types::{PyDict, PyTuple};

use crate::{Points, PyPath, PyScene, argument_error, detach, elements, into_array, kernels, points};

/// The attributes of a `lidarsim.Lidar`; below `atmosphere`, those of a `lidarsim.Atmosphere`, if there is
/// one.
struct Attributes<'a, 'py>(&'a Bound<'py, PyAny>, Option<&'a Bound<'py, PyAny>>);

impl Parameters for Attributes<'_, '_> {
    type Error = PyErr;

    fn value(&self, name: &'static str) -> PyResult<Value> {
        let (mut value, path) = match (name.strip_prefix("atmosphere."), self.1) {
            (None, _) => (self.0.clone(), name),
            (Some(path), Some(atmosphere)) => (atmosphere.clone(), path),
            (Some(_), None) => return Ok(Value::Nothing),
        };
        for part in path.split('.') {
            if value.is_none() {
                break;
            }
            value = value.getattr(part)?;
        }
        if value.is_none() {
            return Ok(Value::Nothing);
        }
        let value: AnyValue = value.extract()?;
        Ok(match value {
            AnyValue::Number(number) => Value::Number(number),
            AnyValue::Text(text) => Value::Text(text),
            AnyValue::Numbers(numbers) => Value::Numbers(numbers),
            AnyValue::Rows(rows) => Value::Rows(rows),
        })
    }

    fn unexpected(&self, name: &'static str, value: Value) -> PyErr {
        PyValueError::new_err(format!("{name}: unexpected {value:?}"))
    }
}

#[derive(FromPyObject)]
enum AnyValue {
    Number(f64),
    Text(String),
    Numbers(Vec<f64>),
    Rows(Vec<[f64; 2]>),
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

/// The same arrays, checked to be of equal length.
pub struct Pulses<'a> {
    pub directions: &'a [Point],
    pub origins: Origins<'a>,
    pub times: &'a [f64],
    pub rings: &'a [u16],
}

impl PulseArrays<'_> {
    pub fn slices(&self) -> PyResult<Pulses<'_>> {
        let (directions, origins) =
            (points("pulses.directions", &self.directions)?, points("pulses.origins", &self.origins)?);
        let (times, rings) = (elements("pulses.time", &self.time)?, elements("pulses.ring", &self.ring)?);
        if [origins.len(), times.len(), rings.len()] != [directions.len(); 3] {
            let [d, o, t, r] = [directions.len(), origins.len(), times.len(), rings.len()];
            let got = format!("{d}, {o}, {t} and {r}");
            return Err(argument_error("pulses", "directions, origins, time and ring of equal length", got));
        }
        let origins = self.origin.map_or(Origins::Each(origins), Origins::One);
        Ok(Pulses { directions, origins, times, rings })
    }
}

/// The type of the entries of a column.
pub trait Entry: Copy {
    type Number: Element;
    /// The shape of an entry.
    const SHAPE: &'static [usize];

    /// The column as an array, of a shape that ends with that of an entry.
    fn array<'py>(py: Python<'py>, column: Vec<Self>, shape: &[usize]) -> PyResult<Bound<'py, PyAny>>;
}

macro_rules! entries {
    ($($number:ident),+) => {
        $(impl Entry for $number {
            type Number = $number;
            const SHAPE: &'static [usize] = &[];

            fn array<'py>(
                py: Python<'py>,
                column: Vec<Self>,
                shape: &[usize],
            ) -> PyResult<Bound<'py, PyAny>> {
                into_array(py, column, shape)
            }
        })+
    };
}

entries!(f64, f32, i32, u32, u8);

impl<T: Element + Copy> Entry for [T; 3] {
    type Number = T;
    const SHAPE: &'static [usize] = &[3];

    fn array<'py>(py: Python<'py>, column: Vec<Self>, shape: &[usize]) -> PyResult<Bound<'py, PyAny>> {
        into_array(py, column.into_flattened(), &[shape, Self::SHAPE].concat())
    }
}

macro_rules! arrays {
    (
        of_echoes { $($(#[$_a:meta])* $echo:ident: $Echo:ty = $no_echo:expr, $has_echo:ident, $_e:ident;)+ }
        of_rays { $($(#[$_b:meta])* $ray:ident: $Ray:ty = $no_ray:expr, $has_ray:ident, $_r:ident;)+ }
        of_pulses {
            $($(#[$_c:meta])* $pulse:ident: $Pulse:ty = $no_pulse:expr, $has_pulse:ident, $_p:ident;)+
        }
    ) => {
        /// The columns of a scan by name, without those absent from the layout.
        fn arrays(py: Python<'_>, columns: ScanColumns) -> PyResult<Bound<'_, PyDict>> {
            let (layout, arrays) = (columns.layout, PyDict::new(py));
            let (pulses, rows) = ([layout.pulses], [layout.pulses, layout.most]);
            $(if layout.$has_echo(1) > 0 {
                arrays.set_item(intern!(py, stringify!($echo)), Entry::array(py, columns.$echo, &rows)?)?;
            })+
            $(if layout.$has_ray(1) > 0 {
                arrays.set_item(intern!(py, stringify!($ray)), Entry::array(py, columns.$ray, &rows)?)?;
            })+
            $(if layout.$has_pulse(1) > 0 {
                arrays.set_item(intern!(py, stringify!($pulse)), Entry::array(py, columns.$pulse, &pulses)?)?;
            })+
            Ok(arrays)
        }

        /// The columns of a scan by name: dtype, shape of an entry, whether there is one per return, and the
        /// value of unused entries.
        #[pyfunction]
        pub fn scan_columns(py: Python<'_>) -> PyResult<Bound<'_, PyDict>> {
            let table = PyDict::new(py);
            $(table.set_item(stringify!($echo), describe::<$Echo>(py, true, $no_echo)?)?;)+
            $(table.set_item(stringify!($ray), describe::<$Ray>(py, true, $no_ray)?)?;)+
            $(table.set_item(stringify!($pulse), describe::<$Pulse>(py, false, $no_pulse)?)?;)+
            Ok(table)
        }
    };
}

lidarsim_core::scan_columns!(arrays);

type Described<'py> = (Bound<'py, PyArrayDescr>, Bound<'py, PyAny>, bool, Bound<'py, PyAny>);

fn describe<'py, T: Entry>(py: Python<'py>, of_returns: bool, unused: T) -> PyResult<Described<'py>> {
    let shape = PyTuple::new(py, T::SHAPE)?.into_any();
    Ok((numpy::dtype::<T::Number>(py), shape, of_returns, T::array(py, vec![unused], &[])?))
}

/// The measurement of a `lidarsim.Lidar`, made once from its attributes, and that in the last atmosphere.
#[pyclass(frozen, name = "Receiver", module = "lidarsim._native")]
pub struct PyReceiver {
    in_clear_air: Arc<Measurement>,
    in_air: Mutex<Option<(Py<PyAny>, Arc<Measurement>)>>,
}

#[pymethods]
impl PyReceiver {
    #[new]
    fn new(lidar: &Bound<'_, PyAny>) -> PyResult<Self> {
        Ok(PyReceiver { in_clear_air: make_measurement(lidar, None)?, in_air: Mutex::new(None) })
    }
}

impl PyReceiver {
    /// The measurement in an atmosphere. Neither this nor the lidar changes.
    fn in_air(&self, lidar: &Bound<'_, PyAny>, air: &Bound<'_, PyAny>) -> PyResult<Arc<Measurement>> {
        // The mutex is not held while Python runs, which may let another thread come here.
        let last = || self.in_air.lock().unwrap_or_else(PoisonError::into_inner);
        if let Some((of, kept)) = &*last()
            && of.is(air)
        {
            return Ok(kept.clone());
        }
        let measurement = make_measurement(lidar, Some(air))?;
        let before = last().replace((air.clone().unbind(), measurement.clone()));
        drop(before); // after the lock, as an atmosphere may be deleted with it
        Ok(measurement)
    }
}

fn make_measurement(lidar: &Bound<'_, PyAny>, air: Option<&Bound<'_, PyAny>>) -> PyResult<Arc<Measurement>> {
    Ok(Arc::new(Measurement::from_parameters(&Attributes(lidar, air))?))
}

/// The measurement that a lidar keeps, in clear air or an atmosphere, or one made from their attributes.
pub fn measurement_of<'py>(
    lidar: &Bound<'py, PyAny>,
    atmosphere: Option<&Bound<'py, PyAny>>,
) -> PyResult<Arc<Measurement>> {
    let Some(kept) = lidar.getattr_opt(intern!(lidar.py(), "_receiver"))? else {
        return make_measurement(lidar, atmosphere);
    };
    let kept: &Bound<'_, PyReceiver> = kept.cast()?;
    match atmosphere {
        Some(air) => kept.get().in_air(lidar, air),
        None => Ok(kept.get().in_clear_air.clone()),
    }
}

/// Raises MemoryError if a scan of this many pulses does not fit into memory.
#[pyfunction]
#[pyo3(signature = (pulses, lidar, atmosphere=None))]
pub fn expect_room<'py>(
    py: Python<'py>,
    pulses: usize,
    lidar: &Bound<'py, PyAny>,
    atmosphere: Option<&Bound<'py, PyAny>>,
) -> PyResult<()> {
    let measurement = measurement_of(lidar, atmosphere)?;
    detach(py, || ScanColumns::expect_room(layout(&measurement, pulses)))
}

/// The layout of a scan of a scene that neither moves nor has a mirror.
fn layout(measurement: &Measurement, pulses: usize) -> Layout {
    Layout {
        pulses,
        most: measurement.most_returns(),
        strays: measurement.strays(),
        moves: false,
        tells_sources: measurement.tells_sources(),
        goes_on: measurement.depth() > 1,
        mirrors: false,
    }
}

/// The light that goes on behind the first surfaces, in a span of time; None if there is none.
pub fn transport_of<'a>(
    scene: &'a PyScene,
    measurement: &Measurement,
    span: [f64; 2],
    ignored: &'a [u32],
) -> Option<LightTransport<'a>> {
    let depth = measurement.depth();
    let goes_on = depth > 1 && scene.appearances.iter().any(|appearance| appearance.goes_on());
    goes_on.then(|| {
        let [passing, solid] = scene.parts(span).map(|part| part.ignoring(ignored));
        LightTransport { depth, passing, solid }
    })
}

/// The time that a frame takes; irrelevant, so zero, if nothing moves.
pub fn span_of(scene: &PyScene, frame: &Frame) -> [f64; 2] {
    let span = if scene.scene.moves() { span(frame.times) } else { [0.0; 2] };
    // Rounding preserves the order of times; times that overflow are refused.
    span.map(|time| (frame.start + time).clamp(f64::MIN, f64::MAX))
}

/// Pulses to be fired, as Python has them.
pub struct Shot<'a, 'py> {
    pub scene: &'a PyScene,
    pub path: &'a PyPath,
    pub pulses: PulseArrays<'py>,
    /// The pulses' indices in the whole frame, unless they are all of it, in order.
    pub indices: Option<PyReadonlyArray1<'py, u64>>,
    pub start: f64,
    /// Seed, sensor and frame.
    pub draws: (u64, u32, u32),
    /// Instances that are not seen.
    pub ignored: Option<PyReadonlyArray1<'py, i64>>,
}

impl Shot<'_, '_> {
    /// Does `work`, which fires them.
    pub fn fire<R: Send>(
        &self,
        py: Python<'_>,
        measurement: &Measurement,
        work: impl FnOnce(&Scan) -> Result<R, BadPulse> + Send,
    ) -> PyResult<R> {
        let Pulses { directions, origins, times, rings } = self.pulses.slices()?;
        let indices = self.indices.as_ref().map(|indices| elements("indices", indices)).transpose()?;
        let (scene, start) = (self.scene, self.start);
        let ignored = scene.objects_to_ignore(self.ignored.as_ref())?;
        check_rings(rings, measurement)?;
        let stream = Stream::new(self.draws.0, self.draws.1, self.draws.2);
        let frame =
            Frame { origins, directions, times, rings, indices, start, path: &self.path.path, stream };
        let done = detach(py, || {
            scene.scene.prepare();
            let span = span_of(scene, &frame);
            let world = scene.scene.during(span);
            let world = world.ignoring(&ignored);
            let transport = transport_of(scene, measurement, span, &ignored);
            let appearances = &scene.appearances;
            work(&Scan { frame: &frame, measurement, appearances, world: &world, transport })
        })?;
        done.map_err(|bad| explain(bad, &frame))
    }
}

/// Fires the pulses of a frame and measures the returns: the arrays of `lidarsim.Scan`, of shape (n, most).
///
/// `indices` are the pulses' indices in the whole frame, unless they are all of it, in order. `draws` are
/// seed, sensor and frame.
#[pyfunction]
#[pyo3(signature = (scene, path, pulses, indices, lidar, start, draws, atmosphere=None, ignored=None))]
#[expect(clippy::too_many_arguments, reason = "one call a scan")]
pub fn scan<'py>(
    py: Python<'py>,
    scene: &PyScene,
    path: &PyPath,
    pulses: PulseArrays<'py>,
    indices: Option<PyReadonlyArray1<'py, u64>>,
    lidar: &Bound<'py, PyAny>,
    start: f64,
    draws: (u64, u32, u32),
    atmosphere: Option<&Bound<'py, PyAny>>,
    ignored: Option<PyReadonlyArray1<'py, i64>>,
) -> PyResult<Bound<'py, PyDict>> {
    let measurement = measurement_of(lidar, atmosphere)?;
    let moves = scene.scene.moves() || !matches!(*path.path, Path::Still(_));
    let has_mirror = scene.appearances.iter().any(|appearance| appearance.mirror > 0.0);
    let mirrors = measurement.depth() > 1 && has_mirror;
    let layout = Layout { moves, mirrors, ..layout(&measurement, pulses.slices()?.directions.len()) };
    let kernels = kernels(py)?;
    let shot = Shot { scene, path, pulses, indices, start, draws, ignored };
    let columns = shot.fire(py, &measurement, |scan| {
        let mut columns = ScanColumns::new(layout);
        scan.measure(&mut columns.rows(), |batch| kernels.measure(batch))?;
        // SAFETY: all pulses were measured and none was bad, so all entries were written.
        unsafe { columns.assume_written() };
        Ok(columns)
    })?;
    arrays(py, columns)
}

/// The echoes of an atmosphere in front of no surface: range and power of the mean one of fog, if there is
/// one, and how many patches of fog, and how many drops or flakes, of a pulse are seen on average.
#[pyfunction]
pub fn air_echoes<'py>(
    lidar: &Bound<'py, PyAny>,
    atmosphere: &Bound<'py, PyAny>,
) -> PyResult<(Option<[f64; 2]>, [f64; 2])> {
    let measurement = measurement_of(lidar, Some(atmosphere))?;
    Ok((measurement.fog_echo(), measurement.spots_seen()))
}

/// Checks that each ring of the pulses has what rings have of their own in a measurement.
pub fn check_rings(rings: &[u16], measurement: &Measurement) -> PyResult<()> {
    for (name, known) in measurement.rings() {
        if let Some(i) = rings.iter().position(|ring| usize::from(*ring) >= known) {
            let got = format!("{known} of them and pulses.ring[{i}] = {}", rings[i]);
            return Err(argument_error(name, "a number for each ring of the pulses", got));
        }
    }
    Ok(())
}

pub fn explain(BadPulse { pulse: i, fault }: BadPulse, frame: &Frame) -> PyErr {
    match fault {
        Fault::Direction => {
            let [x, y, z] = frame.directions[i];
            let got = format!("pulses.directions[{i}] = ({x}, {y}, {z})");
            argument_error("pulses.directions", "unit vectors", got)
        }
        Fault::Origin => {
            let [x, y, z] = frame.origins.of(i);
            let got = format!("pulses.origins[{i}] = ({x}, {y}, {z})");
            argument_error("pulses.origins", "finite numbers", got)
        }
        Fault::Time => {
            let ([first, last], time) = (frame.path.span(), frame.start + frame.times[i]);
            let pulse = frame.indices.map_or(i as u64, |indices| indices[i]);
            let got = format!("one from {first} to {last} s and pulse {pulse} at {time} s");
            argument_error("pose", "a trajectory over all pulses", got)
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
    let words = detach(py, || memory::collect(counters.iter().map(|&counter| rng::philox(counter, key))))?;
    words.into_flattened().into_pyarray(py).reshape([counters.len(), 4])
}

/// The quantile function of the normal distribution.
#[pyfunction]
pub fn normal_quantile<'py>(
    py: Python<'py>,
    p: PyReadonlyArray1<'py, f64>,
) -> PyResult<Bound<'py, PyArray1<f64>>> {
    let p = elements("p", &p)?;
    Ok(detach(py, || memory::collect(p.iter().map(|&p| rng::normal_quantile(p))))?.into_pyarray(py))
}
