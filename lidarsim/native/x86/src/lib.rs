//! The kernels of the core for AVX2 and AVX-512. They are a crate of their own because the compiler generates
//! their code while it generates that of the core, which halves the time of a build.

use lidarsim_core::{Kernels, Level};

/// The kernels for a level; none for [`Level::Scalar`], whose kernels the core has itself.
#[cfg(target_arch = "x86_64")]
pub fn kernels(level: Level) -> Option<&'static dyn Kernels> {
    match level {
        Level::Scalar => None,
        Level::Avx2 => Some(&lidarsim_core::OnAvx2),
        Level::Avx512 => Some(&lidarsim_core::OnAvx512),
    }
}

/// None: other processors run the portable kernels of the core.
#[cfg(not(target_arch = "x86_64"))]
pub fn kernels(_: Level) -> Option<&'static dyn Kernels> {
    None
}
