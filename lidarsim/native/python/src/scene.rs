//! Scenes, and casts of rays at them.

use std::sync::{Arc, OnceLock};

use lidarsim_core::measure::Appearance;
use lidarsim_core::{
    Arrays, Columns, HitRows, Index, Kernels, Occlusion, Once, Point, Rays, Scene, TRange, World, cast_all,
    memory, span,
};
use numpy::{PyArray1, PyArray2, PyArrayMethods, PyReadonlyArray1};
use pyo3::exceptions::PyValueError;
use pyo3::prelude::*;
use pyo3::types::PyList;

use crate::{
    Points, PySceneObject, PyShape, argument_error, detach, elements, equal_points, kernels, legal_rays, rays,
};

type HitArrays<'py> = (
    Bound<'py, PyArray1<f64>>,
    Bound<'py, PyArray1<i32>>,
    Bound<'py, PyArray1<i32>>,
    Bound<'py, PyArray2<f64>>,
);

/// Most unknown instances that an error names.
const NAMED: usize = 8;

/// Size of a hit, bytes.
const HIT: usize = size_of::<f64>() + 2 * size_of::<i32>() + size_of::<Point>();

/// Objects, which hits identify by index.
#[pyclass(frozen, name = "Scene", module = "lidarsim._native")]
pub struct PyScene {
    pub scene: Scene,
    pub appearances: Vec<Arc<Appearance>>,
    /// The instance of each object and its index, ascending; made when first needed.
    instances: OnceLock<Vec<(u32, u32)>>,
    /// The indices of `parts`.
    parts: Once<[Index; 2]>,
}

/// Rays to be cast at a scene.
struct RayCast<'a> {
    world: World<'a>,
    kernels: &'static dyn Kernels,
    rays: Rays<'a>,
    range: TRange,
}

/// t, object, primitive_id and normal of hits.
type HitVectors = (Vec<f64>, Vec<i32>, Vec<i32>, Vec<f64>);

