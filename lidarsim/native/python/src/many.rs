//! Many scans in one call, into arrays that the caller provides.

use std::collections::HashMap;
use std::mem::MaybeUninit;
use std::sync::Arc;

use lidarsim_core::measure::{Fault, Frame, Layout, Measurement, Rows, Scan, measure_all, rng::Stream};
use lidarsim_core::{Path, Point, World, memory};
use numpy::{PyReadonlyArray1, PyReadonlyArray2, PyReadwriteArrayDyn, PyUntypedArrayMethods};
use pyo3::exceptions::PyValueError;
use pyo3::prelude::*;
use pyo3::types::PyDict;

use crate::path::{Matrix, matrices, pose};
use crate::scan::{Entry, PulseArrays, check_rings, explain, measurement_of, span_of, transport_of};
use crate::{PyPath, PyScene, argument_error, detach, elements, kernels, plain};

macro_rules! given {
    (
        of_echoes { $($(#[$_a:meta])* $echo:ident: $Echo:ty = $_n:expr, $_x:ident, $_p:ident;)+ }
        of_rays { $($(#[$_b:meta])* $ray:ident: $Ray:ty = $_m:expr, $_y:ident, $_q:ident;)+ }
        of_pulses { $($(#[$_c:meta])* $pulse:ident: $Pulse:ty = $_o:expr, $_z:ident, $_r:ident;)+ }
    ) => {
        /// The arrays of a batch that are wanted, for all rows.
        #[derive(Default)]
        struct Given<'py> {
            $($echo: Option<Column<'py, $Echo>>,)+
            $($ray: Option<Column<'py, $Ray>>,)+
            $($pulse: Option<Column<'py, $Pulse>>,)+
            xyz: Option<Column<'py, Point>>,
        }

        impl<'py> Given<'py> {
            fn new(arrays: &Bound<'py, PyDict>) -> PyResult<Self> {
                let mut given = Given::default();
                for (name, array) in arrays {
                    match name.extract::<String>()?.as_str() {
                        $(stringify!($echo) => given.$echo = Some(array.extract()?),)+
                        $(stringify!($ray) => given.$ray = Some(array.extract()?),)+
                        $(stringify!($pulse) => given.$pulse = Some(array.extract()?),)+
                        "xyz" => given.xyz = Some(array.extract()?),
                        other => return Err(PyValueError::new_err(format!("columns: unknown {other:?}"))),
                    }
                }
                Ok(given)
            }

            /// The rows of all scans, and their points. `spare` receives the ranges if points need them and
            /// nobody else does.
            fn rows<'a>(
                &'a mut self,
                layout: Layout,
                spare: &'a mut Vec<f64>,
            ) -> PyResult<(Rows<'a>, &'a mut [MaybeUninit<Point>])> {
                let (pulses, entries) = (layout.pulses, layout.pulses.saturating_mul(layout.most));
                let mut rows = Rows::none(layout);
                $(if let Some(column) = &mut self.$echo { rows.$echo = column.slots(entries)?; })+
                $(if let Some(column) = &mut self.$ray { rows.$ray = column.slots(entries)?; })+
                $(if let Some(column) = &mut self.$pulse { rows.$pulse = column.slots(pulses)?; })+
                let points = match &mut self.xyz {
                    Some(column) => column.slots(entries)?,
                    None => &mut [],
                };
                if !points.is_empty() && rows.range.is_empty() {
                    memory::reserve(spare, entries);
                    rows.range = &mut spare.spare_capacity_mut()[..entries];
                }
                Ok((rows, points))
            }
        }
    };
}

lidarsim_core::scan_columns!(given);

/// A writable array of the entries of a column.
#[derive(FromPyObject)]
#[pyo3(transparent)]
struct Column<'py, T: Entry>(PyReadwriteArrayDyn<'py, T::Number>);

impl<T: Entry> Column<'_, T> {
    fn slots(&mut self, count: usize) -> PyResult<&mut [MaybeUninit<T>]> {
        let size: usize = T::SHAPE.iter().product();
        if self.0.len() != count.saturating_mul(size) {
            let got = self.0.len();
            return Err(PyValueError::new_err(format!("columns: expected {count} entries, got {got}")));
        }
        let wrong = |_| PyValueError::new_err("columns: expected aligned, C-contiguous arrays");
        let numbers = self.0.as_slice_mut().map_err(wrong)?;
        // SAFETY: `count` entries have as many numbers, and the same alignment, as they are numbers or arrays
        // of them. Only initialized entries are written to the slots.
        Ok(unsafe { std::slice::from_raw_parts_mut(numbers.as_mut_ptr().cast(), count) })
    }
}

/// What differs between the rows of a batch.
#[derive(FromPyObject)]
pub struct RowArrays<'py> {
    /// Indices of the scene and the shot.
    scene: PyReadonlyArray1<'py, u32>,
    shot: PyReadonlyArray1<'py, u32>,
    /// Start of the frame, s.
    start: PyReadonlyArray1<'py, f64>,
    seed: PyReadonlyArray1<'py, u64>,
    frame: PyReadonlyArray1<'py, u32>,
    /// The instances that the sensor does not see, and where those of each row end, if rows differ; absent if
    /// there are none.
    ignored: Option<(PyReadonlyArray1<'py, i64>, Option<PyReadonlyArray1<'py, u64>>)>,
}

/// The pose of the sensor in each row.
#[derive(FromPyObject)]
pub enum RowPoses<'py> {
    /// Matrices, (N, 16).
    Still(PyReadonlyArray2<'py, f64>),
    Moving(Vec<PyRef<'py, PyPath>>),
}

/// The same as paths.
enum Paths {
    Still(Vec<Path>),
    Moving(Vec<Arc<Path>>),
}

impl RowPoses<'_> {
    fn paths(&self) -> PyResult<Paths> {
        Ok(match self {
            RowPoses::Moving(paths) => Paths::Moving(paths.iter().map(|path| path.path.clone()).collect()),
            RowPoses::Still(poses) => {
                let matrices = matrices("poses", poses)?.iter();
                Paths::Still(memory::collect(matrices.map(|&matrix| Path::Still(pose(matrix)))))
            }
        })
    }
}

impl Paths {
    fn len(&self) -> usize {
        match self {
            Paths::Still(paths) => paths.len(),
            Paths::Moving(paths) => paths.len(),
        }
    }

    fn of(&self, row: usize) -> &Path {
        match self {
            Paths::Still(paths) => &paths[row],
            Paths::Moving(paths) => &paths[row],
        }
    }
}

/// Fires one frame per row and writes the arrays `columns`, which have `pulses` entries per row, or `most`
/// times as many.
///
/// A shot is a sensor, the pulses of its frame, and the number that selects its noise.
#[pyfunction]
#[expect(clippy::too_many_arguments, reason = "one call a batch")]
pub fn scan_many<'py>(
    py: Python<'py>,
    scenes: Vec<PyRef<'py, PyScene>>,
    atmospheres: Vec<Option<Bound<'py, PyAny>>>,
    shots: Vec<(Bound<'py, PyAny>, PulseArrays<'py>, u32)>,
    poses: RowPoses<'py>,
    rows: RowArrays<'py>,
    pulses: usize,
    most: usize,
    columns: &Bound<'py, PyDict>,
) -> PyResult<()> {
    let paths = poses.paths()?;
    let count = paths.len();
    let (scene, shot) = (elements("scene", &rows.scene)?, elements("shot", &rows.shot)?);
    let (start, seed) = (elements("start", &rows.start)?, elements("seed", &rows.seed)?);
    let frame = elements("frame", &rows.frame)?;
    let is_within = |index: &[u32], count: usize| index.iter().all(|&i| (i as usize) < count);
    if [scene.len(), shot.len(), start.len(), seed.len(), frame.len()] != [count; 5]
        || atmospheres.len() != scenes.len()
        || !is_within(scene, scenes.len())
        || !is_within(shot, shots.len())
    {
        return Err(PyValueError::new_err(
            "rows: expected a scene, shot, start, seed and frame of each pose",
        ));
    }
    // Of each shot in the air of each scene.
    let mut measurements = Vec::new();
    let mut shot_pulses = Vec::new();
    for (lidar, arrays, _) in &shots {
        let pulses_of = arrays.slices()?;
        for atmosphere in &atmospheres {
            let measurement = measurement_of(lidar, atmosphere.as_ref())?;
            check_rings(pulses_of.rings, &measurement)?;
            if measurement.most_returns() != most || pulses_of.directions.len() > pulses {
                return Err(PyValueError::new_err("columns: expected room for all pulses and their returns"));
            }
            measurements.push(measurement);
        }
        shot_pulses.push(pulses_of);
    }
    let ignored = Ignored::new(&rows, &scenes, scene)?;
    let layout = Layout {
        pulses: count * pulses,
        most,
        strays: true,
        moves: true,
        tells_sources: true,
        goes_on: true,
        mirrors: true,
    };
    let (mut given, mut spare) = (Given::new(columns)?, Vec::new());
    let (all_rows, points) = given.rows(layout, &mut spare)?;
    let frames = memory::collect((0..count).map(|i| {
        let fired = &shot_pulses[shot[i] as usize];
        let stream = Stream::new(seed[i], shots[shot[i] as usize].2, frame[i]);
        Frame {
            origins: fired.origins,
            directions: fired.directions,
            times: fired.times,
            rings: fired.rings,
            indices: None,
            start: start[i],
            path: paths.of(i),
            stream,
        }
    }));
    let kernels = kernels(py)?;
    let scene_of: Vec<&PyScene> = scenes.iter().map(|scene| &**scene).collect();
    let outcome = detach(py, || {
        for scene in &scene_of {
            scene.scene.prepare();
        }
        let (worlds, world_of) = worlds(&scene_of, &frames, scene, shot);
        let own_worlds: Vec<World> = match &ignored {
            Ignored::Nothing => Vec::new(),
            _ => memory::collect(
                world_of.iter().enumerate().map(|(i, &w)| worlds[w].ignoring(ignored.of(i, scene[i]))),
            ),
        };
        let scans = memory::collect(frames.iter().enumerate().map(|(i, frame)| {
            let own = scene_of[scene[i] as usize];
            let measurement: &Measurement =
                &measurements[shot[i] as usize * scene_of.len() + scene[i] as usize];
            Scan {
                frame,
                measurement,
                appearances: &own.appearances,
                world: own_worlds.get(i).unwrap_or(&worlds[world_of[i]]),
                transport: transport_of(own, measurement, span_of(own, frame), ignored.of(i, scene[i])),
            }
        }));
        measure_all(&scans, pulses, all_rows, points, |batch| kernels.measure(batch))
    })?;
    outcome.map_err(|(row, bad)| match bad.fault {
        Fault::Time => {
            let ([first, last], time) = (paths.of(row).span(), start[row] + frames[row].times[bad.pulse]);
            let got = format!("one from {first} to {last} s and pulse {} at {time} s", bad.pulse);
            argument_error(&format!("poses[{row}]"), "a trajectory over all pulses", got)
        }
        _ => explain(bad, &frames[row]),
    })
}

/// The objects that rows ignore, in the scene of the row.
enum Ignored {
    Nothing,
    /// The same instances in all rows: those of each scene.
    Alike(Vec<Vec<u32>>),
    /// Those of each row.
    Each(Vec<Vec<u32>>),
}

impl Ignored {
    fn new(rows: &RowArrays, scenes: &[PyRef<PyScene>], scene: &[u32]) -> PyResult<Self> {
        let Some((instances, ends)) = &rows.ignored else { return Ok(Ignored::Nothing) };
        let instances = elements("ignore", instances)?;
        let Some(ends) = ends else {
            let objects = scenes.iter().map(|scene| scene.objects_of("ignore", instances));
            return Ok(Ignored::Alike(objects.collect::<PyResult<_>>()?));
        };
        let ends = elements("ignore", ends)?;
        if ends.len() != scene.len() {
            return Err(PyValueError::new_err("ignore: expected instances for each row"));
        }
        let (mut objects, mut first) = (memory::with_capacity(scene.len()), 0);
        for (row, (&end, &scene)) in ends.iter().zip(scene).enumerate() {
            let own = instances.get(first..end as usize);
            let own = own.ok_or_else(|| PyValueError::new_err("ignore: expected ascending ends"))?;
            objects.push(scenes[scene as usize].objects_of(&format!("ignore[{row}]"), own)?);
            first = end as usize;
        }
        Ok(Ignored::Each(objects))
    }

    /// Of a row.
    fn of(&self, row: usize, scene: u32) -> &[u32] {
        match self {
            Ignored::Nothing => &[],
            Ignored::Alike(objects) => &objects[scene as usize],
            Ignored::Each(objects) => &objects[row],
        }
    }
}

/// The worlds in which the rows take place, and the index of each row's. Rows of one scene share it if
/// nothing moves, or if they fire the same pulses at the same time.
fn worlds<'a>(
    scenes: &[&'a PyScene],
    frames: &[Frame],
    scene: &[u32],
    shot: &[u32],
) -> (Vec<World<'a>>, Vec<usize>) {
    let mut worlds = memory::with_capacity(scenes.len());
    let mut known = HashMap::new();
    let world_of = memory::collect(frames.iter().enumerate().map(|(i, frame)| {
        let (number, own) = (scene[i], &scenes[scene[i] as usize].scene);
        let moment = own.moves().then(|| (shot[i], frame.start.to_bits()));
        *known.entry((number, moment)).or_insert_with(|| {
            memory::push(&mut worlds, own.during(span_of(scenes[number as usize], frame)));
            worlds.len() - 1
        })
    }));
    (worlds, world_of)
}

/// The first of some matrices, (N, 16), whose rotation part is not orthonormal to within `tolerance`, or is a
/// reflection: its index, its distance from orthonormal, and its determinant.
#[pyfunction]
pub fn first_not_rigid(
    matrices: PyReadonlyArray2<'_, f64>,
    tolerance: f64,
) -> PyResult<Option<(usize, f64, f64)>> {
    for (i, &matrix) in self::matrices("poses", &matrices)?.iter().enumerate() {
        let (error, determinant) = rigidity(matrix);
        if !(error <= tolerance && determinant >= 0.0) {
            return Ok(Some((i, error, determinant)));
        }
    }
    Ok(None)
}

/// Whether a value is a (4, 4) float64 array of a pose that is rigid in this sense.
#[pyfunction]
pub fn is_plain_pose(value: &Bound<'_, PyAny>, tolerance: f64) -> bool {
    plain::affine(value).is_some_and(|matrix| {
        let (error, determinant) = rigidity(matrix);
        error <= tolerance && determinant >= 0.0
    })
}

/// The largest entry of |RRᵀ − I|, and the determinant, of the rotation part R.
fn rigidity([x, y, z, _]: Matrix) -> (f64, f64) {
    let [x, y, z] = [x, y, z].map(|[x, y, z, _]| [x, y, z]);
    let dot = |a: Point, b: Point| a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
    let lengths = [x, y, z].map(|row| (dot(row, row) - 1.0).abs());
    let angles = [dot(x, y), dot(y, z), dot(z, x)].map(f64::abs);
    // Unlike `f64::max`, this keeps NaN.
    let largest = lengths.into_iter().chain(angles).fold(0.0, |most, x| if x <= most { most } else { x });
    let cross = [y[1] * z[2] - y[2] * z[1], y[2] * z[0] - y[0] * z[2], y[0] * z[1] - y[1] * z[0]];
    (largest, dot(x, cross))
}
