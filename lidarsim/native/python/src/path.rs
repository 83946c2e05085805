//! Poses over time, of sensors and of moving objects.

use std::sync::Arc;

use lidarsim_core::{Cubic, LARGEST, Path, Point, Pose, Step, Velocity, memory};
use numpy::{PyReadonlyArray1, PyReadonlyArray2, PyUntypedArrayMethods};
use pyo3::exceptions::PyValueError;
use pyo3::prelude::*;

use crate::{argument_error, detach, elements, into_array, plain};

/// The pose of the sensor at each time.
#[pyclass(frozen, name = "Path", module = "lidarsim._native")]
pub struct PyPath {
    pub path: Arc<Path>,
}

pub type Matrix = [[f64; 4]; 4];

/// The matrices of an array of shape (n, 16).
pub fn matrices<'a>(name: &str, array: &'a PyReadonlyArray2<'_, f64>) -> PyResult<&'a [Matrix]> {
    Ok(elements(name, array)?.as_chunks().0.as_chunks().0)
}

pub fn pose([x, y, z, _]: Matrix) -> Pose {
    Pose::from_rows([x, y, z])
}

impl From<Path> for PyPath {
    fn from(path: Path) -> Self {
        PyPath { path: Arc::new(path) }
    }
}

#[pymethods]
impl PyPath {
    #[staticmethod]
    fn still(matrix: &Bound<'_, PyAny>) -> PyResult<Self> {
        let matrix = plain::affine(matrix).map_or_else(|| matrix.extract(), Ok)?;
        Ok(Path::Still(pose(matrix)).into())
    }

    /// Constant velocities in the moving frame, whose pose at time 0 is `matrix`.
    #[staticmethod]
    fn twist(matrix: Matrix, linear: Point, angular: Point) -> Self {
        Path::twist(pose(matrix), linear, angular).into()
    }

    /// n ascending times; the matrix at each, (n, 16); and the steps between them, (n - 1, 18): the three
    /// coefficients of the translation and those of the rotation vector.
    #[staticmethod]
    fn knots(
        py: Python<'_>,
        times: PyReadonlyArray1<'_, f64>,
        matrices: PyReadonlyArray2<'_, f64>,
        steps: PyReadonlyArray2<'_, f64>,
    ) -> PyResult<Self> {
        let n = times.len();
        if n == 0 || matrices.shape() != [n, 16] || steps.shape() != [n - 1, 18] {
            return Err(PyValueError::new_err(
                "times, matrices, steps: expected shapes (n,), (n, 16) and (n - 1, 18), n > 0",
            ));
        }
        let times = elements("times", &times)?;
        let poses = self::matrices("matrices", &matrices)?.iter().map(|&matrix| pose(matrix));
        let steps: &[[[Point; 3]; 2]] = elements("steps", &steps)?.as_chunks().0.as_chunks().0.as_chunks().0;
        let steps = steps.iter().map(|&[shift, turn]| Step { shift: Cubic(shift), turn: Cubic(turn) });
        let path = detach(py, || {
            let (times, poses, steps) = (memory::copy(times), memory::collect(poses), memory::collect(steps));
            let end = times[n - 1];
            Path::Knots { times, poses, steps, end }
        })?;
        Ok(path.into())
    }

    /// The path of a sensor with this mount on a body that moves along this path.
    fn mounted(&self, matrix: Matrix) -> Self {
        self.path.mounted(&pose(matrix)).into()
    }

    /// The same path over a span that continues to `until`, at the velocities of its end.
    fn hold(&self, until: f64) -> PyResult<Self> {
        let path = self.path.hold(until);
        if path.at(until).rows().as_flattened().iter().all(|x| x.abs() <= LARGEST) {
            return Ok(path.into());
        }
        let got = format!("one that leaves it by {until} s");
        Err(argument_error("pose", "a trajectory within the range of float64", got))
    }

    /// The first and last time for which there is a pose.
    fn span(&self) -> (f64, f64) {
        self.path.span().into()
    }

    /// Poses at some times, (n, 4, 4).
    fn at<'py>(&self, py: Python<'py>, times: PyReadonlyArray1<'py, f64>) -> PyResult<Bound<'py, PyAny>> {
        let times = elements("times", &times)?;
        let poses = detach(py, || {
            memory::collect(times.iter().map(|&time| {
                let [x, y, z] = self.path.at(time).rows();
                [x, y, z, [0.0, 0.0, 0.0, 1.0]]
            }))
        })?;
        into_array(py, poses.into_flattened().into_flattened(), &[times.len(), 4, 4])
    }

    /// Velocities at times within the span, (n, 2, 3): linear in the world, angular in the moving frame.
    fn velocity<'py>(
        &self,
        py: Python<'py>,
        times: PyReadonlyArray1<'py, f64>,
    ) -> PyResult<Bound<'py, PyAny>> {
        let times = elements("times", &times)?;
        let velocities = detach(py, || {
            memory::collect(times.iter().map(|&time| {
                let Velocity { linear, angular } = self.path.velocity(time);
                [linear, angular]
            }))
        })?;
        into_array(py, velocities.into_flattened().into_flattened(), &[times.len(), 2, 3])
    }
}
