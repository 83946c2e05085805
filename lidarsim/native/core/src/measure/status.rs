//! What became of a pulse.

/// Why a pulse is or is not a point. The numbers are part of the interface.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[repr(u8)]
pub enum Status {
    Hit = 0,
    Miss = 1,
    BelowMinRange = 2,
    BeyondMaxRange = 3,
    BelowThreshold = 4,
    Dropped = 5,
}

impl Status {
    pub(super) const COUNT: usize = 6;

    pub(super) const ALL: [Status; Status::COUNT] = [
        Status::Hit,
        Status::Miss,
        Status::BelowMinRange,
        Status::BeyondMaxRange,
        Status::BelowThreshold,
        Status::Dropped,
    ];
}
