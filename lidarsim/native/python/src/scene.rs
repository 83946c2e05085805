//! Scenes, and casts of rays at them.

use std::sync::Arc;

use lidarsim_core::measure::Appearance;
use lidarsim_core::{
    Arrays, Columns, HitRows, Index, Kernels, Occlusion, Once, Point, Rays, Scene, TRange, World, cast_all,
    memory, objects_met, span,
};
use numpy::{PyArray1, PyArray2, PyArrayMethods, PyReadonlyArray1};
use pyo3::exceptions::PyValueError;
use pyo3::prelude::*;
use pyo3::types::PyList;

use crate::{Points, PySceneObject, PyShape, detached, elements, equal_points, kernels, legal_rays};

type HitArrays<'py> = (
    Bound<'py, PyArray1<f64>>,
    Bound<'py, PyArray1<i32>>,
    Bound<'py, PyArray1<i32>>,
    Bound<'py, PyArray2<f64>>,
);

/// Size of a hit, bytes.
const HIT: usize = size_of::<f64>() + 2 * size_of::<i32>() + size_of::<Point>();

/// Objects, which hits identify by index.
#[pyclass(frozen, name = "Scene", module = "lidarsim._native")]
pub struct PyScene {
    pub scene: Scene,
    pub appearances: Vec<Arc<Appearance>>,
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

impl RayCast<'_> {
    /// Writes the row of each ray; false if one is illegal.
    fn hits(&self, mut columns: Columns) -> bool {
        columns.share(self.rays, |part, rays| self.kernels.cast(&self.world, rays, self.range, part))
    }

    /// Writes whether each ray hits anything; false if one is illegal.
    fn occlusion(&self, mut occlusion: Occlusion) -> bool {
        occlusion
            .share(self.rays, |part, rays| self.kernels.find_occluded(&self.world, rays, self.range, part))
    }
}

impl PyScene {
    /// The worlds of the objects that light goes on from, and of all others.
    pub fn parts(&self, span: [f64; 2]) -> [World<'_>; 2] {
        let goes_on = |id: u32| self.appearances[id as usize].goes_on();
        let is_solid = |id: u32| !goes_on(id);
        let [passing, solid] =
            self.parts.get_or_make(|| [self.scene.index_of(goes_on), self.scene.index_of(is_solid)]);
        [self.scene.part_during(passing, span, goes_on), self.scene.part_during(solid, span, is_solid)]
    }

