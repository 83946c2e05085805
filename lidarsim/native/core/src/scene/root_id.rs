//! The id of a root.

/// Identifies a root of a line on a primitive.
#[derive(Clone, Copy, Debug)]
pub struct RootId {
    pub object: u32,
    pub primitive: u32,
    /// 0 or 1, or `TOUCHING` if the line is known to touch the surface there.
    pub index: u8,
    /// The part of the surface.
    pub feature: u8,
}

impl RootId {
    pub fn of_triangle(object: u32, primitive: u32) -> Self {
        RootId { object, primitive, index: 0, feature: 0 }
    }
}
