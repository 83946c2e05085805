//! Fast paths for arguments of common types. Python converts all others, or reports what is wrong with them;
//! among these are subclasses of arrays, such as masked ones.

use lidarsim_core::Point;
use numpy::{PyArray1, PyArray2, PyArrayMethods, PyUntypedArrayMethods};
use pyo3::prelude::*;
use pyo3::types::{PyDict, PyFloat, PyInt, PyList, PyTuple};

/// The numbers of a tuple, a list or a float64 array, if they are three and finite.
#[pyfunction]
pub fn plain_vector(value: &Bound<'_, PyAny>) -> Option<(f64, f64, f64)> {
    vector(value).map(|[x, y, z]| (x, y, z))
}

fn vector(value: &Bound<'_, PyAny>) -> Option<Point> {
    let point = if let Ok(tuple) = value.cast_exact::<PyTuple>() {
        three(tuple.len(), |i| number(&*tuple.get_borrowed_item(i).ok()?))?
    } else if let Ok(list) = value.cast_exact::<PyList>() {
        three(list.len(), |i| number(&list.get_item(i).ok()?))?
    } else {
        let array = value.cast_exact::<PyArray1<f64>>().ok()?;
        three(if array.is_aligned() { array.len() } else { 0 }, |i| array.get_owned(i))?
    };
    point.iter().all(|x| x.is_finite()).then_some(point)
}

fn three(count: usize, item: impl Fn(usize) -> Option<f64>) -> Option<Point> {
    if count == 3 { Some([item(0)?, item(1)?, item(2)?]) } else { None }
}

/// Whether two values are aligned, C-contiguous float64 arrays of shape (n, 3).
#[pyfunction]
pub fn are_plain_points(origins: &Bound<'_, PyAny>, directions: &Bound<'_, PyAny>) -> bool {
    [origins, directions].into_iter().all(|value| {
        value
            .cast_exact::<PyArray2<f64>>()
            .is_ok_and(|array| array.shape()[1] == 3 && array.is_c_contiguous() && array.is_aligned())
    })
}

/// The numbers of vectors, followed by single numbers, both by name, if all are finite.
pub fn numbers(vectors: &Bound<'_, PyDict>, scalars: &Bound<'_, PyDict>) -> Option<Vec<f64>> {
    let mut numbers = Vec::with_capacity(3 * vectors.len() + scalars.len());
    for (_, value) in vectors {
        numbers.extend(vector(&value)?);
    }
    for (_, value) in scalars {
        numbers.push(number(&value).filter(|x| x.is_finite())?);
    }
    Some(numbers)
}

/// A float, or the float nearest to a 64-bit integer.
fn number(item: &Bound<'_, PyAny>) -> Option<f64> {
    if let Ok(float) = item.cast::<PyFloat>() {
        return Some(float.value());
    }
    Some(item.cast_exact::<PyInt>().ok()?.extract::<i64>().ok()? as f64)
}

/// The rows of a (3, 3) float64 array, if they are finite.
#[pyfunction]
pub fn plain_matrix(value: &Bound<'_, PyAny>) -> Option<[[f64; 3]; 3]> {
    matrix(value)
}

/// The rows of a (4, 4) float64 array, if they are finite and the last is (0, 0, 0, 1).
pub fn affine(value: &Bound<'_, PyAny>) -> Option<[[f64; 4]; 4]> {
    matrix(value).filter(|rows| rows[3] == [0.0, 0.0, 0.0, 1.0])
}

fn matrix<const N: usize>(value: &Bound<'_, PyAny>) -> Option<[[f64; N]; N]> {
    let array = value.cast_exact::<PyArray2<f64>>().ok()?;
    if array.shape() != [N, N] || !array.is_aligned() {
        return None;
    }
    let mut rows = [[0.0; N]; N];
    for (i, row) in rows.iter_mut().enumerate() {
        for (j, number) in row.iter_mut().enumerate() {
            *number = array.get_owned([i, j])?;
        }
    }
    rows.as_flattened().iter().all(|number| number.is_finite()).then_some(rows)
}
