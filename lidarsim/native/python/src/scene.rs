//! Scenes, and casts at them.

use lidarsim_core::{Columns, Point, Scene, memory};
use numpy::{PyArray1, PyArray2, PyArrayMethods};
use pyo3::prelude::*;
use pyo3::types::PyList;

use crate::{Points, PyShape, detached, equal_points, legal_rays, level};

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
    fn new(py: Python<'_>, shapes: &Bound<'_, PyList>) -> PyResult<Self> {
        let count = shapes.len();
        let mut objects = detached(py, || memory::with_capacity(count))?;
        for shape in shapes.iter().take(count) {
            objects.push(shape.cast::<PyShape>()?.get().object.clone());
        }
        Ok(PyScene { scene: Scene::new(objects) })
    }

    /// Builds the hierarchies now rather than at the first cast.
    fn prepare(&self, py: Python<'_>) -> PyResult<()> {
        detached(py, || self.scene.prepare())
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
        let level = level(py)?;
        let (t, object, primitive, normal, legal) = detached(py, || {
            let n = o.len();
            const HIT: usize = size_of::<f64>() + 2 * size_of::<i32>() + size_of::<Point>();
            memory::expect_room(n.saturating_mul(HIT), || format!("the hits of {n} rays"));
            let (mut t, mut normal) = (memory::with_capacity(n), memory::with_capacity::<Point>(n));
            let (mut object, mut primitive) = (memory::with_capacity(n), memory::with_capacity(n));
            let columns = Columns {
                t: &mut t.spare_capacity_mut()[..n],
                object: &mut object.spare_capacity_mut()[..n],
                primitive: &mut primitive.spare_capacity_mut()[..n],
                normal: &mut normal.spare_capacity_mut()[..n],
            };
            self.scene.prepare();
            let legal = columns.cast(&self.scene, level, o, d, (t_min, t_max));
            // SAFETY: a cast writes the hit of each of its n rays, legal or not, or unwinds.
            unsafe {
                t.set_len(n);
                object.set_len(n);
                primitive.set_len(n);
                normal.set_len(n);
            }
            (t, object, primitive, normal, legal)
        })?;
        if !legal {
            legal_rays(o, d)?;
        }
        let n = t.len();
        Ok((
            PyArray1::from_vec(py, t),
            PyArray1::from_vec(py, object),
            PyArray1::from_vec(py, primitive),
            PyArray1::from_vec(py, normal.into_flattened()).reshape([n, 3])?,
        ))
    }
}
