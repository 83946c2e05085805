//! Echoes of the air: of fog, and of single drops and flakes of rain and snow.

use super::beam::Beam;
use super::echo::{Echo, Returns};
use super::effects::{Draws, Echoes, FIRST_NUMBER, Pulses};
use super::scan::Scan;
use super::scratch::Scratch;
use super::source::Source;
use crate::arith::simd::{Floats, Isa};

/// The object of pulses that report an echo of the air.
pub(super) const AIR: i32 = -2;

/// What eight pulses of one ray each report.
#[derive(Clone, Copy)]
pub(super) struct Reported<F> {
    /// A bit for each that has a return, and for each whose return comes from the air.
    pub(super) kept: u32,
    pub(super) aerial: u32,
    pub(super) range: F,
    pub(super) truth: F,
    pub(super) intensity: F,
    pub(super) power: F,
}

impl<F: Floats<f64, N>, const N: usize> Echoes<F, N> {
    #[inline(always)]
    pub(super) fn report(&self) -> Reported<F> {
        let Echoes { kept, range, intensity, power, .. } = *self;
        Reported { kept, aerial: 0, range: self.reported_range(), truth: range, intensity, power }
    }
}

impl<F: Floats<f64, 8>> Reported<F> {
    /// Takes those of the air that are reported instead.
    #[inline(always)]
    fn add<I: Isa<F64x8 = F>>(&mut self, returns: Returns, air: Reported<F>) {
        let preferred = returns.prefer([air.truth, air.power], [self.truth, self.power]);
        let lanes = air.kept & (preferred | !self.kept);
        self.kept |= lanes;
        self.aerial |= lanes;
        self.range = I::pick(lanes, air.range, self.range);
        self.truth = I::pick(lanes, air.truth, self.truth);
        self.intensity = I::pick(lanes, air.intensity, self.intensity);
        self.power = I::pick(lanes, air.power, self.power);
    }
}

impl Scan<'_> {
    /// Adds the echoes of the air to what eight pulses of one ray each report of surfaces, those from 8·part
    /// on. `surface`: how far off these are, infinite if there is none.
    #[inline(always)]
    pub(super) fn add_weather<I: Isa>(
        &self,
        part: usize,
        batch: &Pulses,
        draws: &Draws,
        surface: I::F64x8,
        reported: &mut Reported<I::F64x8>,
    ) {
        let (effects, returns) = (&self.measurement.effects, self.measurement.returns);
        if let Some(fog) = effects.fog().filter(|fog| fog.is_even()) {
            let [range, power, end] = [fog.range, fog.power, fog.clear_to].map(I::F64x8::splat);
            let mut open = end.lt(surface);
            if !effects.fluctuates() {
                // Then it is known before its noise is drawn.
                let preferred = returns.prefer([range, power], [reported.truth, reported.power]);
                open &= preferred | !reported.kept;
            }
            if open != 0 {
                let intensity = power.mul(range).mul(range);
                let mut echoes = Echoes::new(part, FIRST_NUMBER, range, intensity, power, !open & 0xff);
                effects.apply(batch, draws, &mut echoes);
                reported.add::<I>(returns, echoes.report());
            }
        }
        let surface = surface.store();
        let mut lanes = effects.spots_seen::<I::F64x8, 8>(draws, part);
        while lanes != 0 {
            let lane = lanes.trailing_zeros() as usize;
            lanes &= lanes - 1;
            let pulse = 8 * part + lane;
            if pulse >= batch.indices.len() {
                break;
            }
            for spot in effects.spots(batch, pulse, surface[lane]) {
                let mut echo = Echo::of_air(pulse, spot.range, spot.intensity);
                self.receive(pulse, FIRST_NUMBER + spot.number + 1, &mut echo, batch, draws);
                if let Ok(range) = echo.measured {
                    let [range, truth, intensity, power] =
                        [range, echo.true_range, echo.intensity, echo.power].map(I::F64x8::splat);
                    let kept = 1 << lane;
                    let air = Reported { kept, aerial: kept, range, truth, intensity, power };
                    reported.add::<I>(returns, air);
                }
            }
        }
    }

    /// Adds the echoes of the air that are detected to those that a pulse has of surfaces. Only the air in
    /// front of the first surface of a ray has any.
    #[inline(always)]
    pub(super) fn insert_weather(
        &self,
        beam: Option<&Beam>,
        pulse: usize,
        batch: &Pulses,
        scratch: &Scratch,
        echoes: &mut Vec<Echo>,
    ) {
        let effects = &self.measurement.effects;
        let first = pulse * self.measurement.rays();
        let is_clear =
            |ray: usize, range: f64| scratch.hits.object[ray] < 0 || scratch.light.range[ray] > range;
        let surfaces = echoes.len();
        let mut insert = |number: u16, mut echo: Echo| {
            self.receive(pulse, FIRST_NUMBER + number, &mut echo, batch, &scratch.draws);
            if echo.measured.is_ok() {
                echoes.push(echo);
            }
        };
        if let Some(fog) = effects.fog().filter(|fog| fog.is_even()) {
            let share: f64 = match beam {
                None => f64::from(u8::from(is_clear(first, fog.clear_to))),
                Some(beam) => {
                    let open = beam.sub_rays(pulse).filter(|(ray, _)| is_clear(*ray, fog.clear_to));
                    open.map(|(_, share)| share).sum()
                }
            };
            if share > 0.0 {
                insert(0, Echo::of_air(first, fog.range, share * fog.power * fog.range * fog.range));
            }
        }
        if effects.spots_seen::<f64, 1>(&scratch.draws, pulse) != 0 {
            for spot in effects.spots(batch, pulse, f64::INFINITY) {
                let ray = first + beam.map_or(0, |beam| beam.at_share(spot.place));
                if is_clear(ray, spot.range) {
                    insert(spot.number + 1, Echo::of_air(ray, spot.range, spot.intensity));
                }
            }
        }
        if echoes.len() > surfaces {
            tell_apart(beam.map_or(0.0, |beam| beam.separation.max(2.0 * beam.pulse_sigma)), echoes);
        }
    }
}

/// Of an echo of the air and another nearer to it than the receiver tells apart, keeps the stronger, from the
/// strongest of all on. Leaves the echoes by rising range. Those of surfaces are told apart already.
fn tell_apart(separation: f64, echoes: &mut Vec<Echo>) {
    echoes.sort_by(|one, other| other.power.total_cmp(&one.power));
    let mut kept = 0;
    for i in 0..echoes.len() {
        let echo = echoes[i];
        let is_air = |echo: &Echo| echo.source == Source::Atmosphere;
        let conflicts =
            |other: &Echo| (is_air(&echo) || is_air(other)) && (echo.range - other.range).abs() < separation;
        if !echoes[..kept].iter().any(conflicts) {
            echoes[kept] = echo;
            kept += 1;
        }
    }
    echoes.truncate(kept);
    echoes.sort_by(|a, b| a.range.total_cmp(&b.range));
}