fn hit_arrays(py: Python<'_>, (t, object, primitive, normal): HitVectors) -> PyResult<HitArrays<'_>> {
    let normal = PyArray1::from_vec(py, normal).reshape([t.len(), 3])?;
    let [object, primitive] = [object, primitive].map(|column| PyArray1::from_vec(py, column));
    Ok((PyArray1::from_vec(py, t), object, primitive, normal))
}

impl PyScene {
    pub fn new(scene: Scene, appearances: Vec<Arc<Appearance>>) -> Self {
        PyScene { scene, appearances, instances: OnceLock::new(), parts: Once::new() }
    }

    /// The indices of the objects of some instances, ascending.
    ///
    /// # Errors
    ///
    /// ValueError if there is no object of an instance.
    pub fn objects_of(&self, argument: &str, instances: &[i64]) -> PyResult<Vec<u32>> {
        let (mut objects, mut unknown) = (Vec::new(), Vec::new());
        let table = self.instances.get_or_init(|| {
            let mut table = memory::collect(
                self.appearances.iter().enumerate().map(|(i, item)| (item.instance, i as u32)),
            );
            table.sort_unstable();
            table
        });
        for &instance in instances {
            let first = table.partition_point(|&(other, _)| i64::from(other) < instance);
            let own = table[first..].iter().take_while(|&&(other, _)| i64::from(other) == instance);
            let before = objects.len();
            objects.extend(own.map(|&(_, object)| object));
            if objects.len() == before {
                unknown.push(instance);
            }
        }
        if !unknown.is_empty() {
            unknown.dedup();
            let expected = "instances of objects in the scene (by default an object's id + 1)";
            let mut got: Vec<String> = unknown.iter().take(NAMED).map(i64::to_string).collect();
            if unknown.len() > NAMED {
                got.push(format!("and {} more", unknown.len() - NAMED));
            }
            return Err(argument_error(argument, expected, got.join(", ")));
        }
        objects.sort_unstable();
        objects.dedup();
        Ok(objects)
    }

    /// As `objects_of`, for the argument `ignore` of casts and scans.
    pub fn objects_to_ignore(&self, instances: Option<&PyReadonlyArray1<'_, i64>>) -> PyResult<Vec<u32>> {
        let Some(instances) = instances else { return Ok(Vec::new()) };
        self.objects_of("ignore", elements("ignore", instances)?)
    }

    /// The worlds of the objects that light goes on from, and of all others.
    pub fn parts(&self, span: [f64; 2]) -> [World<'_>; 2] {
        let goes_on = |id: u32| self.appearances[id as usize].goes_on();
        let is_solid = |id: u32| !goes_on(id);
        let [passing, solid] =
            self.parts.get_or_make(|| [self.scene.index_of(&goes_on), self.scene.index_of(&is_solid)]);
        [self.scene.part_during(passing, span, &goes_on), self.scene.part_during(solid, span, &is_solid)]
    }

    /// Runs `work` on rays, which must be legal; `work` tells whether they are. `times` has one per ray, or
    /// none if nothing moves. Rays pass through the objects `ignored`. `bytes` is the size of the result per
    /// ray.
    fn cast_rays<R: Send>(
        &self,
        py: Python<'_>,
        (origins, directions): (&[Point], &[Point]),
        times: Option<&PyReadonlyArray1<'_, f64>>,
        (range, ignored): (TRange, &[u32]),
        bytes: usize,
        work: impl FnOnce(RayCast<'_>) -> (R, bool) + Send,
    ) -> PyResult<R> {
        let n = origins.len();
        let times = times.map_or(Ok(&[][..]), |times| elements("times", times))?;
        if times.len() != if self.scene.moves() { n } else { 0 } {
            return Err(PyValueError::new_err(
                "times: expected one for each ray of a scene that moves, and else none",
            ));
        }
        let kernels = kernels(py)?;
        let (made, legal) = detach(py, || {
            memory::expect_room(n.saturating_mul(bytes), || format!("the hits of {n} rays"));
            self.scene.prepare();
            let world = self.scene.during(span(times));
            let world = world.ignoring(ignored);
            work(RayCast { world, kernels, rays: Rays::new(origins, directions, times), range })
        })?;
        if !legal {
            legal_rays(origins, directions)?;
        }
        Ok(made)
    }
}

#[pymethods]
impl PyScene {
    /// `like` is a scene whose hierarchy is refitted if it has the same objects in other places.
    #[new]
    #[pyo3(signature = (items, like=None))]
    fn of_items(py: Python<'_>, items: &Bound<'_, PyList>, like: Option<&PyScene>) -> PyResult<Self> {
        let count = items.len();
        let (mut objects, mut appearances) =
            detach(py, || (memory::with_capacity(count), memory::with_capacity(count)))?;
        for item in items.iter().take(count) {
            let item = item.cast::<PySceneObject>()?.get();
            objects.push(item.object.clone());
            appearances.push(item.appearance.clone());
        }
        let scene = match like {
            None => Scene::new(objects),
            Some(like) => detach(py, || Scene::like(&like.scene, objects))?,
        };
        Ok(PyScene::new(scene, appearances))
    }

    /// A scene of one shape; it can be cast at but not scanned.
    #[staticmethod]
    fn of_shape(shape: &PyShape) -> Self {
        PyScene::new(Scene::new(vec![shape.object.clone()]), Vec::new())
    }

    /// Raises ValueError if there is no object of some of these instances.
    fn expect_instances(&self, ignored: PyReadonlyArray1<'_, i64>) -> PyResult<()> {
        self.objects_to_ignore(Some(&ignored)).map(drop)
    }

    /// Builds the hierarchies now rather than at the first cast.
    fn prepare(&self, py: Python<'_>) -> PyResult<()> {
        detach(py, || self.scene.prepare())
    }

    /// t (n,), object (n,), primitive_id (n,), normal (n, 3). `times` is (n,), or absent if nothing moves.
    /// Rays pass through the instances `ignored`.
    #[pyo3(signature = (origins, directions, t_min, t_max, times, ignored=None))]
    #[expect(clippy::too_many_arguments, reason = "one call a cast")]
    fn cast<'py>(
        &self,
        py: Python<'py>,
        origins: Points<'py>,
        directions: Points<'py>,
        t_min: f64,
        t_max: f64,
        times: Option<PyReadonlyArray1<'py, f64>>,
        ignored: Option<PyReadonlyArray1<'py, i64>>,
    ) -> PyResult<HitArrays<'py>> {
        let rays = equal_points(&origins, &directions)?;
        let (range, ignored) = (TRange { min: t_min, max: t_max }, self.objects_to_ignore(ignored.as_ref())?);
        let hits = self.cast_rays(py, rays, times.as_ref(), (range, &ignored), HIT, |cast| {
            let RayCast { world, kernels, rays, range } = cast;
            let n = rays.directions.len();
            let (mut t, mut normal) = (memory::with_capacity(n), memory::with_capacity(3 * n));
            let (mut object, mut primitive) = (memory::with_capacity(n), memory::with_capacity(n));
            let mut columns = Columns {
                t: &mut t.spare_capacity_mut()[..n],
                object: &mut object.spare_capacity_mut()[..n],
                primitive: &mut primitive.spare_capacity_mut()[..n],
                normal: &mut normal.spare_capacity_mut()[..3 * n],
            };
            let legal = columns.share(rays, |part, rays| kernels.cast(&world, rays, range, part));
            // SAFETY: a cast clears the hit of each of its n rays, legal or not, or unwinds.
            unsafe {
                t.set_len(n);
                object.set_len(n);
                primitive.set_len(n);
                normal.set_len(3 * n);
            }
            ((t, object, primitive, normal), legal)
        })?;
        hit_arrays(py, hits)
    }

    /// The nearest `most` hits of each ray, ascending: as for `cast`, with rows of `most` hits and misses.
    #[pyo3(signature = (origins, directions, t_min, t_max, times, most, ignored=None))]
    #[expect(clippy::too_many_arguments, reason = "the arguments of `cast`, and `most`")]
    fn cast_all<'py>(
        &self,
        py: Python<'py>,
        origins: Points<'py>,
        directions: Points<'py>,
        t_min: f64,
        t_max: f64,
        times: Option<PyReadonlyArray1<'py, f64>>,
        most: usize,
        ignored: Option<PyReadonlyArray1<'py, i64>>,
    ) -> PyResult<HitArrays<'py>> {
        let rays = rays(&origins, &directions)?;
        let (range, ignored) = (TRange { min: t_min, max: t_max }, self.objects_to_ignore(ignored.as_ref())?);
        let bytes = HIT.saturating_mul(most);
        let hits = self.cast_rays(
            py,
            rays,
            times.as_ref(),
            (range, &ignored),
            bytes,
            |RayCast { world, rays, range, .. }| {
                let n = rays.directions.len() * most;
                let (mut t, mut object, mut primitive, mut normal) = (vec![], vec![], vec![], vec![]);
                memory::resize(&mut t, n, f64::INFINITY);
                memory::resize(&mut object, n, -1);
                memory::resize(&mut primitive, n, 0);
                memory::resize(&mut normal, 3 * n, 0.0);
                let rows = HitRows {
                    most,
                    t: &mut t,
                    object: &mut object,
                    primitive: &mut primitive,
                    normal: normal.as_chunks_mut().0,
                };
                cast_all(&world, rays, range, rows);
                ((t, object, primitive, normal), true)
            },
        )?;
        hit_arrays(py, hits)
    }

    /// Whether each ray hits anything, (n,). `times` and `ignored` are as for `cast`.
    #[pyo3(signature = (origins, directions, t_min, t_max, times, ignored=None))]
    #[expect(clippy::too_many_arguments, reason = "the arguments of `cast`")]
    fn occluded<'py>(
        &self,
        py: Python<'py>,
        origins: Points<'py>,
        directions: Points<'py>,
        t_min: f64,
        t_max: f64,
        times: Option<PyReadonlyArray1<'py, f64>>,
        ignored: Option<PyReadonlyArray1<'py, i64>>,
    ) -> PyResult<Bound<'py, PyArray1<bool>>> {
        let rays = equal_points(&origins, &directions)?;
        let (range, ignored) = (TRange { min: t_min, max: t_max }, self.objects_to_ignore(ignored.as_ref())?);
        let occluded =
            self.cast_rays(py, rays, times.as_ref(), (range, &ignored), size_of::<bool>(), |cast| {
                let RayCast { world, kernels, rays, range } = cast;
                let n = rays.directions.len();
                let mut occluded = memory::with_capacity(n);
                let mut flags = Occlusion(&mut occluded.spare_capacity_mut()[..n]);
                let legal = flags.share(rays, |part, rays| kernels.find_occluded(&world, rays, range, part));
                // SAFETY: as for `cast`.
                unsafe { occluded.set_len(n) };
                (occluded, legal)
            })?;
        Ok(PyArray1::from_vec(py, occluded))
    }
}
