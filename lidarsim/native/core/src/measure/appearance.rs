//! What a lidar can tell of an object.

use super::Caster;
use crate::geometry::vector::Point;
use crate::scene::Hit;

/// What a lidar can tell of an object, besides where it is.
#[derive(Clone, Debug)]
pub struct Appearance {
    pub labels: Labels,
    /// The number of what the object is, or is a part of.
    pub instance: u32,
    pub reflectivity: Reflectivity,
}

/// The class of an object.
#[derive(Clone, Debug)]
pub enum Labels {
    Object(u32),
    /// One a triangle.
    Face(Vec<u32>),
}

impl Labels {
    #[inline(always)]
    pub(super) fn at(&self, hit: &Hit) -> u32 {
        match self {
            Labels::Object(label) => *label,
            Labels::Face(labels) => labels[hit.primitive as usize],
        }
    }
}

/// How much light an object returns, as a share of what a white diffuser does.
#[derive(Clone, Debug)]
pub enum Reflectivity {
    Object(f64),
    /// One a triangle.
    Face(Vec<f64>),
    /// One a vertex, linear in between.
    Vertex(Vec<f64>),
}

impl Reflectivity {
    /// Where a ray, of an origin, a direction and a time, hit the object.
    #[inline(always)]
    pub(super) fn at(&self, hit: &Hit, ray: impl FnOnce() -> (Point, Point, f64), caster: &impl Caster) -> f64 {
        match self {
            Reflectivity::Object(value) => *value,
            Reflectivity::Face(values) => values[hit.primitive as usize],
            Reflectivity::Vertex(values) => {
                let (origin, direction, time) = ray();
                match caster.shares(hit, origin, direction, time) {
                    Some((vertices, [u, v, w])) => {
                        let [a, b, c] = vertices.map(|i| values[i as usize]);
                        u * a + v * b + w * c
                    }
                    None => f64::NAN,
                }
            }
        }
    }
}
