"""Weaken the bounds of the core one by one, and report which tests fail.

Run by hand, from anywhere: ``python tests/mutations.py [--only WORDS] [--target DIR]``. It takes about half a minute
per mutant. The working tree is not changed: the core is copied to a temporary folder, patched there and built without
optimisation.

Many mutants change a number, such as the factor of a bound, or leave out a term. Tools such as cargo-mutants do
neither: they replace operators and function bodies, and delete match arms.

A mutant replaces a text in the core's sources; `tests/test_mutations.py` checks that the text occurs exactly once. The
unit tests of the core run first. If they pass, mutants that concern whole casts are also tested by tests of the Python
package with the patched core. The exit code is 1 if a mutant passes all tests and states no reason for it.
"""

from __future__ import annotations

import argparse
import os
import re
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

ROOT = Path(__file__).parents[1]
CORE = Path("lidarsim", "native")


@dataclass(frozen=True)
class Mutant:
    """A bound, the text that sets it, what takes its place, and which tests of the package are asked besides.

    `slack` says why a bound that is kept need not be noticed: because others cover what it covers.
    """

    name: str
    text: str
    instead: str
    tests: tuple[str, ...] = ()
    slack: str = ""


PACKETS = ("tests/hard/test_packets.py", "-k", "short_rays")
ROUNDING = ("tests/hard/test_cases.py", "-k", "midpoints or small_sphere")

DEPTH = ("tests/test_depth.py",)

ONE_ECHO = ("tests/test_measurement.py", "-k", "first_of_two")

FAR = ("tests/hard/test_scenes.py", "-k", "from_far_away")

