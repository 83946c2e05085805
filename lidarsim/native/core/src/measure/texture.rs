//! Textures: images of reflectivity on meshes.
//!
//! Coordinates are those of glTF: (0, 0) is the top left corner of the image, (1, 1) its bottom right corner,
//! and the centre of texel i of n is at (i + ½)/n.

use std::sync::Arc;

/// An image of reflectivities.
#[derive(Debug)]
pub struct Texture {
    /// In rows from the top.
    texels: Vec<f32>,
    height: usize,
    width: usize,
    /// For u and v.
    wrap: [Wrap; 2],
    interpolation: Interpolation,
}

/// What a texture is between the centres of its texels.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Interpolation {
    /// Bilinear.
    Linear,
    /// The texel in which a point lies.
    Nearest,
}

/// What a texture is beyond its edges.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Wrap {
    /// The image again.
    Repeat,
    /// The texel at the edge.
    Clamp,
    /// The image and its mirror image in turn.
    Mirror,
}

/// A texture on a mesh.
#[derive(Clone, Debug)]
pub struct TextureMap {
    pub texture: Arc<Texture>,
    pub coordinates: Arc<TextureCoordinates>,
}

/// The coordinates u, v, all finite.
#[derive(Debug)]
pub enum TextureCoordinates {
    /// Of each vertex.
    Vertex(Vec<[f64; 2]>),
    /// Of the corners of each triangle.
    Corner(Vec<[[f64; 2]; 3]>),
}

impl Interpolation {
    pub fn from_name(name: &str) -> Option<Self> {
        match name {
            "linear" => Some(Interpolation::Linear),
            "nearest" => Some(Interpolation::Nearest),
            _ => None,
        }
    }
}

impl Wrap {
    pub fn from_name(name: &str) -> Option<Self> {
        match name {
            "repeat" => Some(Wrap::Repeat),
            "clamp" => Some(Wrap::Clamp),
            "mirror" => Some(Wrap::Mirror),
            _ => None,
        }
    }

    /// The two of `count` texels, at least one, between whose centres the coordinate x is, and the share of
    /// the second, in [0, 1]; NaN for NaN.
    fn texels(self, x: f64, count: usize) -> ([usize; 2], f64) {
        // In the image: in [0, 1]. For x ≥ 0 the differences are exact, and for x < 0 correctly rounded.
        let x = match self {
            Wrap::Repeat => x - x.floor(),
            Wrap::Clamp => x.clamp(0.0, 1.0),
            Wrap::Mirror => {
                let x = x - 2.0 * (0.5 * x).floor();
                x.min(2.0 - x)
            }
        };
        // In [−½, count − ½], so that `first` is from −1 to count − 1.
        let x = x * count as f64 - 0.5;
        let (floor, last) = (x.floor(), count as i64 - 1);
        let first = floor as i64;
        let inside = |i: i64| match self {
            Wrap::Repeat if i < 0 => last,
            Wrap::Repeat if i > last => 0,
            _ => i.clamp(0, last),
        };
        ([first, first + 1].map(|i| inside(i) as usize), x - floor)
    }

    /// The one of `count` texels, at least one, in which the coordinate x lies; of a border the later one, as
    /// in OpenGL. `None` for NaN.
    fn texel(self, x: f64, count: usize) -> Option<usize> {
        // In one period, [0, 1] or [0, 2]; see `texels` for the rounding.
        let x = match self {
            Wrap::Repeat => x - x.floor(),
            Wrap::Clamp => x.clamp(0.0, 1.0),
            Wrap::Mirror => x - 2.0 * (0.5 * x).floor(),
        };
        let i = (x * count as f64) as usize;
        let inside = if i < count || self != Wrap::Mirror { i } else { (2 * count - 1).saturating_sub(i) };
        (!x.is_nan()).then_some(inside.min(count - 1))
    }
}

impl Texture {
    /// `None` unless there are `height` × `width` texels, and at least one.
    pub fn new(
        texels: Vec<f32>,
        [height, width]: [usize; 2],
        wrap: [Wrap; 2],
        interpolation: Interpolation,
    ) -> Option<Self> {
        let is_whole = !texels.is_empty() && height.checked_mul(width) == Some(texels.len());
        is_whole.then_some(Texture { texels, height, width, wrap, interpolation })
    }

    pub fn texels(&self) -> &[f32] {
        &self.texels
    }

    pub fn height_and_width(&self) -> [usize; 2] {
        [self.height, self.width]
    }

    /// Bilinear between the centres of four texels, or the nearest texel; NaN for NaN.
    fn at(&self, [u, v]: [f64; 2]) -> f64 {
        if self.interpolation == Interpolation::Nearest {
            let texel = self.wrap[0].texel(u, self.width).zip(self.wrap[1].texel(v, self.height));
            return texel.map_or(f64::NAN, |(x, y)| self.texels[y * self.width + x].into());
        }
        let (columns, across) = self.wrap[0].texels(u, self.width);
        let (rows, down) = self.wrap[1].texels(v, self.height);
        let row = |y: usize| between(columns.map(|x| self.texels[y * self.width + x].into()), across);
        between(rows.map(row), down)
    }
}

/// a at a share of 0. If both are ≥ 0, so is the result: b − a ≥ −a, and rounding preserves order.
fn between([a, b]: [f64; 2], share: f64) -> f64 {
    a + share * (b - a)
}

