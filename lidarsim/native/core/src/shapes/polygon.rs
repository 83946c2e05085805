//! Polygon: a set of triangles with shared vertices, hence exact and watertight as a mesh is.
//!
//! This file adds the check that the outline does not cross itself.

use std::cmp::Ordering;

use crate::arith::number::{Number, Predicate, Uncertain, decide};
use crate::stop;

type Point2 = [f64; 2];

/// The sign of the area of a, b, c: positive for a left turn.
struct Orientation(Point2, Point2, Point2);

impl Predicate for Orientation {
    type Answer = Ordering;

    fn evaluate<N: Number<Floats = f64>>(&self) -> Result<Ordering, Uncertain> {
        let [a, b, c] = [self.0, self.1, self.2].map(|p| p.map(N::exact));
        let left = b[0].minus(&a[0]).times(&c[1].minus(&a[1]));
        left.minus(&b[1].minus(&a[1]).times(&c[0].minus(&a[0]))).sign()
    }
}

/// Whether `p`, on the line through a and b, lies between them.
fn between(a: Point2, b: Point2, p: Point2) -> bool {
    (0..2).all(|i| a[i].min(b[i]) <= p[i] && p[i] <= a[i].max(b[i]))
}

/// Whether two closed segments share a point.
fn intersect(a: Point2, b: Point2, c: Point2, d: Point2) -> bool {
    let turns = [Orientation(a, b, c), Orientation(a, b, d), Orientation(c, d, a), Orientation(c, d, b)]
        .map(|turn| decide(&turn));
    let opposite = |x: Ordering, y: Ordering| x == y.reverse() && x != Ordering::Equal;
    (opposite(turns[0], turns[1]) && opposite(turns[2], turns[3]))
        || (turns[0] == Ordering::Equal && between(a, b, c))
        || (turns[1] == Ordering::Equal && between(a, b, d))
        || (turns[2] == Ordering::Equal && between(c, d, a))
        || (turns[3] == Ordering::Equal && between(c, d, b))
}

/// The first two edges of a closed outline that touch where they must not; edge i runs from vertex i to the
/// next.
pub fn self_crossing(outline: &[Point2]) -> Option<(usize, usize)> {
    let n = outline.len();
    let edge = |i: usize| (outline[i], outline[(i + 1) % n]);
    let touch = |i: usize, j: usize| {
        let ((a, b), (c, d)) = (edge(i), edge(j));
        if j == i + 1 {
            // Neighbours share only b = c: d must not fold back.
            decide(&Orientation(a, b, d)) == Ordering::Equal && (between(a, b, d) || between(c, d, a))
        } else if (j + 1) % n == i {
            decide(&Orientation(c, d, b)) == Ordering::Equal && (between(c, d, b) || between(a, b, c))
        } else {
            intersect(a, b, c, d)
        }
    };
    // Touching edges overlap along both axes. The sweep runs along the axis with the shorter total extent of
    // edges.
    let span = |i: usize, axis: usize| {
        let (a, b) = edge(i);
        [a[axis].min(b[axis]), a[axis].max(b[axis])]
    };
    let length = |axis: usize| (0..n).map(|i| span(i, axis)).map(|[low, high]| high - low).sum::<f64>();
    let (along, across) = if length(0) < length(1) { (0, 1) } else { (1, 0) };
    let mut order: Vec<usize> = (0..n).collect();
    order.sort_by(|&i, &j| span(i, along)[0].total_cmp(&span(j, along)[0]));
    let mut first: Option<(usize, usize)> = None;
    for (k, &i) in order.iter().enumerate() {
        stop::poll();
        let (end, [low, high]) = (span(i, along)[1], span(i, across));
        for &j in order[k + 1..].iter().take_while(|&&j| span(j, along)[0] <= end) {
            let ([other_low, other_high], pair) = (span(j, across), (i.min(j), i.max(j)));
            let is_before = first.is_none_or(|first| pair < first);
            if is_before && low <= other_high && other_low <= high && touch(pair.0, pair.1) {
                first = Some(pair);
            }
        }
    }
    first
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn finds_crossings_and_lets_simple_outlines_pass() {
        let square = [[0.0, 0.0], [1.0, 0.0], [1.0, 1.0], [0.0, 1.0]];
        assert_eq!(self_crossing(&square), None);
        let bow = [[0.0, 0.0], [1.0, 1.0], [1.0, 0.0], [0.0, 1.0]];
        assert_eq!(self_crossing(&bow), Some((0, 2)));
        let fold = [[0.0, 0.0], [2.0, 0.0], [1.0, 0.0], [1.0, 1.0]];
        assert_eq!(self_crossing(&fold), Some((0, 1)));
        let notch = [[0.0, 0.0], [2.0, 0.0], [2.0, 2.0], [1.0, 0.5], [0.0, 2.0]];
        assert_eq!(self_crossing(&notch), None);
        let touch = [[0.0, 0.0], [2.0, 0.0], [2.0, 2.0], [1.0, 0.0], [0.0, 2.0]];
        assert_eq!(self_crossing(&touch), Some((0, 2)));
    }
}
