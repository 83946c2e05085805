//! Shared helpers of unit tests.

/// Numbers in [0, 1) from a linear congruential generator.
pub fn numbers() -> impl FnMut() -> f64 {
    let mut state = 1_u64;
    move || {
        state = state.wrapping_mul(6364136223846793005).wrapping_add(1442695040888963407);
        (state >> 11) as f64 / (1_u64 << 53) as f64
    }
}

/// Runs a test on a large stack: unoptimized code has large frames.
pub fn with_large_frames(test: fn()) {
    let thread = std::thread::Builder::new().stack_size(1 << 26).spawn(test);
    assert!(thread.is_ok_and(|thread| thread.join().is_ok()));
}

/// The largest score that hill climbing finds, and its argument. From each of several starts, each step
/// changes one number a little or redraws it, and is kept if the score does not fall.
pub fn worst<const N: usize>(
    starts: usize,
    steps: usize,
    mut draw: impl FnMut(usize, &mut dyn FnMut() -> f64) -> f64,
    mut score: impl FnMut(&[f64; N]) -> f64,
) -> (f64, [f64; N]) {
    let mut next = numbers();
    let mut best = (f64::NEG_INFINITY, [0.0; N]);
    for _ in 0..starts {
        let mut at: [f64; N] = std::array::from_fn(|i| draw(i, &mut next));
        let mut height = score(&at);
        for _ in 0..steps {
            let (i, kind) = ((N as f64 * next()) as usize, (4.0 * next()) as u32);
            let mut other = at;
            other[i] = match kind {
                0 => draw(i, &mut next),
                1 => at[i].next_up(),
                2 => at[i].next_down(),
                _ => at[i] * (1.0 + (next() - 0.5) * 2.0_f64.powi(-(50.0 * next()) as i32)),
            };
            let reached = score(&other);
            if reached >= height {
                (at, height) = (other, reached);
            }
        }
        if height > best.0 {
            best = (height, at);
        }
    }
    best
}

/// Asserts that the worst case is about as known: a bound has this much slack and no more, so that no change
/// to it goes unnoticed.
pub fn assert_slack(what: &str, worst: f64, known: f64) {
    assert!(worst <= 1.0, "{what}: the bound is exceeded: {worst}");
    assert!(0.8 * known <= worst && worst <= 1.25 * known, "{what}: {worst} of the bound, {known} was known");
}
