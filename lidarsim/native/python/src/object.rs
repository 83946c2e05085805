//! Objects of scenes.

use std::sync::Arc;

use lidarsim_core::measure::{Appearance, Backscatter, Grain, Labels, Reflectivity};
use lidarsim_core::{Object, memory};
use numpy::{PyArray2, PyReadonlyArray1, PyReadonlyArray3};
use pyo3::exceptions::PyValueError;
use pyo3::intern;
use pyo3::prelude::*;
use pyo3::types::PyString;

use crate::{PyAffine, PyPath, PyShape, PyTextureMap, argument_error, detach, elements, shape};

/// An object in two forms: as given and validated in Python, and in the core.
#[pyclass(frozen, subclass, name = "SceneObject", module = "lidarsim._native")]
pub struct PySceneObject {
    pub object: Object,
    pub appearance: Arc<Appearance>,
    #[pyo3(get)]
    id: u32,
    #[pyo3(get)]
    shape: Py<PyAny>,
    #[pyo3(get)]
    name: Py<PyAny>,
    #[pyo3(get)]
    label: Py<PyAny>,
    #[pyo3(get)]
    instance: u32,
    #[pyo3(get)]
    material: Py<PyAny>,
    #[pyo3(get)]
    motion: Option<Py<PyAny>>,
    transform: Option<PyAffine>,
}

#[derive(FromPyObject)]
enum LabelParameter<'py> {
    Object(u32),
    Face(PyReadonlyArray1<'py, u32>),
}

#[derive(FromPyObject)]
enum ReflectivityParameter<'py> {
    Object(f64),
    Each(PyReadonlyArray1<'py, f64>),
}

#[pymethods]
impl PySceneObject {
    /// The label is a single one or one per face; the reflectivity is a number or that of the material.
    /// `like` is an object whose equal label, instance and material are shared.
    #[new]
    #[expect(clippy::too_many_arguments, reason = "the fields, in their order")]
    #[pyo3(
        signature = (id, shape, name, label, instance, material, transform, motion, like=None),
        text_signature = None
    )]
    fn new(
        id: u32,
        shape: Bound<'_, PyAny>,
        name: Py<PyAny>,
        label: Bound<'_, PyAny>,
        instance: u32,
        material: Bound<'_, PyAny>,
        transform: Option<&PyAffine>,
        motion: Option<Bound<'_, PyAny>>,
        like: Option<&PySceneObject>,
    ) -> PyResult<Self> {
        let py = shape.py();
        let native = intern!(py, "_native");
        let given: Bound<'_, PyShape> = shape.getattr(native)?.cast_into()?;
        let mut object = match transform {
            None => given.get().object.clone(),
            Some(map) => map.image_of(&given.get().object)?,
        };
        if let Some(motion) = &motion {
            let path: Bound<'_, PyPath> = motion.getattr(native)?.cast_into()?;
            object = object.moving(path.get().path.clone());
        }
        let appearance = match like {
            Some(like) => like.appearance.clone(),
            None => Arc::new(appearance(id, &label, instance, &material)?),
        };
        Ok(PySceneObject {
            object,
            appearance,
            id,
            shape: shape.unbind(),
            name,
            label: label.unbind(),
            instance,
            material: material.unbind(),
            motion: motion.map(Bound::unbind),
            transform: transform.copied(),
        })
    }

    #[getter]
    fn transform<'py>(&self, py: Python<'py>) -> Option<Bound<'py, PyArray2<f64>>> {
        self.transform.map(|map| map.matrix(py))
    }

    /// As for a shape; without the motion.
    #[getter]
    fn bounds<'py>(&self, py: Python<'py>) -> Bound<'py, PyArray2<f64>> {
        shape::bounds(py, &self.object)
    }

    /// Whether both share the memory of their labels and reflectivities.
    fn looks_like(&self, other: &PySceneObject) -> bool {
        Arc::ptr_eq(&self.appearance, &other.appearance)
    }
}

/// Objects under other transforms (n, 4, 4), one each.
#[pyfunction]
pub fn place<'py>(
    items: Vec<Bound<'py, PySceneObject>>,
    transforms: PyReadonlyArray3<'py, f64>,
) -> PyResult<Vec<Bound<'py, PyAny>>> {
    let rows = elements("transforms", &transforms)?.as_chunks::<4>().0.as_chunks::<4>().0;
    let place = |(i, (item, rows)): (usize, (Bound<'py, PySceneObject>, &[[f64; 4]; 4]))| {
        let (py, transform) = (item.py(), PyAffine::new(*rows));
        let PySceneObject { id, shape, name, label, instance, material, motion, .. } = item.get();
        let fields = (*id, shape, name, label, *instance, material, Py::new(py, transform)?, motion, &item);
        item.get_type().call1(fields).map_err(|error| {
            if !error.is_instance_of::<PyValueError>(py) {
                return error;
            }
            let got = format!("transforms[{i}] with determinant 0");
            argument_error("transforms", "invertible matrices", got)
        })
    };
    items.into_iter().zip(rows).enumerate().map(place).collect()
}

fn reflectivity(material: &Bound<'_, PyAny>) -> PyResult<Reflectivity> {
    let py = material.py();
    let Ok(numbers) = material.getattr(intern!(py, "_reflectivity"))?.extract() else {
        let map: Bound<'_, PyTextureMap> = material.getattr(intern!(py, "_texture_map"))?.cast_into()?;
        return Ok(Reflectivity::Texture(map.get().map.clone()));
    };
    let values = match numbers {
        ReflectivityParameter::Object(value) => return Ok(Reflectivity::Object(value)),
        ReflectivityParameter::Each(values) => values,
    };
    let values = elements("reflectivity", &values)?;
    let values = detach(py, || memory::copy(values))?;
    match material.getattr(intern!(py, "_per"))?.extract()? {
        "face" => Ok(Reflectivity::Face(values)),
        "vertex" => Ok(Reflectivity::Vertex(values)),
        _ => Err(PyValueError::new_err("reflectivity: expected one of an object")),
    }
}

/// The properties of an object that a lidar measures.
fn appearance(
    id: u32,
    label: &Bound<'_, PyAny>,
    instance: u32,
    material: &Bound<'_, PyAny>,
) -> PyResult<Appearance> {
    let py = material.py();
    let labels = match label.extract()? {
        LabelParameter::Object(label) => Labels::Object(label),
        LabelParameter::Face(labels) => {
            let labels = elements("label", &labels)?;
            Labels::Face(detach(py, || memory::copy(labels))?)
        }
    };
    let reflectivity = reflectivity(material)?;
    let number = |name: &Bound<'_, PyString>| material.getattr(name)?.extract::<f64>();
    let backscatter = Backscatter::new(
        number(intern!(py, "_roughness"))?,
        number(intern!(py, "_specular"))?,
        number(intern!(py, "_specular_width"))?,
    );
    let grain = Grain::new(number(intern!(py, "_variation"))?, number(intern!(py, "_grain"))?, id);
    let [transmission, mirror] = [number(intern!(py, "_transmission"))?, number(intern!(py, "_mirror"))?];
    Ok(Appearance { labels, instance, reflectivity, backscatter, grain, transmission, mirror })
}
