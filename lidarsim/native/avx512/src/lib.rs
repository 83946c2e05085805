//! The kernels of the core for AVX-512, in a crate of their own as those for AVX2 are.

/// The kernels for a machine with AVX-512.
#[cfg(target_arch = "x86_64")]
pub static KERNELS: &dyn lidarsim_core::Kernels = &lidarsim_core::OnAvx512;