MUTANTS = [
    Mutant("patterns: unit length", "let factor = 1.5 - 0.5 * (x * x", "let factor = 1.0 + 0.0 * (x * x"),
    Mutant(
        "patterns: phase of an angle below 0", "if angle < 0.0 { turned.wrapping", "if angle < -1e9 { turned.wrapping"
    ),
    Mutant("patterns: nearest quarter turn", "phases[lane].wrapping_add(1 << 61) >> 62", "phases[lane] >> 62"),
    Mutant("patterns: phase of a group", "phase(group * LANES * LANES)", "phase(group * LANES)"),
    Mutant(
        "patterns: from anchor to anchor", "step.wrapping_mul(LANES as u128)", "step.wrapping_mul(LANES as u128 - 1)"
    ),
    Mutant("patterns: anchors of another group", "if anchors.group != group {", "if anchors.group == usize::MAX {"),
    Mutant("patterns: pieces begin within a block", "(first / LANES, first % LANES)", "(first / LANES, 0)"),
    Mutant("patterns: reflection in a column of another piece", "[skipped..skipped + count] {", "[..] {"),
    Mutant(
        "patterns: a run that starts in a cycle of its own",
        "(run.since, run.late) == (run.cycle, self.wait)",
        "run.since == run.cycle",
    ),
    Mutant("patterns: light from behind a face", "if before > 0.0 { square }", "if before > -2.0 { square }"),
    Mutant("patterns: total reflection", "(if before > 0.0 { square }", "(if before > 0.0 { square.abs() }"),
    Mutant(
        "patterns: indices of glass and air",
        "(glass, glass - 1.0), (1.0, 1.0 - glass)",
        "(1.0, 1.0 - glass), (glass, glass - 1.0)",
    ),
    Mutant(
        "measure: eight rays that hit one object",
        "different |= object ^ objects[0]",
        "different = object ^ objects[0]",
        ("tests/test_scan.py", "-k", "neighbouring"),
    ),
    Mutant("leaf: volumes, rounding 64u", "reach * (64.0 * UNIT * reach +", "reach * (32.0 * UNIT * reach +"),
    Mutant("leaf: volumes, vertices 12ε", "* reach + 12.0 * error), 12.0", "* reach + 6.0 * error), 12.0"),
    Mutant("leaf: volumes, direction 12ε", "error), 12.0 * reach * reach]", "error), 6.0 * reach * reach]"),
    Mutant(
        "leaf: moments", "fused_sum(direction, normal, lanes::fused_dot(moment, side))", "fused_dot(direction, normal)"
    ),
    Mutant("leaf: moments of many rays", "(least, most) = (least.add(less), most.add(more))", "let _ = (less, more)"),
    Mutant("leaf: spread", "(farthest + 2.0 * scale + spread + error)", "(farthest + 2.0 * scale + error)"),
    Mutant(
        "leaf: starts of eight rays",
        "distance.add(lanes::fused_dot(normal, rays.start))",
        "distance.add(F64x8::<I>::splat(0.0).mul(lanes::fused_dot(normal, rays.start)))",
    ),
    Mutant("leaf: start of a ray", "lanes::fused_dot::<f64, 1>(row(plane_normals, i), ray.start)", "0.0"),
    Mutant(
        "rays: errors of others than the first",
        "error = Floats::max(I::F64x8::load(&self.origin_error",
        "error = Floats::min(I::F64x8::load(&self.origin_error",
    ),
    Mutant(
        "rays: spread",
        "spread = Floats::max(start[axis].abs(), spread)",
        "spread = Floats::min(start[axis].abs(), spread)",
    ),
    Mutant("sort: fan", "octants.count_ones() + u32::from(returns) == changes + 1\n            && path", "path"),
    Mutant("sort: order of other groups", "self.last.start = None;\n        let (low, high)", "let (low, high)"),
    Mutant("leaf: t, vertices 4δ", "moved: 4.0 * (size * off", "moved: 2.0 * (size * off"),
    Mutant("leaf: t, distance 64u", "off + 64.0 * UNIT * square", "off + 32.0 * UNIT * square"),
    Mutant("leaf: t, volumes 512u", "turned: [512.0 * UNIT", "turned: [256.0 * UNIT"),
    Mutant("leaf: t, direction 4ε", "square, 4.0 * size]", "square, 2.0 * size]"),
    Mutant("eight disks: t, height 5u", "splat(5.0 * UNIT), I::F64x8", "splat(2.0 * UNIT), I::F64x8"),
    Mutant("eight spheres: t, twice the numerator", "splat(2.0 * inverse)", "splat(1.0 * inverse)"),
    Mutant("triple products 320u²", "BOUND: f64 = 320.0 *", "BOUND: f64 = 160.0 *"),
    Mutant("corrected quotient 16u", "ROUNDINGS: f64 = 16.0 *", "ROUNDINGS: f64 = 8.0 *"),
    Mutant("runs: each ray after the other", "(*ray == first.wrapping_add(k))", "(*ray > *first)"),
    Mutant("runs of hits: all of four", "lanes >> (4 * half) & 0xf == 0xf", "lanes >> (4 * half) & 0xf != 0"),
    Mutant("order of rays: of one world", "if self.world != world {", "if self.world > world {"),
    Mutant("neighbouring hits: on one part", "(objects[k] == object) & (parts[k] == part)", "(objects[k] == object)"),
    Mutant("neighbouring hits: on one object", "(objects[k] == object) & (parts[k] == part)", "(parts[k] == part)"),
    Mutant("hits of eight: in range", "in_range = lanes & t_min.le(t.low)", "in_range = lanes & t_min.le(t.high)"),
    Mutant(
        "hits of eight: up to t_max",
        "& t.high.le(I::F64x8::splat(self.range.max))",
        "& t.low.le(I::F64x8::splat(self.range.max))",
    ),
    Mutant("hits of eight: nearer", "& t.high.lt(low);", "& t.low.lt(low);"),
    Mutant("hits of eight: any will do", "in_range & !farther & t.high", "in_range & t.high"),
    Mutant("sides: changes by tiny coordinates 16u", "CHANGE: f64 = 16.0", "CHANGE: f64 = 8.0"),
    Mutant("sides: volumes beside their change", "splat(2.0 * NUDGE)", "splat(0.0 * NUDGE)"),
    Mutant("crossing: bounds of t 8u", "high.abs().mul(I::F64x8::splat(8.0", "high.abs().mul(I::F64x8::splat(4.0"),
    Mutant("crossing: placed, w·n·(a − o) 640u²", "splat(2.0 * BOUND * inverse", "splat(1.0 * BOUND * inverse"),
    Mutant("crossing: placed, N·d 640u²", "let two = I::F64x8::splat(2.0);", "let two = I::F64x8::splat(1.0);"),
    Mutant("crossing: placed, origins", "let mut size = o_size;", "let mut size = [I::F64x8::splat(0.0); 3];"),
    Mutant("crossing: long sums 3072u³", "LONG_BOUND: f64 = 3072.0", "LONG_BOUND: f64 = 1536.0"),
    Mutant("crossing: long sums of two 12,288u³", "OF_TWO: f64 = 12_288.0", "OF_TWO: f64 = 6_144.0"),
    Mutant("crossing: long sums, last rounding", "LAST_ROUNDING: f64 = 4.0", "LAST_ROUNDING: f64 = 2.0"),
    Mutant("crossing: nearest vertex", "high.add(off).lt(near)", "low.add(off).lt(near)"),
    Mutant("crossing: farthest vertex", "far.lt(low.sub(off))", "far.lt(high.sub(off))"),
    Mutant("sides: placed 960u²", "splat(3.0 * BOUND)", "splat(1.5 * BOUND)"),
    Mutant("leaf: beside", "edges.bound_of(ray.length, ray.error) / edges.reach", "edges.bound_of(0.0, ray.error)"),
    Mutant("leaf: beside, apart", "[sides[0].sub(start), sides[1].sub(start), sides[2].sub(start)]", "sides"),
    Mutant(
        "deferred: one map a queue",
        "|| self.count > 0 && object != first",
        "|| self.count > CAPACITY && object != first",
        ("tests/hard/test_scenes.py", "tests/hard/test_cases.py", "-k", "mesh or placed or instance"),
    ),
    Mutant("expanded inverse: constants 64u²", "CONSTANT: f64 = 64.0 *", "CONSTANT: f64 = 128.0 *"),
    Mutant("expanded inverse: the rest of an offset", "rest.high.abs() / UNIT + rest.size", "rest.size"),
    Mutant(
        "expanded inverse: from 2⁻²⁰⁰",
        "ORDINARY_MIN: f64 = f64::from_bits((1023 - 200) << 52)",
        "ORDINARY_MIN: f64 = f64::from_bits((1023 - 300) << 52)",
    ),
    Mutant("crossing: normals 2⁻⁶⁰", "BOUND * 2_f64.powi(60)", "BOUND * 2_f64.powi(59)"),
    Mutant(
        "sides: from 2⁻²⁰⁰",
        "LEAST_ORDINARY: f64 = f64::from_bits((1023 - 200)",
        "LEAST_ORDINARY: f64 = f64::from_bits((1023 - 300)",
    ),
    Mutant("sides: to 2²⁰⁰", "splat(1.0 / LEAST_ORDINARY)", "splat(1.0 / LEAST_ORDINARY / LEAST_ORDINARY)"),
    Mutant(
        "double-double of exact numbers u²", "low, UNIT * UNIT * high.abs()", "low, 0.25 * UNIT * UNIT * high.abs()"
    ),
    Mutant("double-double of exact numbers from 2⁻⁸⁰⁰", "(-800..=1000)", "(-1020..=1000)"),
    Mutant("double-double sum 4u²", "PLUS: f64 = 4.0 *", "PLUS: f64 = 2.0 *"),
    Mutant("double-double product 5u²", "TIMES: f64 = 5.0 *", "TIMES: f64 = 2.5 *"),
    Mutant("double-double quotient 16u²", "OVER: f64 = 16.0 *", "OVER: f64 = 8.0 *"),
    Mutant("double-double root 4u²", "SQRT: f64 = 4.0 *", "SQRT: f64 = 2.0 *"),
    Mutant(
        "double-double from 2⁻⁸⁰⁰",
        "SMALL: f64 = f64::from_bits((1023 - 800)",
        "SMALL: f64 = f64::from_bits((1023 - 1000)",
    ),
    Mutant("double-double rounding 2u", "low.abs().mul(F::splat(2.0 *", "low.abs().mul(F::splat(1.0 *"),
    Mutant(
        "double-double sign 2u",
        "least = high.mul(F::splat(1.0 - 2.0 *",
        "least = high.mul(F::splat(1.0 - 0.0 *",
    ),
    Mutant(
        "double-double proportions 2⁻⁶⁰",
        "largest.mul(splat::<L, N>(UNIT / 128.0))",
        "largest.mul(splat::<L, N>(UNIT / 64.0))",
    ),
    Mutant("running error of a sum", "other.weight) + UNIT) * PAD", "other.weight) + 0.5 * UNIT) * PAD"),
    Mutant("running error of a product", "(v + w + v * w + UNIT)", "(v + w + v * w + 0.5 * UNIT)"),
    Mutant("running error of a quotient 3u", "QUOTIENT: f64 = 3.0 *", "QUOTIENT: f64 = 1.5 *"),
    Mutant("running error of a root", "size, weight: UNIT, ..self", "size, weight: 0.5 * UNIT, ..self"),
    Mutant("interval 4u", "value.abs().mul(F::splat(4.0 * UNIT))", "value.abs().mul(F::splat(2.0 * UNIT))"),
    Mutant("PAD 16u", "PAD: f64 = 1.0 + 8.0 *", "PAD: f64 = 1.0 + 4.0 *"),
    Mutant("UNDERFLOW 2⁻⁹⁰⁰", "UNDERFLOW: f64 = f64::from_bits((1023 - 900) << 52)", "UNDERFLOW: f64 = 0.0"),
    Mutant("packet: near slopes 12u", "SHRINK: f32 = 1.0 - 12.0 *", "SHRINK: f32 = 1.0 - 6.0 *"),
    Mutant("packet: far slopes 12u", "STRETCH: f32 = 1.0 + 12.0 *", "STRETCH: f32 = 1.0 + 6.0 *"),
    Mutant("packet: origins 4u", "o.abs().mul(I::F32x16::splat(4.0", "o.abs().mul(I::F32x16::splat(2.0"),
    Mutant("packet: directions 4u", "add(d.mul(I::F32x16::splat(4.0", "add(d.mul(I::F32x16::splat(2.0"),
    Mutant("packet: limits 4u", "limit.mul(I::F32x16::splat(1.0 + 4.0", "limit.mul(I::F32x16::splat(1.0 + 2.0"),
    Mutant("packet: limit of one 4u", "(t * self.scale) as f32 * (1.0 + 4.0", "(t * self.scale) as f32 * (1.0 + 2.0"),
    Mutant("packet: start 4u", "(t_min * self.scale) as f32 * (1.0 - 4.0", "(t_min * self.scale) as f32 * (1.0 - 2.0"),
    Mutant(
        "packet: floor of directions",
        "direction_error.add(I::F32x16::splat(f32::MIN_POSITIVE))",
        "direction_error.add(I::F32x16::splat(0.0))",
    ),
    Mutant(
        "packet: vague in float64",
        "none.lt(low) | none.lt(high) != 0;",
        "zero.lt(I::narrow(low.mul(shrink), high.mul(shrink))) != 0;",
        PACKETS,
    ),
    Mutant("ray: near slopes 4u", "SHRINK: f32 = 1.0 - 4.0 *", "SHRINK: f32 = 1.0 - 2.0 *"),
    Mutant("ray: far slopes 4u", "STRETCH: f32 = 1.0 + 4.0 *", "STRETCH: f32 = 1.0 + 2.0 *"),
    Mutant("polytope: sums 12u", "*reach + 12.0 * UNIT", "*reach + 6.0 * UNIT"),
    Mutant("polytope: terms 8u", "sum + 8.0 * UNIT * size", "sum + 4.0 * UNIT * size"),
    Mutant("polytope: sums that overflow", "if largest < LARGEST {", "if largest < f64::INFINITY {"),
    Mutant("boxes rounded down", "(x as f32).next_down()", "(x as f32)"),
    Mutant("boxes rounded up", "(x as f32).next_up()", "(x as f32)"),
    Mutant("grid of a leaf", "(errors.into_iter().fold(0.0, larger) as f32).next_up()", "0.0"),
    Mutant(
        "boxes of a refitted mesh",
        "= fit(&self.nodes, &bounds, center);",
        "= fit(&self.nodes, &bounds, self.center());",
    ),
    Mutant("flat children", "planes[i][axis] = f64::NAN;", "()"),
    Mutant("children of the plane", "of_child[axis] == of_hierarchy[axis]", "!of_child[axis].is_nan()"),
    Mutant("crossings from below", "low.max(0.0) as f32 * (1.0 - 4.0 * U)", "low.max(0.0) as f32 * (1.0 - 0.0 * U)"),
    Mutant("crossings from above", "high as f32 * (1.0 + 4.0 * U)", "high as f32 * (1.0 + 0.0 * U)"),
    Mutant("crossings before the start", "(t - offset) * self.scale", "(t - 0.0 * offset) * self.scale"),
    Mutant("flat leaves", "side.low == side.high", "side.high - side.low < 1e-6"),
    Mutant("axes that a flat child is parallel to", "along(0) & along(1) & along(2)", "along(0) | along(1) | along(2)"),
    Mutant("triangles without an area", "> 16.0 * UNIT * largest && largest > UNDERFLOW", ">= 0.0 * largest"),
    Mutant("midpoint below", "Ordering::Less => below,", "Ordering::Less => near,", ROUNDING),
    Mutant("midpoint above", "Ordering::Greater => above,", "Ordering::Greater => near,", ROUNDING),
    Mutant(
        "bits of a root for its normal",
        "longest.unwrap_or(0) + BEYOND",
        "0 * longest.unwrap_or(0) + 2 * BEYOND",
        ROUNDING,
    ),
    Mutant(
        "axis planes: products from 2⁻⁹⁰⁰", "product.abs() > ORDINARY || self.high", "product.abs() > 0.0 || self.high"
    ),
    Mutant("axis planes: quotients from 2⁻⁹⁰⁰", "a.abs() > ORDINARY && quotient", "a.abs() > 0.0 && quotient"),
    Mutant("axis planes: the rest of a sum", "if beyond == 0.0 {", "if beyond == beyond {"),
    Mutant("logarithm, exponential: ln 2", "0x3dea_39ef_3579_3c76", "0x3dea_39ef_3000_0000"),
    Mutant("sine, cosine: π/2", "0x3ba3_198a_2e03_7073", "0x3b83_198a_2e03_7073"),
    Mutant("|d|² − 1", "ROUNDER: f64 = 1.5 * (1_u64 << 26)", "ROUNDER: f64 = 1.5 * (1_u64 << 25)"),
    Mutant("t·|d|", "F::splat(0.125).sub(e.mul(F::splat(0.0625)))", "F::splat(0.125)"),
    Mutant(
        "double-double quotient: margin 2u",
        "margin = bh.abs().mul(F::splat(1.0 - 2.0 *",
        "margin = bh.abs().mul(F::splat(1.0 - 0.0 *",
        slack="the pads of the error beside it and of the quotient's are 16u each",
    ),
    Mutant(
        "double-double quotient: error of the divisor",
        "e.add(high.abs().mul(f).mul(pad))",
        "e.add(high.abs().mul(f).mul(F::splat(0.5)))",
    ),
    Mutant("double-double quotient: tiny dividends", "(small.le(size) | size", "(F::splat(0.0).le(size) | size"),
    Mutant(
        "double-double quotient: tiny divisors",
        "known = small.lt(margin)",
        "known = F::splat(0.0).lt(margin)",
        slack="a residual is lost where the dividend is tiny; a divisor only shares the bound",
    ),
    Mutant(
        "double-double root: where it is known",
        "away = error.mul(pad).lt(xh)",
        "away = error.mul(F::splat(0.5)).lt(xh)",
        slack="|√x − √h| ≤ ε/√h for all x ≥ 0; beyond h it is of no use",
    ),
    Mutant(
        "double-double root: error",
        "error = error.div(high).mul(pad)",
        "error = error.div(high).mul(F::splat(0.5))",
    ),
    Mutant(
        "double-double product: both errors",
        "larger.mul(f).add(size.mul(e))",
        "ah.abs().mul(f).add(size.mul(e))",
    ),
    Mutant(
        "double-double product with an exact number",
        "error_of_product(high, size.mul(error), underflow)",
        "error_of_product(high, size.mul(error).mul(F::splat(0.5)), underflow)",
    ),
    Mutant(
        "double-double: subnormal results",
        "certain & F::splat(f64::MIN_POSITIVE).le(size)",
        "certain & F::splat(0.0).le(size)",
        slack="`UNDERFLOW` beside it refuses all below 2⁻⁸⁴⁷",
    ),
    Mutant(
        "double-double rounding: `UNDERFLOW`",
        "let error = error.add(F::splat(UNDERFLOW));\n        let certain",
        "let certain",
        slack="each operation that may underflow has added it",
    ),
    Mutant(
        "double-double rounding: error",
        "error.mul(F::splat(PAD)).add(low.abs()",
        "error.mul(F::splat(0.5)).add(low.abs()",
    ),
    Mutant(
        "double-double proportions from 2⁻⁴⁰⁰",
        "SHORT: f64 = f64::from_bits((1023 - 400)",
        "SHORT: f64 = f64::from_bits((1023 - 800)",
    ),
    Mutant(
        "double-double proportions to 2⁴⁰⁰",
        "LONG: f64 = f64::from_bits((1023 + 400)",
        "LONG: f64 = f64::from_bits((1023 + 800)",
    ),
    Mutant(
        "double-double to float64: u",
        "high.abs().fused(splat::<L, N>(UNIT), error)",
        "high.abs().fused(splat::<L, N>(0.5 * UNIT), error)",
    ),
    Mutant(
        "running error of a quotient: 1 + 2q",
        "q.fused(F::splat(2.0), F::splat(1.0))",
        "q.fused(F::splat(1.0), F::splat(1.0))",
    ),
    Mutant("running error of a quotient: q ≤ ½", "q.le(F::splat(0.5))", "q.le(F::splat(1.0))"),
    Mutant(
        "running error of a quotient: dividend",
        "weight_of_a / QUOTIENT * PAD), operands)",
        "weight_of_a / QUOTIENT * 0.5), operands)",
    ),
    Mutant(
        "running error of a quotient: divisor",
        "weight_of_b / QUOTIENT * PAD)), operands)",
        "weight_of_b / QUOTIENT * 0.5)), operands)",
    ),
    Mutant(
        "running error of a quotient: subnormal reciprocals",
        "ordinary = F::splat(f64::MIN_POSITIVE).lt(slope)",
        "ordinary = F::splat(0.0).lt(slope)",
    ),
    Mutant("running error of a root near zero", "F::splat(PAD / UNIT)", "F::splat(0.5 * PAD / UNIT)"),
    Mutant(
        "running error of a root away from zero",
        "error.mul(F::splat(1.0 / UNIT))",
        "error.mul(F::splat(0.5 / UNIT))",
    ),
    Mutant(
        "running error of a root: where it is away",
        "F::splat(UNDERFLOW))], error.lt(value))",
        "F::splat(UNDERFLOW))], error.mul(F::splat(0.5)).lt(value))",
    ),
    Mutant("running error that is given", "error.mul(F::splat(1.0 / GIVEN))", "error.mul(F::splat(0.5 / GIVEN))"),
    Mutant(
        "running error of a number for all lanes",
        "larger(size, size * (weight * PAD / GIVEN))",
        "larger(size, size * (0.5 * weight * PAD / GIVEN))",
    ),
    Mutant(
        "interval: `UNDERFLOW`",
        "margin.mul(F::splat(PAD)).add(F::splat(UNDERFLOW))",
        "margin.mul(F::splat(PAD))",
        slack="sums of subnormal numbers are exact",
    ),
    Mutant("bits of a root near its float64", "NEAR_BITS: i64 = 64", "NEAR_BITS: i64 = 50"),
    Mutant("bits of an exact quotient", "self.quotient(den, 66)", "self.quotient(den, 52)"),
    Mutant("sticky bit of an exact quotient", "u64::from(!is_exact)", "0"),
    Mutant("bounds of an exact root", "low: t.next_down(), high: t.next_up() })", "low: t, high: t })"),
    Mutant(
        "crossing: from 2⁻⁴⁰⁰",
        "ORDINARY_MIN: f64 = f64::from_bits((1023 - 400)",
        "ORDINARY_MIN: f64 = f64::from_bits((1023 - 1000)",
    ),
    Mutant(
        "crossing: to 2⁴⁰⁰",
        "ORDINARY_MAX: f64 = f64::from_bits((1023 + 400)",
        "ORDINARY_MAX: f64 = f64::from_bits((1023 + 1000)",
        slack="what overflows is infinite or NaN, and below no bound",
    ),
    Mutant(
        "crossing: denominators known to 1/128",
        "mul(I::F64x8::splat(128.0)).lt(den_size)",
        "mul(I::F64x8::splat(2.0)).lt(den_size)",
        slack="the sums' bounds have 30 times as much to spare",
    ),
    Mutant(
        "crossing: numerators known to 1/8",
        "mul(I::F64x8::splat(8.0)).lt(num_size)",
        "mul(I::F64x8::splat(1.0)).lt(num_size)",
        slack="as of the denominators",
    ),
    Mutant(
        "crossing: 1/16 of an error",
        "splat(1.0 + 1.0 / 16.0)",
        "splat(1.0)",
        slack="the bounds that it widens are 6 times what errors come to, or more",
    ),
    Mutant(
        "leaf: reach 4u",
        "(farthest + 2.0 * scale + spread + error) * (1.0 + 4.0 * UNIT)",
        "(farthest + 2.0 * scale + spread + error) * (1.0 + 0.0 * UNIT)",
        slack="the bounds that it goes into have 4 times as much to spare, or more",
    ),
    Mutant("leaf: reach two sides", "(farthest + 2.0 * scale + spread", "(farthest + 1.0 * scale + spread"),
    Mutant("leaf: vertices 4u", "4.0 * UNIT * self.reach + self.error", "2.0 * UNIT * self.reach + self.error"),
    Mutant(
        "leaf: grid 2u",
        "exact.abs() * (2.0 * UNIT)",
        "exact.abs() * (1.0 * UNIT)",
        slack="the difference rounds by one; the other is for this sum, and float32 rounds it up",
    ),
    Mutant("leaf: |N|₁ 32u", "thickness + 32.0 * UNIT", "thickness + 0.0 * UNIT"),
    Mutant("leaf: thinness", "thinness = (3 - above)", "thinness = (4 - above)"),
    Mutant(
        "leaf: volumes that underflow",
        "I::fused(error, self.bound[1], f64::MIN_POSITIVE)",
        "I::fused(error, self.bound[1], 0.0)",
        slack="the error of a coordinate is 2⁻¹⁴⁹ at least, as a float32, so that bounds are far from that",
    ),
    Mutant(
        "leaf: t that underflows",
        "let off = moved.fused(inverse.abs(), least)",
        "let off = moved.mul(inverse.abs())",
        slack="as of the volumes",
    ),
    Mutant(
        "leaf: sums known to half",
        "known = turned.add(least).lt(sum.abs())",
        "known = turned.mul(F::splat(0.25)).add(least).lt(sum.abs())",
        slack="certain hits have sums of 3/8 of that at least, and roundings are 1/200 of it",
    ),
    Mutant(
        "leaf: distances that underflow",
        "+ 64.0 * UNIT * square * edges.reach) + f64::MIN_POSITIVE",
        "+ 64.0 * UNIT * square * edges.reach)",
        slack="as of the volumes",
    ),
    Mutant(
        "leaf: many rays", "edges.bound_of(rays.length, rays.error)", "0.0 * edges.bound_of(rays.length, rays.error)"
    ),
    Mutant(
        "leaf: eight rays",
        "rays.length.fused(F64x8::<I>::splat(edges.bound[0]), bound)",
        "rays.length.fused(F64x8::<I>::splat(0.0), bound)",
    ),
    Mutant(
        "leaf: length of many directions 4u",
        "let length = length * (1.0 + 4.0 * UNIT)",
        "let length = length * (1.0 + 0.0 * UNIT)",
        slack="the bound that it goes into has an eighth to spare",
    ),
    Mutant("reciprocal length: terms", "1.0 - e * (0.5 - e * (0.375 - e * 0.3125))", "1.0 - e * 0.5"),
    Mutant(
        "newton: margin 2u",
        "slope_size.mul(L::Floats::splat(1.0 - 2.0 * UNIT))",
        "slope_size.mul(L::Floats::splat(1.0 - 0.0 * UNIT))",
        slack="the slope's own error is 5 roundings at least, and padded",
    ),
    Mutant(
        "newton: error of the slope in its margin",
        ".sub(slope_error.mul(pad))",
        ".sub(slope_error.mul(L::Floats::splat(0.5)))",
    ),
    Mutant(
        "newton: lower half of F",
        "rest = implicit.abs().fused(unit, implicit_error)",
        "rest = implicit_error",
        slack="the slope's own error is 5 roundings at least, which counts for |F|, too",
    ),
    Mutant(
        "newton: error of F",
        "let step = implicit.div(slope).negated();",
        "let rest = rest.sub(implicit_error.mul(half));\n    let step = implicit.div(slope).negated();",
    ),
    Mutant(
        "newton: error of the slope",
        "slope_size.fused(unit, slope_error), rest)",
        "slope_size.fused(unit, slope_error.mul(half)), rest)",
    ),
    Mutant(
        "newton: rounding of the quotient",
        "step.abs().fused(slope_size.fused(unit, slope_error), rest)",
        "step.abs().fused(slope_error, rest)",
        slack="the slope's own error is 5 roundings at least",
    ),
    Mutant("axis plane: rest of the quotient 4u", "splat(4.0 * UNIT)).add(q.abs()", "splat(2.0 * UNIT)).add(q.abs()"),
    Mutant("axis plane: remainder 2u²", "splat(2.0 * UNIT * UNIT)", "splat(UNIT * UNIT)"),
    Mutant("axis plane: float64 coordinates", "!rest.abs().le(L::Floats::splat(0.0)) == 0", "0 == 0"),
    Mutant("newton: around the middle", "middle.sub(bounds.low)).mul(pad)", "middle.sub(bounds.low)).mul(half)"),
    Mutant("lengths 4ε", "(1.0 + 4.0 * f64::EPSILON)) +", "(1.0 + 0.0 * f64::EPSILON)) +"),
    Mutant(
        "lengths that are subnormal", "(1.0 + 4.0 * f64::EPSILON)) + f64::from_bits(1)", "(1.0 + 4.0 * f64::EPSILON))"
    ),
    Mutant("unit vectors: to 2⁻⁶⁰", "F::splat(1.0 / 256.0)", "F::splat(1.0 / 4096.0)"),
    Mutant("turns: places of a rate", "PLACES: i64 = 1216", "PLACES: i64 = 1152"),
    Mutant("turns: window of the rate", "PLACES - 192 - e", "PLACES - 191 - e"),
    Mutant(
        "poses of eight: one formula", "angle.le(largest) == 0xff && angle.le(one) == 0", "angle.le(largest) == 0xff"
    ),
    Mutant(
        "poses of eight: one step",
        "from.lt(time) & time.lt(I::F64x8::splat(times[i + 1])) != 0xff",
        "from.lt(time) != 0xff",
    ),
    Mutant(
        "stacks: room for work",
        "ROOM: usize = 1 << 20",
        "ROOM: usize = 1 << 15",
        tests=("tests/hard/test_threads.py", "-k", "small_stack"),
    ),
    Mutant(
        "sweep: rounding of poses",
        "rounding = 512.0 * UNIT",
        "rounding = 0.0 * UNIT",
        slack="roundings that are counted do not come together, and `image` rounds outward, too",
    ),
    Mutant(
        "sweep: turns", "(angular * half).min(2.0) * radius) * (1.0", "(0.0 * angular * half).min(2.0) * radius) * (1.0"
    ),
    Mutant(
        "sweep: half of the turns",
        "(angular * half).min(2.0) * radius) * (1.0",
        "(0.5 * angular * half).min(2.0) * radius) * (1.0",
        slack="both ends are held as well as the middle, and none is farther from all three than half",
    ),
    Mutant(
        "sweep: 16u of the way",
        "* (1.0 + 16.0 * UNIT) + rounding",
        "* (1.0 + 0.0 * UNIT) + rounding",
        slack="what is added for rounding, 512u of all lengths, covers it",
    ),
    Mutant(
        "images, below",
        "low: (self.offset[i] - below).next_down(),",
        "low: self.offset[i] - below,",
    ),
    Mutant(
        "images, above",
        "high: (self.offset[i] + above).next_up()",
        "high: self.offset[i] + above",
    ),
    Mutant("boxes of cylinders 32ε", "across[i] / length * (1.0 + 32.0 * f64::EPSILON)", "across[i] / length"),
    Mutant(
        "boxes of cylinders",
        "low: (self.start[i].min(self.end[i]) - reach[i]).next_down(),",
        "low: self.start[i].min(self.end[i]) - reach[i],",
    ),
    Mutant(
        "boxes of circles around a steep axis",
        "(1.0 + 32.0 * f64::EPSILON)).max(f64::MIN_POSITIVE)",
        "(1.0 + 32.0 * f64::EPSILON))",
    ),
    Mutant("boxes of disks", "low: (self.center[i] - reach[i]).next_down(),", "low: self.center[i] - reach[i],"),
    Mutant("boxes of spheres", "low: (c - self.radius).next_down()", "low: c - self.radius"),
    Mutant("boxes of boxes", "low: (self.center[i] - half.next_up()).next_down()", "low: self.center[i] - half"),
    Mutant(
        "packet: floor of origins",
        "origin_error.add(I::F32x16::splat(f32::MIN_POSITIVE))",
        "origin_error.add(I::F32x16::splat(0.0))",
    ),
    Mutant(
        "packet: errors of origins 4u",
        "origin_error = I::narrow(low, high).mul(I::F32x16::splat(1.0 + 4.0 * U))",
        "origin_error = I::narrow(low, high)",
    ),
    Mutant(
        "packet: errors of directions 4u",
        "high.mul(shrink)).mul(I::F32x16::splat(1.0 + 4.0 * U))",
        "high.mul(shrink)).mul(I::F32x16::splat(1.0 - 4.0 * U))",
    ),
    Mutant(
        "packet: floor of limits",
        "splat(1.0 + 4.0 * U)).add(I::F32x16::splat(f32::MIN_POSITIVE)).store()",
        "splat(1.0 + 4.0 * U)).store()",
    ),
    Mutant(
        "packet: floor of the limit of one",
        "(t * self.scale) as f32 * (1.0 + 4.0 * U) + f32::MIN_POSITIVE",
        "(t * self.scale) as f32 * (1.0 + 4.0 * U)",
    ),
    Mutant("packet: finite near slopes", "Floats::min(near, I::F32x16::splat(f32::MAX)).mul", "near.mul"),
    Mutant(
        "packet: way back of uncertain signs",
        "fastest[axis].mul(latest)",
        "fastest[axis].mul(latest).mul(I::F32x16::splat(0.5))",
    ),
    Mutant("packet: no hit later than that", "frame.reach[axis]", "0.1 * frame.reach[axis]"),
    Mutant("far rays: rounding of the start 3u", "splat(3.0 * UNIT)).add(error)", "splat(0.5 * UNIT)).add(error)"),
    Mutant("far rays: error of the direction", "error.add(bent).mul", "error.mul"),
    Mutant("far rays: error of the origin", "error.add(bent).mul", "bent.mul"),
    Mutant("far rays: bounds of t", "(t.low + self.offset[lane]).next_down()", "(t.low + self.offset[lane])"),
    Mutant("far rays: limits", "(low.sub(less.0), zero)", "(low.sub(less.0).sub(less.0), zero)", FAR),
    Mutant("far rays: limit of one", "(t - self.offset[lane]).max(0.0)", "(t - 2.0 * self.offset[lane]).max(0.0)", FAR),
    Mutant("far rays: start at t_min", "if rays.has_offsets { 0.0 } else { t_min }", "t_min", FAR),
    Mutant("packet: numbers below 1e30", "LARGEST: f64 = 1e30", "LARGEST: f64 = 1e40"),
    Mutant("packet: directions above 1e-30", "SMALLEST: f64 = 1e-30", "SMALLEST: f64 = 1e-40"),
    Mutant("ray: start", "ray.start = down(t_min", "ray.start = up(t_min"),
    Mutant("ray: limit", "self.limit = up(t_max", "self.limit = down(t_max"),
    Mutant("ray: unknown signs", "blind = d.low < 0.0 && d.high > 0.0", "blind = d.low < 0.0 && d.high > 1.0"),
    Mutant(
        "instance: middles",
        "error.fused(F::splat(PAD), F::splat(UNDERFLOW)))",
        "error.fused(F::splat(0.5), F::splat(UNDERFLOW)))",
    ),
    Mutant("instance: products 8u", "linear_error += 8.0 * UNIT", "linear_error += 4.0 * UNIT"),
    Mutant("instance: entries", "linear_error.max(direction[i].high - direction[i].low)", "linear_error.max(0.0)"),
    Mutant(
        "instance: images 4u",
        "origin[i].low + 4.0 * UNIT * image[i].abs()",
        "origin[i].low",
        slack="an image is but what rounding the offset left, and the sum with it is within the 8u of the product",
    ),
    Mutant(
        "instance: width of images",
        "origin[i].high - origin[i].low + 4.0",
        "0.0 + 4.0",
        slack="unless a map is close to having no inverse, double-doubles tell them within the 4u beside it",
    ),
    Mutant(
        "logarithm: terms",
        "ODD_RECIPROCALS: [f64; 11] = {\n    let mut c = [0.0; 11]",
        "ODD_RECIPROCALS: [f64; 8] = {\n    let mut c = [0.0; 8]",
    ),
    Mutant(
        "exponential: terms",
        "TAYLOR: [f64; 13] = {\n        let mut c = [0.0; 13]",
        "TAYLOR: [f64; 10] = {\n        let mut c = [0.0; 10]",
    ),
    Mutant(
        "sine, cosine: terms",
        "-> [f64; 9] {\n        let mut c = [0.0; 9]",
        "-> [f64; 7] {\n        let mut c = [0.0; 7]",
    ),
    Mutant("backscatter: A of a rough diffuser", "0.5 * square / (square + 0.33)", "0.5 * square / (square + 0.57)"),
    Mutant("backscatter: B of a rough diffuser", "0.45 * square / (square + 0.09)", "0.45 * square / (square + 0.9)"),
    Mutant("backscatter: cos⁵ of a highlight", "square.mul(square).mul(cosine)", "square.mul(cosine)"),
    Mutant("backscatter: grazed highlights", "F::splat(0.0).lt(falloff)", "F::splat(0.0).le(falloff)"),
    Mutant("tables: constant outside", "if low[i] < high[i] { between }", "if low[i] <= high[i] { between }"),
    Mutant("fluctuation: mean 1", "(*normal - 0.5 * sigma)", "(*normal - sigma)"),
    Mutant("crossover: not below 0", "intensity.mul(overlap.max(F::splat(0.0)).min", "intensity.mul(overlap.min"),
    Mutant("crossover: not above 1", "(overlap.max(F::splat(0.0)).min(F::splat(1.0)))", "(overlap.max(F::splat(0.0)))"),
    Mutant("separation: at the least distance", ".abs() >= separation", ".abs() > separation"),
    Mutant("separation: the stronger first", "b.power.total_cmp(&a.power)", "a.power.total_cmp(&b.power)"),
    Mutant("false returns: the weakest", "let power = f64::NEG_INFINITY;", "let power = 0.0;"),
    Mutant("false returns: the first by range", "=> falsely.lt(range),", "=> range.lt(falsely),"),
    Mutant(
        "false returns: over the gate",
        "F::splat(self.length).mul(place)",
        "F::splat(0.5 * self.length).mul(place)",
        ("tests/test_measurement.py", "-k", "false_returns"),
    ),
    Mutant(
        "fog: π of a white diffuser",
        "let strength = PI * backscatter;",
        "let strength = backscatter;",
        ("tests/test_atmosphere.py", "-k", "peak_of_the_response"),
    ),
    Mutant(
        "fog: steps of the integral",
        "const STEPS: u32 = 256;",
        "const STEPS: u32 = 128;",
        ("tests/test_atmosphere.py", "-k", "peak_of_the_response"),
    ),
    Mutant(
        "fog: hidden up to 2σ",
        "(strength * peak, range + 2.0 * response.sigma)",
        "(strength * peak, range + response.sigma)",
        ("tests/test_atmosphere.py", "-k", "near_surface"),
    ),
    Mutant(
        "particles: sizes from the least on",
        "sight.least_diameter(range, largest) + excess / self.slope",
        "excess / self.slope",
        ("tests/test_atmosphere.py", "-k", "poisson"),
    ),
    Mutant(
        "particles: cells of the integral",
        "const CELLS: u32 = 1 << 10;",
        "const CELLS: u32 = 1 << 8;",
        ("tests/test_atmosphere.py", "-k", "integral"),
    ),
    Mutant(
        "particles: as they may fluctuate",
        "layers.mean(sight.visibility(range, slope))",
        "sight.visibility(range, slope)(1.0)",
        ("tests/test_atmosphere.py", "-k", "fluctuation"),
    ),
    Mutant(
        "fog: as patches may fluctuate",
        "layers.mean(visibility(threshold.at(range) / mean(range)))",
        "visibility(threshold.at(range) / mean(range))(1.0)",
        ("tests/test_atmosphere.py", "-k", "fluctuation"),
    ),
    Mutant(
        "fluctuation: one factor of a spot",
        "if echoes.number > FIRST_NUMBER {",
        "if false {",
        ("tests/test_atmosphere.py", "-k", "fluctuation"),
    ),
    Mutant(
        "shadows: none of near hits",
        "if self.seen.binary_search(&i).is_err() {",
        "if true {",
        ("tests/test_measurement.py", "-k", "nearer_than_its_offset"),
    ),
    Mutant(
        "particles: not behind a surface",
        "spot.range < end;",
        "true;",
        ("tests/test_atmosphere.py", "-k", "behind_a_surface"),
    ),
    Mutant(
        "fog: patches above the threshold",
        "(mean * of_rarity(rarity(least / mean) + echo.excess)).max(least)",
        "mean * of_rarity(echo.excess)",
        ("tests/test_atmosphere.py", "-k", "patches"),
    ),
    Mutant(
        "near: gain up to the far limit",
        "echoes.power = echoes.power.min(dulled);",
        "let _ = dulled;",
        ("tests/test_measurement.py", "-k", "near"),
    ),
    Mutant(
        "response: factors of channels",
        "turn_into_factors(self.ring_sigma, factors);",
        "turn_into_factors(0.5 * self.ring_sigma, factors);",
        ("tests/test_measurement.py", "-k", "response"),
    ),
    Mutant(
        "response: blocks of each channel",
        "(index / block) << 16 | u64::from(*ring)",
        "(index / block) << 16",
        ("tests/test_measurement.py", "-k", "response"),
    ),
    Mutant(
        "response: the curve of noisy intensities",
        "if !self.curve.is_empty() {",
        "if !self.curve.is_empty() && self.sigma == 0.0 {",
        ("tests/test_measurement.py", "-k", "response"),
    ),
    Mutant(
        "texture: cells of each object",
        "[x, y, z, grain.object]",
        "[x, y, z, 0]",
        ("tests/test_materials.py", "-k", "texture"),
    ),
    Mutant(
        "weather: draws of its own",
        "FIRST_NUMBER: u16 = 1 << 15;",
        "FIRST_NUMBER: u16 = 0;",
        ("tests/test_atmosphere.py", "-k", "documented_draws"),
    ),
    Mutant(
        "range noise of weak echoes",
        "F::splat(least_power).div(echoes.power)",
        "F::splat(least_power).mul(echoes.power)",
        ("tests/test_measurement.py", "-k", "weak_echoes"),
    ),
    Mutant(
        "next hit: coincident surfaces in order",
        ".then_with(|| object.cmp(&at.0.object))",
        ".then(Ordering::Equal)",
        DEPTH,
    ),
    Mutant(
        "next hit: a mirror is left out", "(is_mirror || is_met(scene,", "(is_met(scene,", DEPTH, slack="it is met, too"
    ),
    Mutant(
        "next hit: what coincides with a mirror is left out", "(is_mirror || is_met(", "(is_mirror && is_met(", DEPTH
    ),
    Mutant("next hit: nearest to the mirror", "return a_is.0 > b_is.1;", "return a_is.0 < b_is.1;", DEPTH),
    Mutant(
        "next hit: one plane",
        "if object.is_whole() || !is_mirror && are_coplanar",
        "if object.is_whole() && !is_mirror && are_coplanar",
        DEPTH,
    ),
    Mutant("next hit: a solid wall in front", "&& root.1.high < low", "&& root.1.high < f64::INFINITY", DEPTH),
    Mutant("footprint: pulses of several echoes", "others |= bit as u8;", "missed |= bit;", ONE_ECHO),
    Mutant(
        "footprint: range of the light",
        "Echoes::new(part, 0, range, surf",
        "Echoes::new(part, 0, surfaces.truth, surf",
        ONE_ECHO,
    ),
    Mutant(
        "further surfaces: power goes out and back",
        "share: path.share * passed * passed",
        "share: path.share * passed",
        DEPTH,
    ),
    Mutant(
        "further surfaces: the length of the path",
        "let before = path.before + distance",
        "let before = distance",
        DEPTH,
    ),
    Mutant(
        "further surfaces: the image's normal",
        "let normal = self.normal_of_image(light.ray);",
        "let normal = self.hits.normal(light.ray);",
        DEPTH,
    ),
]


