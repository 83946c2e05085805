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
    pub(super) fn at(&self, primitive: i32) -> u32 {
        match self {
            Labels::Object(label) => *label,
            Labels::Face(labels) => labels[primitive as usize],
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
    /// Where a ray hit this primitive of the object: `hit` tells where, with the origin, the direction and the time.
    #[inline(always)]
    pub(super) fn at(
        &self,
        primitive: i32,
        hit: impl FnOnce() -> (Hit, Point, Point, f64),
        caster: &impl Caster,
    ) -> f64 {
        match self {
            Reflectivity::Object(value) => *value,
            Reflectivity::Face(values) => values[primitive as usize],
            Reflectivity::Vertex(values) => {
                let (hit, origin, direction, time) = hit();
                match caster.shares(&hit, origin, direction, time) {
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