impl TextureMap {
    /// The reflectivity at barycentric coordinates of a triangle of these vertices.
    ///
    /// It is compiled once for all instruction sets.
    pub(super) fn at(&self, triangle: usize, vertices: [u32; 3], weights: [f64; 3]) -> f64 {
        let corners = match &*self.coordinates {
            TextureCoordinates::Vertex(all) => vertices.map(|i| all[i as usize]),
            TextureCoordinates::Corner(all) => all[triangle],
        };
        self.texture.at([0, 1].map(|axis| interpolate(corners.map(|corner| corner[axis]), weights)))
    }
}

/// Linear over a triangle, from its corners. The weights sum to 1 but for rounding, which must not lead out
/// of the range of the corners: finite coordinates then stay finite, and equal ones equal.
fn interpolate([a, b, c]: [f64; 3], [u, v, w]: [f64; 3]) -> f64 {
    (u * a + v * b + w * c).clamp(a.min(b).min(c), a.max(b).max(c))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn texels_lie_at_their_centres() {
        for wrap in [Wrap::Repeat, Wrap::Clamp, Wrap::Mirror] {
            for count in [1_usize, 2, 4, 512] {
                for i in 0..count {
                    let ([first, _], share) = wrap.texels((i as f64 + 0.5) / count as f64, count);
                    assert_eq!((first, share), (i, 0.0), "{wrap:?} {count}");
                }
            }
        }
    }

    #[test]
    fn edges_wrap() {
        let at = |wrap: Wrap, x: f64| wrap.texels(x, 4);
        assert_eq!(at(Wrap::Repeat, 0.0), ([3, 0], 0.5));
        assert_eq!(at(Wrap::Repeat, 1.0 - 0.0625), ([3, 0], 0.25));
        assert_eq!(at(Wrap::Repeat, -0.25 - 0.0625), ([2, 3], 0.25));
        assert_eq!(at(Wrap::Clamp, -7.0), ([0, 0], 0.5));
        assert_eq!(at(Wrap::Clamp, 7.0), ([3, 3], 0.5));
        assert_eq!(at(Wrap::Mirror, -0.375), ([1, 2], 0.0));
        assert_eq!(at(Wrap::Mirror, 1.375), ([2, 3], 0.0));
        assert_eq!(at(Wrap::Mirror, 2.375), ([1, 2], 0.0));
        assert_eq!(at(Wrap::Mirror, 1.0), ([3, 3], 0.5));
    }

    #[test]
    fn any_coordinate_is_in_the_image() {
        let numbers = [0.0, 5e-324, 1e-17, 0.5, 1.0, 1e9 + 0.3, 4503599627370495.5, 1e300, f64::MAX];
        for wrap in [Wrap::Repeat, Wrap::Clamp, Wrap::Mirror] {
            for count in [1_usize, 3, 1 << 20] {
                for x in numbers.iter().flat_map(|x| [*x, -x]) {
                    let (texels, share) = wrap.texels(x, count);
                    assert!(texels.iter().all(|i| *i < count) && (0.0..=1.0).contains(&share), "{x}");
                }
                assert!(wrap.texels(f64::NAN, count).1.is_nan());
            }
        }
    }

    #[test]
    fn the_nearest_texel_is_that_of_opengl() {
        // OpenGL 4.6, table 8.19: of the texel i = ⌊x·count⌋ on the endless line.
        let wrapped = |wrap: Wrap, i: i64, count: i64| match wrap {
            Wrap::Repeat => i.rem_euclid(count),
            Wrap::Clamp => i.clamp(0, count - 1),
            Wrap::Mirror => {
                let a = i.rem_euclid(2 * count) - count;
                count - 1 - if a >= 0 { a } else { -(1 + a) }
            }
        };
        for wrap in [Wrap::Repeat, Wrap::Clamp, Wrap::Mirror] {
            for count in [1_usize, 2, 4, 512] {
                for eighth in -40_i32..=40 {
                    let x = f64::from(eighth) / 8.0;
                    let i = (x * count as f64).floor() as i64;
                    let expected = wrapped(wrap, i, count as i64) as usize;
                    assert_eq!(wrap.texel(x, count), Some(expected), "{wrap:?} {count} {x}");
                }
                for x in
                    [-1e-17, -5e-324, 0.0, 1.0, 1e9 + 0.3, 4503599627370495.5, 1e300, f64::MAX, -f64::MAX]
                {
                    assert!(wrap.texel(x, count).is_some_and(|i| i < count), "{wrap:?} {count} {x}");
                }
                assert_eq!(wrap.texel(f64::NAN, count), None);
            }
        }
    }

    #[test]
    fn rounding_does_not_lead_out_of_the_range_of_the_corners() {
        let third = 1.0 / 3.0;
        let weights = [third, third, 1.0 - third];
        assert_eq!(interpolate([f64::MAX; 3], weights), f64::MAX);
        assert_eq!(interpolate([0.1; 3], [0.1, 0.2, 0.7]), 0.1);
        assert_eq!(interpolate([0.0, 1.0, 3.0], [0.25, 0.5, 0.25]), 1.25);
    }

    #[test]
    fn no_reflectivity_is_negative() {
        for share in [0.0, 0.5, 1.0 - f64::EPSILON, 1.0] {
            for [a, b] in [[1.0, 0.0], [f64::from(f32::MAX), 1e-45], [0.3, 0.1], [1e-45, 0.0]] {
                assert!(between([a, b], share) >= 0.0);
            }
        }
    }
}
