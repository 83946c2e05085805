//! The kernels of the core for any machine, in a crate of their own as those for AVX2 are.

/// The kernels for any machine.
pub static KERNELS: &dyn lidarsim_core::Kernels = &lidarsim_core::OnPortable;
