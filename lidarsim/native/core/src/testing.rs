//! What unit tests share.

/// Numbers in [0, 1) from a linear congruential generator.
pub fn numbers() -> impl FnMut() -> f64 {
    let mut state = 1_u64;
    move || {
        state = state.wrapping_mul(6364136223846793005).wrapping_add(1442695040888963407);
        (state >> 11) as f64 / (1_u64 << 53) as f64
    }
}

/// Runs a test on a large stack: code that is not optimised has large frames.
pub fn with_large_frames(test: fn()) {
    let thread = std::thread::Builder::new().stack_size(1 << 26).spawn(test);
    assert!(thread.is_ok_and(|thread| thread.join().is_ok()));
}
