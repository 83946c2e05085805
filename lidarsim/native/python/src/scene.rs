//! Scenes, and casts at them.

use std::mem::MaybeUninit;
use std::ops::Range;
use std::sync::atomic::{AtomicBool, Ordering};

use numpy::{PyArray1, PyArray2, PyArrayMethods};
use pyo3::prelude::*;

use crate::{Points, PyShape, equal_points, interruptible, legal_rays, level, pieces};
use lidarsim_core::arith::simd::{self, Isa};
use lidarsim_core::geometry::vector::Point;
use lidarsim_core::scene::Sink;
use lidarsim_core::scene::{Hit, Scene};
use lidarsim_core::{memory, parallel};

type Arrays<'py> =
    (Bound<'py, PyArray1<f64>>, Bound<'py, PyArray1<i32>>, Bound<'py, PyArray1<i32>>, Bound<'py, PyArray2<f64>>);

/// A part of the arrays that a cast returns: room that is not cleared before.
struct Columns<'a> {
    t: &'a mut [MaybeUninit<f64>],
    object: &'a mut [MaybeUninit<i32>],
    primitive: &'a mut [MaybeUninit<i32>],
    normal: &'a mut [MaybeUninit<Point>],
}

impl<'a> Columns<'a> {
    /// Takes the first rays, which are left for others to cast.
    fn split_off(&mut self, count: usize) -> Columns<'a> {
        Columns {
            t: memory::split_off(&mut self.t, count),
            object: memory::split_off(&mut self.object, count),
            primitive: memory::split_off(&mut self.primitive, count),
            normal: memory::split_off(&mut self.normal, count),
        }
    }
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
        let legal = AtomicBool::new(true);
        self.prepare(py);
        let mut places = Columns {
            t: &mut t.spare_capacity_mut()[..n],
            object: &mut object.spare_capacity_mut()[..n],
            primitive: &mut primitive.spare_capacity_mut()[..n],
            normal: &mut normal.spare_capacity_mut()[..n],
        };
        interruptible(py, n, |slice| {
            let (o, d) = (&o[slice.clone()], &d[slice]);
            let pieces: Vec<_> = pieces(d, 1).into_iter().map(|piece| (places.split_off(piece.len()), piece)).collect();
            parallel::share(pieces.into_iter(), |(mut columns, piece)| {
                if !self.scene.cast(level, &o[piece.clone()], &d[piece], (t_min, t_max), &mut columns) {
                    legal.store(false, Ordering::Relaxed);
                }
            });
        })?;
        if !legal.into_inner() {
            legal_rays(o, d)?;
        }
        // SAFETY: the slices cover 0..n, the pieces the slices, and a cast puts a hit for each of its rays, legal or not.
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
