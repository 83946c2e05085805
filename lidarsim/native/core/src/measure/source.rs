//! What returns come from.

/// Where the light of a return comes from. The numbers are part of the interface.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[repr(u8)]
pub(super) enum Source {
    Surface = 0,
    Atmosphere = 1,
    FalseReturn = 2,
}
