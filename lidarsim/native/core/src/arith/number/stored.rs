//! Numbers in memory, passed from one function that computes with them to the next.

/// Numbers of M rays, each within `error` of `high + low`, and exactly zero if all three are zero.
#[derive(Clone, Copy, Debug)]
#[repr(C, align(64))]
pub struct Stored<const M: usize> {
    pub(super) high: [f64; M],
    pub(super) low: [f64; M],
    pub(super) error: [f64; M],
}

impl<const M: usize> Stored<M> {
    pub const UNSET: Self = Stored { high: [0.0; M], low: [0.0; M], error: [0.0; M] };

    /// Sets all numbers to that of one lane.
    #[inline(always)]
    pub fn repeat(&mut self, lane: usize) {
        let Stored { high, low, error } = self;
        (*high, *low, *error) = ([high[lane]; M], [low[lane]; M], [error[lane]; M]);
    }
}
