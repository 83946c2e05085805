//! Arguments in the forms that most have, taken at once. Of all others Python finds out what they are, or what is wrong with them.

use numpy::{PyReadonlyArray1, PyReadonlyArray2, PyUntypedArrayMethods};
use pyo3::prelude::*;
use pyo3::types::{PyFloat, PyInt, PyList, PyTuple};

/// The numbers of a tuple, a list or an array of float64, if they are three and finite.
#[pyfunction]
pub fn plain_vector(value: &Bound<'_, PyAny>) -> Option<(f64, f64, f64)> {
    let (x, y, z) = if let Ok(tuple) = value.cast_exact::<PyTuple>() {
        three(tuple.len(), |i| number(&*tuple.get_borrowed_item(i).ok()?))?
    } else if let Ok(list) = value.cast_exact::<PyList>() {
        three(list.len(), |i| number(&list.get_item(i).ok()?))?
    } else {
        let array: PyReadonlyArray1<'_, f64> = value.extract().ok()?;
        three(if array.is_aligned() { array.len() } else { 0 }, |i| array.get(i).copied())?
    };
    (x.is_finite() && y.is_finite() && z.is_finite()).then_some((x, y, z))
}

fn three(count: usize, item: impl Fn(usize) -> Option<f64>) -> Option<(f64, f64, f64)> {
    if count == 3 { Some((item(0)?, item(1)?, item(2)?)) } else { None }
}

/// A float, or the float nearest to an integer of 64 bits.
fn number(item: &Bound<'_, PyAny>) -> Option<f64> {
    if let Ok(float) = item.cast::<PyFloat>() {
        return Some(float.value());
    }
    Some(item.cast_exact::<PyInt>().ok()?.extract::<i64>().ok()? as f64)
}

/// The rows of a C-contiguous array (4, 4) of float64, if they are finite and the last one is (0, 0, 0, 1).
pub fn affine(value: &Bound<'_, PyAny>) -> Option<[[f64; 4]; 4]> {
    let array: PyReadonlyArray2<'_, f64> = value.extract().ok()?;
    if !array.is_c_contiguous() || array.shape() != [4, 4] {
        return None;
    }
    let rows: [[f64; 4]; 4] = array.as_slice().ok()?.as_chunks().0.try_into().ok()?;
    let is_finite = rows.as_flattened().iter().all(|number| number.is_finite());
    (is_finite && rows[3] == [0.0, 0.0, 0.0, 1.0]).then_some(rows)
}