def places(core: Path, mutants: Sequence[Mutant] = MUTANTS) -> dict[Mutant, list[Path]]:
    """Return where the text of each mutant stands: a source for each time that it is there."""
    sources = {
        path: path.read_text(encoding="utf-8") for path in sorted(core.rglob("*.rs")) if "target" not in path.parts
    }
    return {
        mutant: [path for path, source in sources.items() for _ in range(source.count(mutant.text))]
        for mutant in mutants
    }


def module(source: Path) -> str:
    """Return the path of the module that a source is."""
    parts = source.with_suffix("").parts
    return "::".join(part for part in parts[parts.index("src") + 1 :] if part not in {"mod", "lib"})


def unit_tests(core: Path, environment: dict[str, str], within: str = "") -> list[str]:
    """Return the unit tests of the core, of those in a module, that fail."""
    command = ["cargo", "test", "--lib", "--locked", "--package", "lidarsim-core", "--no-fail-fast", within]
    run = subprocess.run(command, cwd=core, env=environment, capture_output=True, text=True, check=False)
    failed = re.findall(r"^test (\S+) \.\.\. FAILED$", run.stdout, re.MULTILINE)
    if run.returncode and not failed:
        sys.exit(f"the core does not build:\n{run.stderr[-4000:]}")
    return failed


