//! Point clouds: one call takes the arrays of a scan to those of a cloud.

use lidarsim_core::measure::{
    Coordinates, Copied, Each, Field, MoverPoses, Numbers, PointSource, PointsAndNormals, ReturnCounts,
    WritePoints,
};
use lidarsim_core::{Path, Pose, memory};
use numpy::ndarray::Dimension;
use numpy::{
    Element, IntoPyArray, PyArrayMethods, PyReadonlyArray, PyReadonlyArray1, PyReadonlyArray2,
    PyReadonlyArray3, PyReadonlyArrayDyn, PyUntypedArrayMethods,
};
use pyo3::exceptions::PyValueError;
use pyo3::prelude::*;
use pyo3::types::PyDict;

use crate::scan::{PulseArrays, Pulses};
use crate::{PyPath, PyScene, detach, elements, kernels};

macro_rules! copied {
    (own, $columns:ident, $scan:ident, $wanted:ident, $name:ident: $Entry:ty) => {};
    (copied, $columns:ident, $scan:ident, $wanted:ident, $name:ident: $Entry:ty) => {
        let name = stringify!($name);
        if $wanted.has(name)
            && let Some(array) = $scan.getattr(name)?.extract::<Option<PyReadonlyArrayDyn<'_, $Entry>>>()?
        {
            $columns.push(Box::new(ScanColumn { name, array }));
        }
    };
}

macro_rules! columns {
    (
        of_echoes { $($(#[$_a:meta])* $echo:ident: $Echo:ty = $_n:expr, $_x:ident, $of_echo:ident;)+ }
        of_rays { $($(#[$_b:meta])* $ray:ident: $Ray:ty = $_m:expr, $_y:ident, $of_ray:ident;)+ }
        of_pulses $_pulses:tt
    ) => {
        /// The wanted columns of a scan that a cloud copies. Some may be absent.
        fn copied_columns<'py>(
            scan: &Bound<'py, PyAny>,
            wanted: &Wanted,
        ) -> PyResult<Vec<Box<dyn Source + 'py>>> {
            let mut columns: Vec<Box<dyn Source>> = Vec::new();
            $(copied!($of_echo, columns, scan, wanted, $echo: $Echo);)+
            $(copied!($of_ray, columns, scan, wanted, $ray: $Ray);)+
            Ok(columns)
        }
    };
}

lidarsim_core::scan_columns!(columns);

/// Names of fields; `None` for all.
struct Wanted(Option<Vec<String>>);

impl Wanted {
    fn has(&self, name: &str) -> bool {
        self.0.as_ref().is_none_or(|names| names.iter().any(|wanted| wanted == name))
    }
}

/// A column of a scan, of any type.
trait Source {
    /// The field of a cloud that copies it. `rows` is the number of entries.
    fn field(&self, rows: usize) -> PyResult<Box<dyn Column + '_>>;
}

struct ScanColumn<'py, T: Element> {
    name: &'static str,
    array: PyReadonlyArrayDyn<'py, T>,
}

impl<T: Copy + Element + Sync> Source for ScanColumn<'_, T> {
    fn field(&self, rows: usize) -> PyResult<Box<dyn Column + '_>> {
        Ok(of_each(self.name, Each::Row(column(rows, &self.array)?)))
    }
}

/// The attributes of `lidarsim.Scan` that a point cloud is computed from.
#[derive(FromPyObject)]
struct ScanArrays<'py> {
    pulses: Bound<'py, PyAny>,
    time: f64,
    range: PyReadonlyArray2<'py, f64>,
    normal: PyReadonlyArray3<'py, f32>,
    return_count: PyReadonlyArray1<'py, u8>,
}

