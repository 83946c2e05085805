//! Shapes, as constructed from Python. Arguments that Python has validated are not checked again, except by
//! exact arithmetic.

use std::sync::Arc;

use lidarsim_core::shapes::{self, AnySurface, Form};
use lidarsim_core::{Disks, Geometry, Object, Scene, Spheres, TriangleMesh, memory};
use numpy::ndarray::aview2;
use numpy::{PyArray1, PyArray2, PyArrayMethods, PyReadonlyArray2};
use pyo3::exceptions::PyValueError;
use pyo3::prelude::*;
use pyo3::types::{PyDict, PyTuple};

use crate::{Points, PyAffine, argument_error, detach, elements, plain, points, rays, view};

/// A shape, placed by the maps applied to it.
#[pyclass(frozen, name = "Shape", module = "lidarsim._native")]
pub struct PyShape {
    pub object: Object,
    /// The arguments that define it, and their numbers; none for a mesh.
    form: Form,
    numbers: Vec<f64>,
    transform: Option<PyAffine>,
}

impl PyShape {
    /// Creates the shape from the form with these argument names, in this order.
    fn of_form<'py>(
        name: &str,
        names: impl Iterator<Item = Bound<'py, PyAny>>,
        numbers: Vec<f64>,
    ) -> PyResult<Self> {
        let names = names.map(|name| name.extract::<String>()).collect::<PyResult<Vec<_>>>()?;
        let of_names = |form: &Form| form.iter().map(|(name, _)| *name).eq(names.iter().map(String::as_str));
        let forms = AnySurface::forms(name);
        let Some(index) = forms.iter().position(of_names) else {
            return Err(argument_error(name, "the arguments of one of its forms", names.join(", ")));
        };
        let surface = AnySurface::new(name, index, &numbers)
            .map_err(|wrong| argument_error(wrong.argument, wrong.expected, wrong.got))?;
        let object = Object::new(Geometry::Surface(surface), false);
        Ok(PyShape { object, form: forms[index], numbers, transform: None })
    }

    fn of_primitives(geometry: Geometry) -> Self {
        PyShape { object: Object::new(geometry, false), form: &[], numbers: Vec::new(), transform: None }
    }

    fn mesh(&self) -> Option<&TriangleMesh> {
        match &self.object.geometry {
            Geometry::Mesh(mesh) => Some(mesh),
            _ => None,
        }
    }
}

#[pymethods]
impl PyShape {
    /// The shape with this name and these arguments, each a sequence of finite numbers.
    #[new]
    fn new(name: &str, arguments: &Bound<'_, PyDict>) -> PyResult<Self> {
        let mut numbers: Vec<f64> = Vec::new();
        for values in arguments.values() {
            numbers.extend(values.extract::<Vec<f64>>()?);
        }
        Self::of_form(name, arguments.keys().iter(), numbers)
    }

    /// Fast path for arguments of common types: vectors, followed by single numbers, by name. `None` for
    /// other types.
    #[staticmethod]
    fn plain(name: &str, vectors: &Bound<'_, PyDict>, numbers: &Bound<'_, PyDict>) -> Option<Self> {
        let names = vectors.keys().iter().chain(numbers.keys().iter());
        Self::of_form(name, names, plain::numbers(vectors, numbers)?).ok()
    }

    /// Vertices (n, 3) and faces (m, 3). `whole` makes the triangles one primitive.
    #[staticmethod]
    fn triangle_mesh(
        py: Python<'_>,
        vertices: Points<'_>,
        faces: PyReadonlyArray2<'_, u32>,
        whole: bool,
    ) -> PyResult<Self> {
        let (vertices, faces) = (points("vertices", &vertices)?, elements("faces", &faces)?.as_chunks().0);
        let mesh = detach(py, || TriangleMesh::new(memory::copy(vertices), memory::copy(faces)))?
            .ok_or_else(|| {
                PyValueError::new_err("faces: expected shape (m, 3) and the numbers of vertices")
            })?;
        let object = Object::new(Geometry::Mesh(Arc::new(mesh)), whole);
        Ok(PyShape { object, form: &[], numbers: Vec::new(), transform: None })
    }

    /// The mesh with the same faces, transform and hierarchy over as many other vertices (n, 3).
    fn deformed(&self, py: Python<'_>, vertices: Points<'_>) -> PyResult<Self> {
        let vertices = points("vertices", &vertices)?;
        let mesh = detach(py, || self.mesh().and_then(|mesh| mesh.deformed(memory::copy(vertices))))?
            .ok_or_else(|| PyValueError::new_err("vertices: expected as many as the mesh has"))?;
        let mut object = self.object.clone();
        object.geometry = Geometry::Mesh(Arc::new(mesh));
        Ok(PyShape { object, form: self.form, numbers: Vec::new(), transform: self.transform })
    }

    /// Many spheres, from rows (n, 4) of centre and radius.
    #[staticmethod]
    fn spheres(py: Python<'_>, rows: PyReadonlyArray2<'_, f64>) -> PyResult<Self> {
        let rows = elements("spheres", &rows)?.as_chunks().0;
        let spheres = detach(py, || Spheres::new(rows))?;
        Ok(Self::of_primitives(Geometry::Spheres(Arc::new(spheres))))
    }