def package_tests(copy: Path, arguments: tuple[str, ...], environment: dict[str, str]) -> list[str]:
    """Return the tests of the package that fail with the core of this copy."""
    build = ["cargo", "build", "--lib", "--locked", "--features", "pyo3/extension-module"]
    subprocess.run(build, cwd=copy / CORE, env=environment, capture_output=True, check=True)
    library = max(Path(environment["CARGO_TARGET_DIR"], "debug").glob("lib*native.so"), key=lambda p: p.stat().st_mtime)
    shutil.copy(library, copy / "lidarsim" / "_native.abi3.so")
    command = [sys.executable, "-m", "pytest", "-q", "-p", "no:cacheprovider", *arguments]
    # Without optimisation casts take more stack than the threads of the pool have; the first thread has enough.
    environment = environment | {"PYTHONPATH": str(copy), "LIDARSIM_THREADS": "1"}
    run = subprocess.run(command, cwd=copy, env=environment, capture_output=True, text=True, check=False)
    return re.findall(r"^(?:FAILED|ERROR) (\S+)", run.stdout, re.MULTILINE)


def main() -> int:
    """Print a table of mutants and of the tests that notice them."""
    parser = argparse.ArgumentParser(description=main.__doc__)
    parser.add_argument("--only", default="", help="mutants whose names hold this")
    parser.add_argument(
        "--target", default=str(Path(tempfile.gettempdir(), "lidarsim-mutations")), help="folder of builds"
    )
    options = parser.parse_args()
    environment = os.environ | {"CARGO_TARGET_DIR": options.target, "PYO3_PYTHON": sys.executable}
    with tempfile.TemporaryDirectory() as folder:
        copy = Path(folder)
        ignored = shutil.ignore_patterns("target", "*.so", "__pycache__")
        for name in ("lidarsim", "tests"):
            # As new files: cargo takes those older than its last build, which may be of a mutant, for built.
            shutil.copytree(ROOT / name, copy / name, ignore=ignored, copy_function=shutil.copy)
        found = places(copy / CORE)
        if lost := [mutant.name for mutant, where in found.items() if len(where) != 1]:
            sys.exit(f"expected each text once in the sources of the core, not so of: {', '.join(lost)}")
        chosen = [mutant for mutant in MUTANTS if options.only in mutant.name]
        if failed := unit_tests(copy / CORE, environment):
            sys.exit(f"tests fail as it is: {', '.join(failed)}")
        unnoticed = 0
        print("| mutant | noticed by |\n|---|---|", flush=True)  # noqa: T201
        for mutant in chosen:
            (source,) = found[mutant]
            before = source.read_text()
            source.write_text(before.replace(mutant.text, mutant.instead))
            # Those beside the text first: the others take longer, and most need not be asked.
            failed = unit_tests(copy / CORE, environment, module(source)) or unit_tests(copy / CORE, environment)
            if mutant.tests and not failed:
                failed = package_tests(copy, mutant.tests, environment)
            source.write_text(before)
            unnoticed += not failed and not mutant.slack
            noticed = ", ".join(failed) or (f"none: {mutant.slack}" if mutant.slack else "**no test**")
            print(f"| {mutant.name} | {noticed} |", flush=True)  # noqa: T201
    return int(unnoticed > 0)


if __name__ == "__main__":
    sys.exit(main())
