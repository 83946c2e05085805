//! Scenes, and casts at them.

use std::sync::Arc;

use lidarsim_core::measure::{Appearance, Labels, Reflectivity};
use lidarsim_core::{Arrays, Columns, Occlusion, Point, Scene, memory};
use numpy::{PyArray1, PyArray2, PyArrayMethods, PyReadonlyArray1};
use pyo3::exceptions::PyValueError;
use pyo3::prelude::*;

use crate::{Points, PyShape, equal_points, interruptible, legal_rays, level};

type HitArrays<'py> =
    (Bound<'py, PyArray1<f64>>, Bound<'py, PyArray1<i32>>, Bound<'py, PyArray1<i32>>, Bound<'py, PyArray2<f64>>);

/// What a lidar can tell of an object.
#[pyclass(frozen, name = "Appearance", module = "lidarsim._native")]
pub struct PyAppearance {
    pub appearance: Arc<Appearance>,
}

#[derive(FromPyObject)]
enum LabelParameter<'py> {
    Object(u32),
    Face(PyReadonlyArray1<'py, u32>),
}

#[pymethods]
impl PyAppearance {
    /// The label, or one a face; the instance; what the reflectivity is given per ("object", "face" or "vertex"), and the
    /// values of that.
    #[new]
    fn new(
        label: LabelParameter<'_>,
        instance: u32,
        per: &str,
        reflectivity: PyReadonlyArray1<'_, f64>,
    ) -> PyResult<Self> {
        let labels = match label {
            LabelParameter::Object(label) => Labels::Object(label),
            LabelParameter::Face(labels) => Labels::Face(labels.as_array().to_vec()),
        };
        let values = reflectivity.as_array().to_vec();
        let reflectivity = match (per, values.as_slice()) {
            ("object", [value]) => Reflectivity::Object(*value),
            ("face", _) => Reflectivity::Face(values),
            ("vertex", _) => Reflectivity::Vertex(values),
            _ => {
                return Err(PyValueError::new_err(
                    "reflectivity: expected one of an object, or some per face or vertex",
                ));
            }
        };
        Ok(PyAppearance { appearance: Arc::new(Appearance { labels, instance, reflectivity }) })
    }
}

/// Objects, which hits name by their places.
#[pyclass(frozen, name = "Scene", module = "lidarsim._native")]
pub struct PyScene {
    pub scene: Scene,
    pub appearances: Vec<Arc<Appearance>>,
}

impl PyScene {
    /// Casts legal rays, as many as there are rows. `times`: one for each ray, or none if nothing moves.
    fn cast_into(
        &self,
        py: Python<'_>,
        (o, d): (&[Point], &[Point]),
        times: Option<&PyReadonlyArray1<'_, f64>>,
        range: (f64, f64),
        arrays: &mut impl Arrays,
    ) -> PyResult<()> {
        let times = match times {
            Some(times) => times.as_slice()?,
            None => &[],
        };
        if times.len() != if self.scene.moves() { o.len() } else { 0 } {
            return Err(PyValueError::new_err("times: expected one for each ray of a scene that moves, and else none"));
        }
        let level = level()?;
        self.prepare(py);
        let mut legal = true;
        interruptible(py, o.len(), |slice| {
            let times = if times.is_empty() { times } else { &times[slice.clone()] };
            let world = self.scene.during(times.iter().copied());
            legal &= arrays.cast(&world, level, (&o[slice.clone()], &d[slice], times), range);
        })?;
        if legal { Ok(()) } else { legal_rays(o, d) }
    }
}

#[pymethods]
impl PyScene {
    /// Appearances are needed for scans alone.
    #[new]
    #[pyo3(signature = (shapes, appearances=Vec::new()))]
    fn new(shapes: Vec<PyRef<'_, PyShape>>, appearances: Vec<PyRef<'_, PyAppearance>>) -> Self {
        PyScene {
            scene: Scene::new(shapes.iter().map(|shape| shape.object.clone()).collect()),
            appearances: appearances.iter().map(|of| of.appearance.clone()).collect(),
        }
    }

    /// Builds the hierarchies now rather than at the first cast.
    fn prepare(&self, py: Python<'_>) {
        py.detach(|| self.scene.prepare());
    }

    /// t (n,), object (n,), primitive_id (n,), normal (n, 3). `times`: (n,), or none if nothing moves.
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
        let n = rays.0.len();
        let (mut t, mut normal) = (memory::with_capacity(n), memory::with_capacity::<Point>(n));
        let (mut object, mut primitive) = (memory::with_capacity(n), memory::with_capacity(n));
        let mut columns = Columns {
            t: &mut t.spare_capacity_mut()[..n],
            object: &mut object.spare_capacity_mut()[..n],
            primitive: &mut primitive.spare_capacity_mut()[..n],
            normal: &mut normal.spare_capacity_mut()[..n],
        };
        self.cast_into(py, rays, times.as_ref(), (t_min, t_max), &mut columns)?;
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

    /// Whether each ray hits anything, (n,). `times`: as of `cast`.
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
        let n = rays.0.len();
        let mut occluded = memory::with_capacity(n);
        let mut rows = Occlusion(&mut occluded.spare_capacity_mut()[..n]);
        self.cast_into(py, rays, times.as_ref(), (t_min, t_max), &mut rows)?;
        // SAFETY: as of `cast`.
        unsafe { occluded.set_len(n) };
        Ok(PyArray1::from_vec(py, occluded))
    }
}
