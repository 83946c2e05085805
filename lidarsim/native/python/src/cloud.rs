//! Point clouds: one call, from the arrays of a scan to those of a cloud.

use lidarsim_core::measure::{
    Coordinates, Copied, Each, Field, Numbers, Origins, Placing, PointsAndNormals, ReturnCounts,
};
use lidarsim_core::{Path, Point, memory};
use numpy::ndarray::Dimension;
use numpy::{
    Element, IntoPyArray, PyArrayMethods, PyReadonlyArray, PyReadonlyArray1, PyReadonlyArray2, PyReadonlyArray3,
    PyUntypedArrayMethods,
};
use pyo3::exceptions::PyValueError;
use pyo3::prelude::*;
use pyo3::types::PyDict;

use crate::{Points, PyPath, detached, elements, level, points};

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
    instance: PyReadonlyArray2<'py, u32>,
    label: PyReadonlyArray2<'py, u32>,
    radial_velocity: Option<PyReadonlyArray2<'py, f32>>,
    return_count: PyReadonlyArray1<'py, u8>,
}

#[derive(FromPyObject)]
struct AllPulseArrays<'py> {
    directions: Points<'py>,
    origins: Points<'py>,
    #[pyo3(attribute("_origin"))]
    origin: Option<Point>,
    time: PyReadonlyArray1<'py, f64>,
    ring: PyReadonlyArray1<'py, u16>,
    column: PyReadonlyArray1<'py, u32>,
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
    let origins = pulses.origin.map_or(Origins::Each(origins), Origins::One);
    let (times, rings) = (column(n, &pulses.time)?, column(n, &pulses.ring)?);
    let columns_of = column(n, &pulses.column)?;
    let counts = column(n, &scan.return_count)?;
    let (range, true_range) = (column(n * most, &scan.range)?, column(n * most, &scan.true_range)?);
    let (range_error, intensity) = (column(n * most, &scan.range_error)?, column(n * most, &scan.intensity)?);
    let (incidence, object_id) = (column(n * most, &scan.incidence)?, column(n * most, &scan.object_id)?);
    let (instance, label) = (column(n * most, &scan.instance)?, column(n * most, &scan.label)?);
    let normals: &[[f32; 3]] = of_length(n * most, column(n * most * 3, &scan.normal)?.as_chunks().0)?;

    let (start, level) = (scan.time, level(py)?);
    let placing = Placing { origins, directions, range, normals, path, times, start, coordinates };
    let mut columns: Vec<Box<dyn Column + '_>> = vec![
        of_each("range", Each::Row(range)),
        of_each("true_range", Each::Row(true_range)),
        of_each("range_error", Each::Row(range_error)),
        of_each("intensity", Each::Row(intensity)),
        of_each("incidence", Each::Row(incidence)),
        of_each("object_id", Each::Row(object_id)),
        of_each("instance", Each::Row(instance)),
        of_each("label", Each::Row(label)),
        of_each("time", Each::Pulse(times)),
        of_each("ring", Each::Pulse(rings)),
        of_each("column", Each::Pulse(columns_of)),
        of_each("return_count", Each::Pulse(counts)),
    ];
    if let Some(velocity) = &scan.radial_velocity {
        columns.push(of_each("radial_velocity", Each::Row(column(n * most, velocity)?)));
    }
    let (xyz, normal, number) = detached(py, || {
        let returns = ReturnCounts::new(counts, most, level);
        let count = returns.count();
        let (mut xyz, mut normal, mut number) =
            (memory::with_capacity(3 * count), memory::with_capacity(3 * count), memory::with_capacity(count));
        let (points, normals) =
            (&mut xyz.spare_capacity_mut()[..3 * count], &mut normal.spare_capacity_mut()[..3 * count]);
        let mut fields: Vec<Box<dyn Field<'_> + '_>> = vec![
            Box::new(PointsAndNormals { points, normals, placing }),
            Box::new(Numbers(&mut number.spare_capacity_mut()[..count])),
        ];
        fields.extend(columns.iter_mut().map(|column| column.field(count)));
        returns.write(&mut fields);
        drop(fields);
        // SAFETY: the places of all returns were written, or this had unwound.
        unsafe {
            xyz.set_len(3 * count);
            normal.set_len(3 * count);
            number.set_len(count);
            columns.iter_mut().for_each(|column| column.are_written(count));
        }
        (xyz, normal, number)
    })?;
    let fields = PyDict::new(py);
    let shape = [number.len(), 3];
    fields.set_item("xyz", xyz.into_pyarray(py).reshape(shape)?)?;
    fields.set_item("normal", normal.into_pyarray(py).reshape(shape)?)?;
    fields.set_item("return_number", number.into_pyarray(py))?;
    columns.into_iter().try_for_each(|column| column.put_in(&fields))?;
    Ok(fields)
}

/// A field of a cloud that is copied from a scan.
trait Column: Send {
    /// Takes the places of so many returns.
    fn field(&mut self, count: usize) -> Box<dyn Field<'_> + '_>;

    /// # Safety
    ///
    /// The places of so many returns must have been written.
    unsafe fn are_written(&mut self, count: usize);

    fn put_in(self: Box<Self>, fields: &Bound<'_, PyDict>) -> PyResult<()>;
}

struct OfEach<'a, T> {
    name: &'static str,
    each: Each<'a, T>,
    values: Vec<T>,
}

fn of_each<'a, T: Copy + Element + Sync>(name: &'static str, each: Each<'a, T>) -> Box<dyn Column + 'a> {
    Box::new(OfEach { name, each, values: Vec::new() })
}

impl<T: Copy + Element + Sync> Column for OfEach<'_, T> {
    fn field(&mut self, count: usize) -> Box<dyn Field<'_> + '_> {
        self.values = memory::with_capacity(count);
        Box::new(Copied { places: &mut self.values.spare_capacity_mut()[..count], each: self.each })
    }

    unsafe fn are_written(&mut self, count: usize) {
        // SAFETY: there is capacity for as many, and the caller has written them.
        unsafe { self.values.set_len(count) };
    }

    fn put_in(self: Box<Self>, fields: &Bound<'_, PyDict>) -> PyResult<()> {
        fields.set_item(self.name, self.values.into_pyarray(fields.py()))
    }
}

/// The elements of a C-contiguous array that has so many.
fn column<'a, T: Element, D: Dimension>(n: usize, array: &'a PyReadonlyArray<'_, T, D>) -> PyResult<&'a [T]> {
    of_length(n, elements("scan", array)?)
}

fn of_length<T>(n: usize, slice: &[T]) -> PyResult<&[T]> {
    if slice.len() == n { Ok(slice) } else { Err(PyValueError::new_err("scan: expected arrays as a scan gives them")) }
}
