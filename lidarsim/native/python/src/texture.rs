//! Textures of reflectivity.

use std::sync::Arc;

use lidarsim_core::measure::{Interpolation, Texture, TextureCoordinates, TextureMap, Wrap};
use lidarsim_core::memory;
use numpy::ndarray::{ArrayView, ArrayView2};
use numpy::{PyArray2, PyArrayDyn, PyReadonlyArray2, PyReadonlyArrayDyn, PyUntypedArrayMethods};
use pyo3::prelude::*;

use crate::{argument_error, detach, elements, view};

/// An image of reflectivities.
#[pyclass(frozen, name = "Texture", module = "lidarsim._native")]
pub struct PyTexture {
    texture: Arc<Texture>,
}

/// A texture on a mesh, shared by all objects of its material.
#[pyclass(frozen, name = "TextureMap", module = "lidarsim._native")]
pub struct PyTextureMap {
    pub map: TextureMap,
}

#[pymethods]
impl PyTexture {
    /// Values (height, width), and what the texture is beyond its edges and between the centres of its
    /// texels.
    #[new]
    fn new(
        py: Python<'_>,
        values: PyReadonlyArray2<'_, f32>,
        wrap_u: &str,
        wrap_v: &str,
        interpolation: &str,
    ) -> PyResult<Self> {
        let (size, texels) = ([values.shape()[0], values.shape()[1]], elements("values", &values)?);
        let parse = |name: &str| {
            Wrap::from_name(name).ok_or_else(|| argument_error("wrap", "repeat, clamp or mirror", name))
        };
        let wrap = [parse(wrap_u)?, parse(wrap_v)?];
        let interpolation = Interpolation::from_name(interpolation)
            .ok_or_else(|| argument_error("interpolation", "linear or nearest", interpolation))?;
        let texture = detach(py, || Texture::new(memory::copy(texels), size, wrap, interpolation))?
            .ok_or_else(|| argument_error("values", "at least one", format!("shape {size:?}")))?;
        Ok(PyTexture { texture: Arc::new(texture) })
    }

    /// The values: a read-only view.
    fn values<'py>(texture: &Bound<'py, Self>) -> PyResult<Bound<'py, PyArray2<f32>>> {
        let image = &texture.get().texture;
        let [height, width] = image.height_and_width();
        let values = ArrayView2::from_shape((height, width), image.texels())
            .map_err(|why| argument_error("values", "shape (height, width)", why.to_string()))?;
        Ok(view(texture, values))
    }

    /// The texture on a mesh: coordinates (n, 2) of its vertices or (m, 3, 2) of the corners of its faces.
    fn map(&self, py: Python<'_>, coordinates: PyReadonlyArrayDyn<'_, f64>) -> PyResult<PyTextureMap> {
        let pairs = elements("texture_coordinates", &coordinates)?.as_chunks().0;
        let coordinates = match coordinates.shape() {
            [_, 2] => detach(py, || TextureCoordinates::Vertex(memory::copy(pairs)))?,
            [_, 3, 2] => detach(py, || TextureCoordinates::Corner(memory::copy(pairs.as_chunks().0)))?,
            shape => {
                let got = format!("{shape:?}");
                return Err(argument_error("texture_coordinates", "shape (n, 2) or (m, 3, 2)", got));
            }
        };
        let map = TextureMap { texture: self.texture.clone(), coordinates: Arc::new(coordinates) };
        Ok(PyTextureMap { map })
    }
}

#[pymethods]
impl PyTextureMap {
    /// The coordinates: a read-only view.
    fn coordinates<'py>(map: &Bound<'py, Self>) -> PyResult<Bound<'py, PyArrayDyn<f64>>> {
        let (shape, numbers) = match &*map.get().map.coordinates {
            TextureCoordinates::Vertex(rows) => (vec![rows.len(), 2], rows.as_flattened()),
            TextureCoordinates::Corner(rows) => (vec![rows.len(), 3, 2], rows.as_flattened().as_flattened()),
        };
        let rows = ArrayView::from_shape(shape, numbers)
            .map_err(|why| argument_error("texture_coordinates", "rows", why.to_string()))?;
        Ok(view(map, rows))
    }
}
