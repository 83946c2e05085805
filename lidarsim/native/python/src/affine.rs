//! Affine maps, the form of transforms.

use lidarsim_core::{Affine, Object};
use numpy::ndarray::aview2;
use numpy::{PyArray2, PyArrayMethods};
use pyo3::prelude::*;

use crate::{argument_error, plain};

/// A 4×4 matrix whose last row is (0, 0, 0, 1).
#[pyclass(frozen, name = "Affine", module = "lidarsim._native")]
#[derive(Clone, Copy)]
pub struct PyAffine {
    rows: [[f64; 4]; 4],
}

impl PyAffine {
    /// An object under one more map.
    pub fn image_of(self, object: &Object) -> PyResult<Object> {
        let [x, y, z, _] = self.rows;
        object
            .transformed(Affine::from_rows([x, y, z]))
            .ok_or_else(|| argument_error("transform", "an invertible matrix", "determinant 0"))
    }

    /// The matrix, read-only.
    pub fn matrix(self, py: Python<'_>) -> Bound<'_, PyArray2<f64>> {
        let matrix = PyArray2::from_array(py, &aview2(&self.rows));
        matrix.readwrite().make_nonwriteable();
        matrix
    }
}

#[pymethods]
impl PyAffine {
    #[new]
    pub fn new(rows: [[f64; 4]; 4]) -> Self {
        PyAffine { rows }
    }

    /// Fast path for an array in the usual form; `None` for others.
    #[staticmethod]
    fn plain(matrix: &Bound<'_, PyAny>) -> Option<Self> {
        plain::affine(matrix).map(Self::new)
    }
}