    /// Runs `work` on rays, which must be legal; `work` tells whether they are. `times` has one per ray, or
    /// none if nothing moves. `bytes` is the size of the result per ray.
    fn cast_rays<R: Send>(
        &self,
        py: Python<'_>,
        (origins, directions): (&[Point], &[Point]),
        times: Option<&PyReadonlyArray1<'_, f64>>,
        range: TRange,
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
        let (made, legal) = detached(py, || {
            memory::expect_room(n.saturating_mul(bytes), || format!("the hits of {n} rays"));
            self.scene.prepare();
            let world = self.scene.during(span(times));
            work(RayCast { world, kernels, rays: Rays { origins, directions, times }, range })
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
    fn new(py: Python<'_>, items: &Bound<'_, PyList>, like: Option<&PyScene>) -> PyResult<Self> {
        let count = items.len();
        let (mut objects, mut appearances) =
            detached(py, || (memory::with_capacity(count), memory::with_capacity(count)))?;
        for item in items.iter().take(count) {
            let item = item.cast::<PySceneObject>()?.get();
            objects.push(item.object.clone());
            appearances.push(item.appearance.clone());
        }
        let scene = match like {
            None => Scene::new(objects),
            Some(like) => detached(py, || Scene::like(&like.scene, objects))?,
        };
        Ok(PyScene { scene, appearances, parts: Once::new() })
    }

    /// A scene of one shape; it can be cast at but not scanned.
    #[staticmethod]
    fn of_shape(shape: &PyShape) -> Self {
        PyScene { scene: Scene::new(vec![shape.object.clone()]), appearances: Vec::new(), parts: Once::new() }
    }

    /// Builds the hierarchies now rather than at the first cast.
    fn prepare(&self, py: Python<'_>) -> PyResult<()> {
        detached(py, || self.scene.prepare())
    }

    /// t (n,), object (n,), primitive_id (n,), normal (n, 3). `times` is (n,), or absent if nothing moves.
    fn cast<'py>(
        &self,
        py: Python<'py>,
        origins: Points<'py>,
        directions: Points<'py>,
        t_min: f64,
        t_max: f64,
        times: Option<PyReadonlyArray1<'py, f64>>,
    ) -> PyResult<HitArrays<'py>> {
        let rays = equal_points(&origins, &directions)?;
        let (t, object, primitive, normal) =
            self.cast_rays(py, rays, times.as_ref(), TRange { min: t_min, max: t_max }, HIT, |cast| {
                let n = rays.0.len();
                let (mut t, mut normal) = (memory::with_capacity(n), memory::with_capacity(3 * n));
                let (mut object, mut primitive) = (memory::with_capacity(n), memory::with_capacity(n));
                let legal = cast.hits(Columns {
                    t: &mut t.spare_capacity_mut()[..n],
                    object: &mut object.spare_capacity_mut()[..n],
                    primitive: &mut primitive.spare_capacity_mut()[..n],
                    normal: &mut normal.spare_capacity_mut()[..3 * n],
                });
                // SAFETY: a cast clears the hit of each of its n rays, legal or not, or unwinds.
                unsafe {
                    t.set_len(n);
                    object.set_len(n);
                    primitive.set_len(n);
                    normal.set_len(3 * n);
                }
                ((t, object, primitive, normal), legal)
            })?;
        let n = t.len();
        Ok((
            PyArray1::from_vec(py, t),
            PyArray1::from_vec(py, object),
            PyArray1::from_vec(py, primitive),
            PyArray1::from_vec(py, normal).reshape([n, 3])?,
        ))
    }

    /// The nearest `most` hits of each ray, ascending: as for `cast`, with rows of `most` hits and misses.
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
    ) -> PyResult<HitArrays<'py>> {
        let rays = equal_points(&origins, &directions)?;
        legal_rays(rays.0, rays.1)?;
        let bytes = HIT.saturating_mul(most);
        let (t, object, primitive, normal) = self.cast_rays(
            py,
            rays,
            times.as_ref(),
            TRange { min: t_min, max: t_max },
            bytes,
            |RayCast { world, rays, range, .. }| {
                let n = rays.origins.len() * most;
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
        Ok((
            PyArray1::from_vec(py, t),
            PyArray1::from_vec(py, object),
            PyArray1::from_vec(py, primitive),
            PyArray1::from_vec(py, normal).reshape([rays.0.len() * most, 3])?,
        ))
    }

    /// The objects that each ray meets: two arrays of equal length, the indices of rays, ascending, and of
    /// objects.
    fn objects_met<'py>(
        &self,
        py: Python<'py>,
        origins: Points<'py>,
        directions: Points<'py>,
        t_min: f64,
        t_max: f64,
        times: Option<PyReadonlyArray1<'py, f64>>,
    ) -> PyResult<[Bound<'py, PyArray1<u32>>; 2]> {
        let rays = equal_points(&origins, &directions)?;
        legal_rays(rays.0, rays.1)?;
        let range = TRange { min: t_min, max: t_max };
        let (ray, object): (Vec<u32>, Vec<u32>) =
            self.cast_rays(py, rays, times.as_ref(), range, size_of::<(u32, u32)>(), |cast| {
                (objects_met(&cast.world, cast.rays, cast.range).into_iter().unzip(), true)
            })?;
        Ok([ray, object].map(|ids| PyArray1::from_vec(py, ids)))
    }

    /// Whether each ray hits anything, (n,). `times` is as for `cast`.
    fn occluded<'py>(
        &self,
        py: Python<'py>,
        origins: Points<'py>,
        directions: Points<'py>,
        t_min: f64,
        t_max: f64,
        times: Option<PyReadonlyArray1<'py, f64>>,
    ) -> PyResult<Bound<'py, PyArray1<bool>>> {
        let rays = equal_points(&origins, &directions)?;
        let occluded = self.cast_rays(
            py,
            rays,
            times.as_ref(),
            TRange { min: t_min, max: t_max },
            size_of::<bool>(),
            |cast| {
                let n = rays.0.len();
                let mut occluded = memory::with_capacity(n);
                let legal = cast.occlusion(Occlusion(&mut occluded.spare_capacity_mut()[..n]));
                // SAFETY: as for `cast`.
                unsafe { occluded.set_len(n) };
                (occluded, legal)
            },
        )?;
        Ok(PyArray1::from_vec(py, occluded))
    }
}
