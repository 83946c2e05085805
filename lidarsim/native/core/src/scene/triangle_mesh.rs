//! Triangle mesh: triangles over shared vertices, with a hierarchy of their boxes.

use crate::arith::number::Interval;
use crate::arith::simd::{self, Isa};
use crate::bvh::Bvh;
use crate::geometry::dop::Dop;
use crate::geometry::ray::union;
use crate::geometry::vector::Point;
use crate::once::Once;
use crate::shapes::Triangle;
use crate::shapes::triangle::{LEAF_SIZE, Leaf};
use crate::{memory, stop};

#[derive(Debug)]
pub struct TriangleMesh {
    vertices: Vec<Point>,
    faces: Vec<[u32; 3]>,
    /// Computed on first use, once for all scenes that share the mesh.
    bounds: Once<Option<[Interval; 3]>>,
    /// Likewise, if the mesh is transformed or moves.
    dop: Once<Option<Dop>>,
    /// Built on the first cast, without triangles that have no area.
    hierarchy: Once<Bvh<Leaf>>,
    /// Whether the hierarchy has all triangles.
    covered: Once<bool>,
}

impl TriangleMesh {
    /// `None` if a face refers to a missing vertex.
    pub fn new(vertices: Vec<Point>, faces: Vec<[u32; 3]>) -> Option<Self> {
        let known = |i: &u32| (*i as usize) < vertices.len();
        let is_right = faces.iter().flatten().all(known);
        is_right.then_some(TriangleMesh {
            vertices,
            faces,
            bounds: Once::new(),
            dop: Once::new(),
            hierarchy: Once::new(),
            covered: Once::new(),
        })
    }

    /// The same faces over other vertices, with the hierarchy refitted to them: it has the same leaves, whose
    /// triangles are taken anew. If it lacks triangles, it is built again on first use. `None` if the number
    /// of vertices differs.
    pub fn deformed(&self, vertices: Vec<Point>) -> Option<Self> {
        if vertices.len() != self.vertices.len() {
            return None;
        }
        let triangle = |id: u32| {
            let [a, b, c] = self.faces[id as usize].map(|v| vertices[v as usize]);
            Triangle(a, b, c)
        };
        if !self.is_covered() {
            return TriangleMesh::new(vertices, memory::copy(&self.faces));
        }
        let (refitted, around) = self.hierarchy().remade(|leaf| Leaf::with_bounds(leaf.ids(), triangle));
        let (bounds, hierarchy, covered) = (Once::new(), Once::new(), Once::new());
        bounds.get_or_make(|| around);
        hierarchy.get_or_make(|| refitted);
        covered.get_or_make(|| true);
        let faces = memory::copy(&self.faces);
        Some(TriangleMesh { vertices, faces, bounds, dop: Once::new(), hierarchy, covered })
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

    /// Prefetches the vertex indices of a triangle.
    #[inline(always)]
    pub fn prefetch_face<I: Isa>(&self, id: u32) {
        simd::prefetch_across::<I, _>(&self.faces[id as usize]);
    }

    #[inline(always)]
    pub fn corners(&self, id: u32) -> [&Point; 3] {
        let [a, b, c] = self.faces[id as usize];
        [&self.vertices[a as usize], &self.vertices[b as usize], &self.vertices[c as usize]]
    }

    #[inline(always)]
    pub fn triangle(&self, id: u32) -> Triangle {
        let [a, b, c] = self.corners(id);
        Triangle(*a, *b, *c)
    }

    pub fn degenerate(&self) -> usize {
        let is_degenerate = |&id: &u32| {
            stop::poll();
            self.triangle(id).is_degenerate()
        };
        (0..self.len() as u32).filter(is_degenerate).count()
    }

    pub fn hierarchy(&self) -> &Bvh<Leaf> {
        // Only the build runs in the pool: a waiting thread of a pool takes up other work, which must not
        // reenter here.
        self.hierarchy.get_or_make(|| {
            // Room for leaves that are half full.
            memory::expect_room(2 * self.len().div_ceil(LEAF_SIZE) * size_of::<Leaf>(), || {
                format!("a hierarchy over {} triangles", self.len())
            });
            Bvh::new(
                self.len(),
                |id| self.triangle(id).bounds_of_area(),
                LEAF_SIZE,
                |ids| Leaf::new(ids, |id| self.triangle(id)),
            )
        })
    }

    fn is_covered(&self) -> bool {
        *self.covered.get_or_make(|| {
            self.hierarchy().leaves().iter().map(|leaf| leaf.ids().len()).sum::<usize>() == self.len()
        })
    }

    pub fn bounds(&self) -> Option<[Interval; 3]> {
        *self.bounds.get_or_make(|| {
            let first = self.vertices[self.faces.first()?[0] as usize].map(Interval::point);
            Some(self.faces.chunks(1 << 16).fold(first, |bounds, faces| {
                stop::poll();
                let all = faces.iter().flatten().map(|&v| self.vertices[v as usize].map(Interval::point));
                all.fold(bounds, union)
            }))
        })
    }

    /// The polytope of all vertices that faces use; `None` if there are none.
    pub fn dop(&self) -> Option<&Dop> {
        let dop = self.dop.get_or_make(|| {
            let mut used = memory::with_capacity(self.vertices.len());
            used.resize(self.vertices.len(), false);
            for (i, &v) in self.faces.iter().flatten().enumerate() {
                if i.is_multiple_of(1 << 16) {
                    stop::poll();
                }
                used[v as usize] = true;
            }
            Dop::of_points(self.vertices.iter().zip(&used).filter(|(_, used)| **used).map(|(v, _)| *v))
        });
        dop.as_ref()
    }

    pub fn bytes(&self) -> usize {
        self.vertices.len() * size_of::<Point>()
            + self.faces.len() * size_of::<[u32; 3]>()
            + self.hierarchy.get().map_or(0, Bvh::bytes)
    }
}
