//! Scenes, and casts at them.

use lidarsim_core::{Columns, Point, Scene, memory};
use numpy::{PyArray1, PyArray2, PyArrayMethods, PyReadonlyArray1};
use pyo3::exceptions::PyValueError;
use pyo3::prelude::*;

use crate::{Points, PyShape, equal_points, interruptible, legal_rays, level};

type Arrays<'py> =
    (Bound<'py, PyArray1<f64>>, Bound<'py, PyArray1<i32>>, Bound<'py, PyArray1<i32>>, Bound<'py, PyArray2<f64>>);

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

    /// Whether anything moves, so that casts need times.
    fn moves(&self) -> bool {
        self.scene.moves()
    }

    /// t (n,), object_id (n,), primitive_id (n,), normal (n, 3). `times`: (n,), or none if nothing moves.
    fn cast<'py>(
        &self,
        py: Python<'py>,
        origins: Points<'py>,
        directions: Points<'py>,
        t_min: f64,
        t_max: f64,
        times: Option<PyReadonlyArray1<'py, f64>>,
    ) -> PyResult<Arrays<'py>> {
        let (o, d) = equal_points(&origins, &directions)?;
        let n = o.len();
        let times = match &times {
            Some(times) => times.as_slice()?,
            None => &[],
        };
        if times.len() != if self.scene.moves() { n } else { 0 } {
            return Err(PyValueError::new_err("times: expected one for each ray of a scene that moves, and else none"));
        }
        let (mut t, mut normal) = (memory::with_capacity(n), memory::with_capacity::<Point>(n));
        let (mut object, mut primitive) = (memory::with_capacity(n), memory::with_capacity(n));
        let level = level()?;
        self.prepare(py);
        let mut columns = Columns {
            t: &mut t.spare_capacity_mut()[..n],
            object: &mut object.spare_capacity_mut()[..n],
            primitive: &mut primitive.spare_capacity_mut()[..n],
            normal: &mut normal.spare_capacity_mut()[..n],
        };
        let mut legal = true;
        interruptible(py, n, |slice| {
            let times = if times.is_empty() { times } else { &times[slice.clone()] };
            let world = self.scene.during(times.iter().copied());
            legal &= columns.cast(&world, level, (&o[slice.clone()], &d[slice], times), (t_min, t_max));
        })?;
        if !legal {
            legal_rays(o, d)?;
        }
        // SAFETY: the slices cover 0..n, and a cast writes the hit of each of its rays, legal or not.
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