    /// Many disks, from rows (n, 7) of centre, radius and normal.
    #[staticmethod]
    fn disks(py: Python<'_>, rows: PyReadonlyArray2<'_, f64>) -> PyResult<Self> {
        let rows = elements("disks", &rows)?.as_chunks().0;
        let disks = detach(py, || Disks::new(rows))?;
        Ok(Self::of_primitives(Geometry::Disks(Arc::new(disks))))
    }

    /// The rows that many spheres or disks were made from, flat.
    fn rows<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyArray1<f64>>> {
        let rows = match &self.object.geometry {
            Geometry::Spheres(spheres) => detach(py, || memory::collect(spheres.rows()).into_flattened())?,
            Geometry::Disks(disks) => detach(py, || memory::collect(disks.rows()).into_flattened())?,
            _ => Vec::new(),
        };
        Ok(PyArray1::from_vec(py, rows))
    }

    /// The image under a transform.
    fn transformed(&self, transform: &PyAffine) -> PyResult<Self> {
        let object = transform.image_of(&self.object)?;
        Ok(PyShape { object, form: self.form, numbers: self.numbers.clone(), transform: Some(*transform) })
    }

    /// The matrix of the transform, read-only.
    fn transform<'py>(&self, py: Python<'py>) -> Option<Bound<'py, PyArray2<f64>>> {
        self.transform.map(|transform| transform.matrix(py))
    }

    /// The arguments by name, each a tuple of numbers; empty for a mesh.
    fn arguments<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyDict>> {
        let (arguments, mut numbers) = (PyDict::new(py), self.numbers.iter());
        for (name, count) in self.form {
            arguments.set_item(name, PyTuple::new(py, numbers.by_ref().take(*count).collect::<Vec<_>>())?)?;
        }
        Ok(arguments)
    }

    /// The vertices of a mesh, (n, 3): a read-only view.
    fn vertices<'py>(shape: &Bound<'py, Self>) -> Bound<'py, PyArray2<f64>> {
        view(shape, aview2(shape.get().mesh().map_or(&[][..], TriangleMesh::vertices)))
    }

    /// The faces of a mesh, (m, 3): a read-only view.
    fn faces<'py>(shape: &Bound<'py, Self>) -> Bound<'py, PyArray2<u32>> {
        view(shape, aview2(shape.get().mesh().map_or(&[][..], TriangleMesh::faces)))
    }

    /// The low and the high corner of a box around the surface; infinite if it is unbounded, NaN for a mesh
    /// without triangles.
    fn bounds<'py>(&self, py: Python<'py>) -> Bound<'py, PyArray2<f64>> {
        bounds(py, &self.object)
    }

    /// The number of primitives that hits distinguish.
    fn primitives(&self) -> usize {
        match &self.object.geometry {
            Geometry::Surface(_) => 1,
            Geometry::Mesh(mesh) => mesh.len(),
            Geometry::Spheres(spheres) => spheres.len(),
            Geometry::Disks(disks) => disks.len(),
        }
    }

    /// The number of triangles of a mesh without area.
    fn degenerate(&self, py: Python<'_>) -> PyResult<usize> {
        self.mesh().map_or(Ok(0), |mesh| detach(py, || mesh.degenerate()))
    }

    /// Bytes held by primitives and by their hierarchy, which a mesh has after the first cast.
    fn bytes(&self) -> usize {
        match &self.object.geometry {
            Geometry::Surface(_) => size_of::<Object>(),
            Geometry::Mesh(mesh) => mesh.bytes(),
            Geometry::Spheres(spheres) => spheres.bytes(),
            Geometry::Disks(disks) => disks.bytes(),
        }
    }

    /// Every t of every line, in rows of equal length padded with NaN.
    fn roots<'py>(
        &self,
        py: Python<'py>,
        origins: Points<'py>,
        directions: Points<'py>,
    ) -> PyResult<Bound<'py, PyArray2<f64>>> {
        let (o, d) = rays(&origins, &directions)?;
        let least = match &self.object.geometry {
            Geometry::Surface(surface) => surface.most_roots(),
            _ => 1,
        };
        let (flat, width) = detach(py, || {
            let scene = Scene::new(vec![self.object.clone()]);
            scene.prepare();
            let roots = scene.roots_of_lines(0, o, d);
            let width = roots.iter().map(Vec::len).max().unwrap_or(0).max(least);
            let mut flat = memory::with_capacity(roots.len() * width);
            for t in roots {
                flat.extend(t.into_iter().chain(std::iter::repeat(f64::NAN)).take(width));
            }
            (flat, width)
        })?;
        PyArray1::from_vec(py, flat).reshape([o.len(), width])
    }
}

pub fn bounds<'py>(py: Python<'py>, object: &Object) -> Bound<'py, PyArray2<f64>> {
    let corners = match object.bounds() {
        Some(sides) => [sides.map(|side| side.low), sides.map(|side| side.high)],
        None if object.is_empty() => [[f64::NAN; 3]; 2],
        None => [[f64::NEG_INFINITY; 3], [f64::INFINITY; 3]],
    };
    PyArray2::from_array(py, &aview2(&corners))
}

/// The first two edges of a closed outline (n, 2) that touch where they must not; edge i starts at vertex i.
#[pyfunction]
pub fn self_crossing(py: Python<'_>, outline: PyReadonlyArray2<'_, f64>) -> PyResult<Option<(usize, usize)>> {
    let outline = elements("outline", &outline)?.as_chunks().0;
    detach(py, || shapes::self_crossing(outline))
}
