//! Triangle mesh: triangles over shared vertices, with a hierarchy of their boxes.

use std::sync::OnceLock;

use super::{Surface, Triangle};
use crate::bvh::Bvh;
use crate::number::Interval;
use crate::vector::Point;

#[derive(Debug)]
pub struct TriangleMesh {
    vertices: Vec<Point>,
    faces: Vec<[u32; 3]>,
    /// Built when it is first cast at.
    hierarchy: OnceLock<Bvh>,
}

impl TriangleMesh {
    /// None if a face names a vertex that is not there.
    pub fn new(vertices: Vec<Point>, faces: Vec<[u32; 3]>) -> Option<Self> {
        let known = |i: &u32| (*i as usize) < vertices.len();
        faces.iter().flatten().all(known).then_some(TriangleMesh { vertices, faces, hierarchy: OnceLock::new() })
    }

    pub fn vertices(&self) -> &[Point] {
        &self.vertices
    }

    pub fn faces(&self) -> &[[u32; 3]] {
        &self.faces
    }

    pub fn len(&self) -> usize {
        self.faces.len()
    }

    pub fn is_empty(&self) -> bool {
        self.faces.is_empty()
    }

    #[inline]
    pub fn triangle(&self, id: u32) -> Triangle {
        let [a, b, c] = self.faces[id as usize].map(|v| self.vertices[v as usize]);
        Triangle(a, b, c)
    }

    pub fn degenerate(&self) -> usize {
        (0..self.len() as u32).filter(|&id| self.triangle(id).is_degenerate()).count()
    }

    pub fn hierarchy(&self) -> &Bvh {
        self.hierarchy.get_or_init(|| {
            let bounds: Vec<_> = (0..self.len() as u32).map(|id| self.triangle(id).bounds()).collect();
            Bvh::new(&bounds)
        })
    }

    pub fn bounds(&self) -> Option<[Interval; 3]> {
        let mut all = self.faces.iter().flatten().map(|&v| self.vertices[v as usize]);
        let first = all.next()?.map(Interval::point);
        Some(all.fold(first, |b, v| {
            std::array::from_fn(|i| Interval { low: b[i].low.min(v[i]), high: b[i].high.max(v[i]) })
        }))
    }

    pub fn bytes(&self) -> usize {
        self.vertices.len() * size_of::<Point>()
            + self.faces.len() * size_of::<[u32; 3]>()
            + self.hierarchy.get().map_or(0, Bvh::bytes)
    }
}