/// The fields of `lidarsim.PointCloud`, one entry per return. `frame` is "sensor" or "world". `moment` is the
/// time, on the clock of the path, whose sensor frame all points use; `None` for raw points. `fields` are the
/// names of those to compute besides "xyz", of which a scan may lack some; `None` for all. `movers` are a
/// scene, the object of each row, negative where its point stays, and a moment: points on moving objects are
/// moved to where they are on these at that moment.
#[pyfunction]
pub fn points_of<'py>(
    py: Python<'py>,
    scan: &Bound<'py, PyAny>,
    path: &PyPath,
    frame: &str,
    moment: Option<f64>,
    fields: Option<Vec<String>>,
    movers: Option<(PyRef<'py, PyScene>, PyReadonlyArray2<'py, i32>, f64)>,
) -> PyResult<Bound<'py, PyDict>> {
    let wanted = Wanted(fields);
    let copied = copied_columns(scan, &wanted)?;
    let scan: ScanArrays = scan.extract()?;
    let path: &Path = &path.path;
    let coordinates = match (frame, path, moment) {
        ("world", ..) => Coordinates::World,
        ("sensor", Path::Still(_), _) | ("sensor", _, None) => Coordinates::Sensor,
        ("sensor", _, Some(time)) => Coordinates::Moment(path.at(time)),
        _ => return Err(PyValueError::new_err(format!("frame: unknown {frame:?}"))),
    };
    let pulses: PulseArrays = scan.pulses.extract()?;
    let columns_of: PyReadonlyArray1<'_, u32> = scan.pulses.getattr("column")?.extract()?;
    let (n, most) = (scan.return_count.len(), scan.range.shape()[1]);
    let Pulses { directions, origins, times, rings } = pulses.slices()?;
    of_length(n, directions)?;
    let (columns_of, counts) = (column(n, &columns_of)?, column(n, &scan.return_count)?);
    let range = column(n * most, &scan.range)?;
    let normals: &[[f32; 3]] = of_length(n * most, column(n * most * 3, &scan.normal)?.as_chunks().0)?;

    let frame = match coordinates {
        Coordinates::World => {
            Pose::from_rows([[1.0, 0.0, 0.0, 0.0], [0.0, 1.0, 0.0, 0.0], [0.0, 0.0, 1.0, 0.0]])
        }
        Coordinates::Moment(pose) => pose,
        Coordinates::Sensor => path.at(scan.time),
    };
    let motions = movers.as_ref().map(|(scene, _, moment)| {
        let with_pose = |motion| (motion, Path::at(motion, *moment).relative_to(&frame));
        memory::collect(scene.scene.objects().iter().map(|object| object.motion().map(with_pose)))
    });
    let movers = match (&movers, &motions) {
        (Some((_, objects, _)), Some(motions)) => {
            let objects = column(n * most, objects)?;
            if objects.iter().any(|object| *object >= motions.len() as i32) {
                return Err(PyValueError::new_err("movers: expected objects of the scene"));
            }
            Some(MoverPoses { objects, motions, frame })
        }
        _ => None,
    };
    let (start, kernels) = (scan.time, kernels(py)?);
    let source = PointSource { origins, directions, range, normals, path, times, start, coordinates, movers };
    let mut columns = copied.iter().map(|source| source.field(n * most)).collect::<PyResult<Vec<_>>>()?;
    let of_pulses = [
        of_each("time", Each::Pulse(times)),
        of_each("ring", Each::Pulse(rings)),
        of_each("column", Each::Pulse(columns_of)),
        of_each("return_count", Each::Pulse(counts)),
    ];
    columns.extend(of_pulses.into_iter().filter(|column| wanted.has(column.name())));
    let [with_normals, with_numbers] = ["normal", "return_number"].map(|name| wanted.has(name));
    let write_points = |points: WritePoints| kernels.write_points(points);
    let (xyz, normal, number) = detach(py, || {
        let returns = ReturnCounts::new(counts, most);
        let count = returns.count();
        let of = |count, is_wanted| if is_wanted { count } else { 0 };
        let (normal_count, number_count) = (of(3 * count, with_normals), of(count, with_numbers));
        let (mut xyz, mut normal, mut number) = (
            memory::with_capacity(3 * count),
            memory::with_capacity(normal_count),
            memory::with_capacity(number_count),
        );
        let (points, normals) =
            (&mut xyz.spare_capacity_mut()[..3 * count], &mut normal.spare_capacity_mut()[..normal_count]);
        let mut fields: Vec<Box<dyn Field<'_> + '_>> =
            vec![Box::new(PointsAndNormals { points, normals, source, write: &write_points })];
        if with_numbers {
            fields.push(Box::new(Numbers(&mut number.spare_capacity_mut()[..count])));
        }
        fields.extend(columns.iter_mut().map(|column| column.field(count)));
        returns.write(&mut fields);
        drop(fields);
        // SAFETY: the places of all returns were written; otherwise this would have unwound.
        unsafe {
            xyz.set_len(3 * count);
            normal.set_len(normal_count);
            number.set_len(number_count);
            columns.iter_mut().for_each(|column| column.are_written(count));
        }
        (xyz, normal, number)
    })?;
    let fields = PyDict::new(py);
    let shape = [xyz.len() / 3, 3];
    fields.set_item("xyz", xyz.into_pyarray(py).reshape(shape)?)?;
    if with_normals {
        fields.set_item("normal", normal.into_pyarray(py).reshape(shape)?)?;
    }
    if with_numbers {
        fields.set_item("return_number", number.into_pyarray(py))?;
    }
    columns.into_iter().try_for_each(|column| column.put_in(&fields))?;
    Ok(fields)
}

/// A field of a cloud that copies a column of a scan.
trait Column: Send {
    fn name(&self) -> &'static str;

    /// Reserves the places of `count` returns.
    fn field(&mut self, count: usize) -> Box<dyn Field<'_> + '_>;

    /// # Safety
    ///
    /// The places of `count` returns must have been written.
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
    fn name(&self) -> &'static str {
        self.name
    }

    fn field(&mut self, count: usize) -> Box<dyn Field<'_> + '_> {
        self.values = memory::with_capacity(count);
        Box::new(Copied { places: &mut self.values.spare_capacity_mut()[..count], each: self.each })
    }

    unsafe fn are_written(&mut self, count: usize) {
        // SAFETY: there is capacity for `count` values, and the caller has written them.
        unsafe { self.values.set_len(count) };
    }

    fn put_in(self: Box<Self>, fields: &Bound<'_, PyDict>) -> PyResult<()> {
        fields.set_item(self.name, self.values.into_pyarray(fields.py()))
    }
}

/// The elements of a C-contiguous array of n entries.
fn column<'a, T: Element, D: Dimension>(n: usize, array: &'a PyReadonlyArray<'_, T, D>) -> PyResult<&'a [T]> {
    of_length(n, elements("scan", array)?)
}

fn of_length<T>(n: usize, slice: &[T]) -> PyResult<&[T]> {
    if slice.len() == n {
        Ok(slice)
    } else {
        Err(PyValueError::new_err("scan: expected arrays as a scan gives them"))
    }
}
