//! What a lidar can tell of an object.

use super::backscatter::Backscatter;
use super::grain::Grain;
use super::texture::TextureMap;
use crate::scene::{Hit, Scene, TimedRay};

/// What a lidar measures of an object besides its geometry.
#[derive(Clone, Debug)]
pub struct Appearance {
    pub labels: Labels,
    /// The instance that the object is, or is a part of.
    pub instance: u32,
    pub reflectivity: Reflectivity,
    /// None: Lambert's.
    pub backscatter: Option<Backscatter>,
    /// None: without texture.
    pub grain: Option<Grain>,
    /// The shares of light that go on, straight and mirrored.
    pub transmission: f64,
    pub mirror: f64,
}

impl Appearance {
    /// Whether light goes on from the object.
    #[inline(always)]
    pub fn goes_on(&self) -> bool {
        self.transmission > 0.0 || self.mirror > 0.0
    }
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

/// The share of light that an object returns, 1 for a white diffuser.
#[derive(Clone, Debug)]
pub enum Reflectivity {
    Object(f64),
    /// One a triangle.
    Face(Vec<f64>),
    /// One a vertex, linear in between.
    Vertex(Vec<f64>),
    Texture(TextureMap),
}

impl Reflectivity {
    /// The reflectivity at a hit on a primitive; `hit` gives the hit and the ray if they are needed.
    #[inline(always)]
    pub(super) fn at(&self, primitive: i32, hit: impl FnOnce() -> (Hit, TimedRay), scene: &Scene) -> f64 {
        let place = || {
            let (hit, ray) = hit();
            scene.barycentric(&hit, &ray)
        };
        match self {
            Reflectivity::Object(value) => *value,
            Reflectivity::Face(values) => values[primitive as usize],
            Reflectivity::Vertex(values) => place().map_or(f64::NAN, |(vertices, [u, v, w])| {
                let [a, b, c] = vertices.map(|i| values[i as usize]);
                u * a + v * b + w * c
            }),
            Reflectivity::Texture(map) => {
                place().map_or(f64::NAN, |(vertices, weights)| map.at(primitive as usize, vertices, weights))
            }
        }
    }
}
