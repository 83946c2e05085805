//! The id of a root.

/// Which root of which primitive.
#[derive(Clone, Copy, Debug)]
pub struct Place {
    pub object: u32,
    pub primitive: u32,
    pub index: u8,
    /// The part of the surface.
    pub feature: u8,
}

impl Place {
    pub fn of_triangle(object: u32, primitive: u32) -> Self {
        Place { object, primitive, index: 0, feature: 0 }
    }
}
