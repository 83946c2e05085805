//! Scenes, and casts at them.

use super::{Points, PyShape, chunk, equal_points, interruptible, legal_rays, level};
use std::mem::MaybeUninit;
use std::ops::Range;
use std::sync::atomic::{AtomicBool, Ordering};

use numpy::{PyArray1, PyArray2, PyArrayMethods};
use pyo3::prelude::*;

use crate::scene::{Hit, Scene};
use crate::simd::{self, Isa};
use crate::trace::Sink;
use crate::vector::Point;
use crate::{memory, parallel};

type Arrays<'py> =
    (Bound<'py, PyArray1<f64>>, Bound<'py, PyArray1<i32>>, Bound<'py, PyArray1<i32>>, Bound<'py, PyArray2<f64>>);

/// A chunk of the arrays that a cast returns: room that is not cleared before.
struct Columns<'a> {
    t: &'a mut [MaybeUninit<f64>],
    object: &'a mut [MaybeUninit<i32>],
    primitive: &'a mut [MaybeUninit<i32>],
    normal: &'a mut [MaybeUninit<Point>],
}

impl Sink for Columns<'_> {
    #[inline(always)]
    fn put(&mut self, i: usize, hit: Hit) {
        self.t[i].write(hit.t);
        self.object[i].write(hit.object);
        self.primitive[i].write(hit.primitive);
        self.normal[i].write(hit.normal);
    }

    #[inline(always)]
    fn prefetch<I: Isa>(&self, hits: Range<usize>) {
        simd::prefetch::<I, _>(&self.t[hits.clone()]);
        simd::prefetch::<I, _>(&self.object[hits.clone()]);
        simd::prefetch::<I, _>(&self.primitive[hits.clone()]);
        simd::prefetch::<I, _>(&self.normal[hits]);
    }
}

/// Objects in the order of their ids.
#[pyclass(frozen, name = "Scene", module = "lidarsim._native")]
pub struct PyScene {
    pub scene: Scene,
}

#[pymethods]
impl PyScene {
    #[new]
    fn new(shapes: Vec<PyRef<'_, PyShape>>) -> Self {
        PyScene { scene: Scene::new(shapes.iter().map(|shape| shape.object.clone()).collect()) }
    }

    /// Builds the hierarchies now rather than at the first cast.
    fn prepare(&self, py: Python<'_>) {
        py.detach(|| self.scene.prepare());
    }

    /// t (n,), object_id (n,), primitive_id (n,), normal (n, 3).
    fn cast<'py>(
        &self,
        py: Python<'py>,
        origins: Points<'py>,
        directions: Points<'py>,
        t_min: f64,
        t_max: f64,
    ) -> PyResult<Arrays<'py>> {
        let (o, d) = equal_points(&origins, &directions)?;
        let n = o.len();
        let (mut t, mut normal) = (memory::with_capacity(n), memory::with_capacity::<Point>(n));
        let (mut object, mut primitive) = (memory::with_capacity(n), memory::with_capacity(n));
        let level = level()?;
        let chunk = chunk(d);
        let legal = AtomicBool::new(true);
        self.prepare(py);
        interruptible(py, n, |slice| {
            let pieces = t.spare_capacity_mut()[slice.clone()]
                .chunks_mut(chunk)
                .zip(object.spare_capacity_mut()[slice.clone()].chunks_mut(chunk))
                .zip(primitive.spare_capacity_mut()[slice.clone()].chunks_mut(chunk))
                .zip(normal.spare_capacity_mut()[slice.clone()].chunks_mut(chunk))
                .zip(o[slice.clone()].chunks(chunk).zip(d[slice].chunks(chunk)));
            parallel::share(
                pieces,
                || (),
                |(), ((((t, object), primitive), normal), (o, d))| {
                    let mut columns = Columns { t, object, primitive, normal };
                    if !self.scene.cast(level, o, d, (t_min, t_max), &mut columns) {
                        legal.store(false, Ordering::Relaxed);
                    }
                },
            );
        })?;
        if !legal.into_inner() {
            legal_rays(o, d)?;
        }
        // SAFETY: the slices cover 0..n, the chunks the slices, and a cast puts a hit for each of its rays, legal or not.
        unsafe {
            t.set_len(n);
            object.set_len(n);
            primitive.set_len(n);
            normal.set_len(n);
        }
        Ok((
            PyArray1::from_vec(py, t),
            PyArray1::from_vec(py, object),
            PyArray1::from_vec(py, primitive),
            PyArray1::from_vec(py, normal.into_flattened()).reshape([n, 3])?,
        ))
    }
}
