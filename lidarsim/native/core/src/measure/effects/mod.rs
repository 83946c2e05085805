//! The effects of a measurement: one file each, with its permanent id, its parameters and its formula.
//!
//! To add an effect, write its file, add its line to `effects!` below, and add its parameter to
//! `lidarsim/sensor/measurement.py`.
//!
//! An effect that is off draws nothing and costs nothing. Draws depend only on seed, sensor, frame, pulse and
//! effect (`rng.rs`), so no effect changes the noise of another.

mod air;
mod bias;
mod crossover;
mod detection;
mod dropout;
mod extinction;
mod false_returns;
mod fluctuation;
mod fog;
mod gate;
mod jitter;
mod near;
mod particles;
mod per_ring;
mod quantization;
mod range_noise;
mod reading;
mod response;

use std::ops::Range;

use super::parameters::Parameters;
use super::rng::{EffectId, Stream};
use super::status::Status;
use crate::arith::simd::{Floats, Isa, lanes};
use crate::geometry::vector::Point;

/// Echoes of the air draw these numbers of the effects that draw for each echo; those of surfaces draw the
/// numbers below, so that neither change the other.
pub(super) const FIRST_NUMBER: u16 = 1 << 15;

/// Declares the effects, in the order in which they are applied.
macro_rules! effects {
    ($($field:ident: $module:ident::$effect:ident),+ $(,)?) => {
        /// The effects that are on.
        #[derive(Clone, Debug, Default)]
        pub struct Effects {
            $($field: Option<$module::$effect>),+
        }

        /// The draws of all effects for a batch of pulses. Those of an effect that is off are unspecified.
        #[derive(Default)]
        pub(super) struct Draws {
            $($field: <$module::$effect as Effect>::Draws),+
        }

        impl Effects {
            pub(super) fn from_parameters<P: Parameters>(parameters: &P) -> Result<Self, P::Error> {
                Ok(Effects { $($field: $module::$effect::from_parameters(parameters)?),+ })
            }

            /// Draws for each pulse of a batch.
            #[inline(always)]
            pub(super) fn draw<I: Isa>(&self, pulses: &Pulses, draws: &mut Draws) {
                $(if let Some(effect) = &self.$field {
                    effect.draw::<I>(pulses, &mut draws.$field);
                })+
            }

            /// The intensity in clear air that the receiver gathers of rays of these ranges.
            #[inline(always)]
            pub(super) fn gather<F: Floats<f64, N>, const N: usize>(&self, range: F, mut intensity: F) -> F {
                $(if let Some(effect) = &self.$field {
                    intensity = effect.gather(range, intensity);
                })+
                intensity
            }

            /// Whether any effect attenuates light.
            pub(super) fn attenuates(&self) -> bool {
                false $(|| self.$field.is_some() && <$module::$effect as Effect>::ATTENUATES)+
            }

            /// Multiplies the transmission of the atmosphere for rays of these ranges.
            #[inline(always)]
            pub(super) fn attenuate(&self, ranges: &[f64], transmission: &mut [f64]) {
                $(if let Some(effect) = &self.$field {
                    effect.attenuate(ranges, transmission);
                })+
            }

            /// Turns echoes into readings of the sensor.
            #[inline(always)]
            pub(super) fn apply<F: Floats<f64, N>, const N: usize>(
                &self,
                pulses: &Pulses,
                draws: &Draws,
                echoes: &mut Echoes<F, N>,
            ) {
                $(if let Some(effect) = &self.$field
                    && <$module::$effect as Effect>::ACTS_ON.echoes()
                {
                    effect.apply(pulses, &draws.$field, echoes);
                })+
                $(if let Some(effect) = &self.$field {
                    effect.report(pulses, &draws.$field, echoes);
                })+
            }

            /// The false returns of N pulses, those from N·part on; none if there never are any. Their
            /// intensity is the least that is detected at their range.
            #[inline(always)]
            pub(super) fn false_returns<F: Floats<f64, N>, const N: usize>(
                &self,
                part: usize,
                pulses: &Pulses,
                draws: &Draws,
            ) -> Option<Echoes<F, N>> {
                self.false_returns.as_ref()?;
                let zero = F::splat(0.0);
                let mut echoes = Echoes::new(part, FIRST_NUMBER - 1, zero, zero, zero, 0);
                $(if let Some(effect) = &self.$field
                    && <$module::$effect as Effect>::ACTS_ON.false_returns()
                {
                    effect.apply(pulses, &draws.$field, &mut echoes);
                })+
                echoes.range = echoes.reported_range();
                $(if let Some(effect) = &self.$field {
                    echoes.intensity = echoes.intensity.max(effect.least_intensity(echoes.range));
                })+
                $(if let Some(effect) = &self.$field {
                    effect.report(pulses, &draws.$field, &mut echoes);
                })+
                Some(echoes)
            }
        }

        const IDS: &[Option<EffectId>] =
            &[$(<$module::$effect as Effect>::ID),+, <response::Channels as Effect>::ID];
    };
}

effects! {
    jitter: jitter::Jitter,
    crossover: crossover::Crossover,
    extinction: extinction::Extinction,
    fog: fog::Fog,
    particles: particles::Particles,
    fluctuation: fluctuation::Fluctuation,
    near: near::Near,
    detection: detection::DetectionLimit,
    dropout: dropout::Dropout,
    bias: bias::Bias,
    range_noise: range_noise::RangeNoise,
    reading: reading::Reading,
    false_returns: false_returns::FalseReturns,
    quantization: quantization::Quantization,
    gate: gate::Gate,
    response: response::Response,
}

impl Effects {
    /// Whether pulses are cast in other directions than their own.
    pub(super) fn turns(&self) -> bool {
        self.jitter.is_some()
    }

    /// The directions in which the pulses of a batch are cast, in the sensor frame.
    #[inline(always)]
    pub(super) fn directions<'a>(&self, pulses: &Pulses<'a>, draws: &'a Draws) -> &'a [Point] {
        self.jitter.as_ref().map_or(pulses.directions, |_| &draws.jitter.directions)
    }

    /// Whether returns may come from anything but surfaces.
    pub(super) fn tells_sources(&self) -> bool {
        self.false_returns.is_some() || self.has_weather()
    }

    /// Whether the air has echoes.
    #[inline(always)]
    pub(super) fn has_weather(&self) -> bool {
        self.fog.is_some() || self.particles.is_some()
    }

    /// Whether the power of an echo is changed at random.
    #[inline(always)]
    pub(super) fn fluctuates(&self) -> bool {
        self.fluctuation.is_some()
    }

    pub(super) fn fog(&self) -> Option<&fog::Fog> {
        self.fog.as_ref()
    }

    pub(super) fn particles(&self) -> Option<&particles::Particles> {
        self.particles.as_ref()
    }

    /// A bit for each of N pulses, those from N·part on, that see a patch of fog, a drop or a flake.
    #[inline(always)]
    pub(super) fn spots_seen<F: Floats<f64, N>, const N: usize>(&self, draws: &Draws, part: usize) -> u32 {
        self.fog.as_ref().map_or(0, |fog| fog.echo_mask::<F, N>(draws, part))
            | self.particles.as_ref().map_or(0, |particles| particles.echo_mask::<F, N>(draws, part))
    }

    /// The patches, drops and flakes nearer than `end` that a pulse of the batch sees.
    #[inline(always)]
    pub(super) fn spots<'a>(
        &'a self,
        batch: &'a Pulses,
        pulse: usize,
        end: f64,
    ) -> impl Iterator<Item = particles::Particle> + 'a {
        let is_nearer = move |spot: &particles::Particle| spot.range < end;
        let patches = self.fog.iter().flat_map(move |fog| fog.of(batch, pulse).take_while(is_nearer));
        let particles =
            self.particles.iter().flat_map(move |these| these.of(batch, pulse).take_while(is_nearer));
        patches.chain(particles)
    }

    /// The parameters that each ring has of its own, and the number of rings that have them.
    pub(super) fn rings(&self) -> impl Iterator<Item = (&'static str, usize)> {
        let biases = self.bias.as_ref().and_then(bias::Bias::rings);
        let offsets = self.reading.as_ref().and_then(reading::Reading::rings);
        biases.map(|n| ("range_bias", n)).into_iter().chain(offsets.map(|n| ("range_offset", n)))
    }
}

/// Two effects with one id would share their draws.
const _: () = {
    let mut i = 0;
    while i < IDS.len() {
        let mut j = 0;
        while j < i {
            if let (Some(a), Some(b)) = (IDS[i], IDS[j]) {
                assert!(a.0 != b.0);
            }
            j += 1;
        }
        i += 1;
    }
};

/// An effect: its parameters, and what it does with them. Each hook is written once, over N lanes. A formula
/// without lanes goes in a loop over the stored lanes: a closure would not be compiled for the instruction
/// set.
trait Effect: Sized {
    /// By this id an effect draws. An id is never used again for another effect, so that scans stay
    /// reproducible across versions. None: the effect draws nothing.
    const ID: Option<EffectId> = None;

    /// What `apply` acts on.
    const ACTS_ON: ActsOn = ActsOn::Echoes;

    /// Whether the effect has an `attenuate`.
    const ATTENUATES: bool = false;

    /// Draws for each pulse of a batch, reused from one batch to the next.
    type Draws: Default;

    /// The effect with its parameters; none if these leave it off.
    fn from_parameters<P: Parameters>(parameters: &P) -> Result<Option<Self>, P::Error>;

    /// Draws for each pulse of a batch.
    #[inline(always)]
    fn draw<I: Isa>(&self, _: &Pulses, _: &mut Self::Draws) {}

    /// The part of the intensity that the receiver gathers of rays of these ranges, in any air.
    #[inline(always)]
    fn gather<F: Floats<f64, N>, const N: usize>(&self, _range: F, intensity: F) -> F {
        intensity
    }

    /// Multiplies the transmission of the atmosphere out to some ranges and back: over any number of rays, in
    /// a loop that becomes vector instructions.
    #[inline(always)]
    fn attenuate(&self, _ranges: &[f64], _transmission: &mut [f64]) {}

    /// Changes the readings of echoes, or loses some of them.
    #[inline(always)]
    fn apply<F: Floats<f64, N>, const N: usize>(&self, _: &Pulses, _: &Self::Draws, _: &mut Echoes<F, N>) {}

    /// The least intensity that is detected at a range.
    #[inline(always)]
    fn least_intensity<F: Floats<f64, N>, const N: usize>(&self, _range: F) -> F {
        F::splat(0.0)
    }

    /// Turns the intensity of echoes and false returns, after all effects, into the number that is reported.
    #[inline(always)]
    fn report<F: Floats<f64, N>, const N: usize>(&self, _: &Pulses, _: &Self::Draws, _: &mut Echoes<F, N>) {}
}

/// What an effect acts on.
enum ActsOn {
    Echoes,
    FalseReturns,
    Both,
}

impl ActsOn {
    const fn echoes(&self) -> bool {
        !matches!(self, ActsOn::FalseReturns)
    }

    const fn false_returns(&self) -> bool {
        !matches!(self, ActsOn::Echoes)
    }
}

/// The pulses of a batch, as effects see them.
pub(super) struct Pulses<'a> {
    pub(super) stream: Stream,
    /// The number of each pulse in the whole frame.
    pub(super) indices: &'a [u64],
    pub(super) rings: &'a [u16],
    /// In the sensor frame.
    pub(super) directions: &'a [Point],
}

impl Pulses<'_> {
    /// The length of arrays of draws: whole registers of pulses. What is past the pulses is unspecified.
    #[inline(always)]
    fn padded_len(&self) -> usize {
        self.indices.len().next_multiple_of(8)
    }

    /// A uniform number for each pulse.
    #[inline(always)]
    fn uniforms<I: Isa, E: Effect>(&self, draw: u16, uniforms: &mut Vec<f64>) {
        self.stream.uniforms::<I>(self.indices, const { id::<E>() }, draw, uniforms);
        uniforms.resize(self.padded_len(), 0.0);
    }

    /// A normal number for each pulse.
    #[inline(always)]
    fn normals<I: Isa, E: Effect>(&self, draw: u16, normals: &mut Vec<f64>) {
        self.stream.normals::<I>(self.indices, const { id::<E>() }, draw, normals);
        normals.resize(self.padded_len(), 0.0);
    }

    /// For each pulse the normal number of its channel, the same in all frames.
    #[inline(always)]
    fn normals_of_channels<I: Isa, E: Effect>(&self, draw: u16, normals: &mut Vec<f64>) {
        let channels: Vec<u64> = self.rings.iter().map(|ring| u64::from(*ring)).collect();
        self.stream.of_unit().normals::<I>(&channels, const { id::<E>() }, draw, normals);
        normals.resize(self.padded_len(), 0.0);
    }

    /// For each pulse the normal number of its channel in its block of pulses of the frame.
    #[inline(always)]
    fn normals_of_blocks<I: Isa, E: Effect>(&self, block: u64, draw: u16, normals: &mut Vec<f64>) {
        let blocks = self.indices.iter().zip(self.rings);
        let blocks = blocks.map(|(index, ring)| (index / block) << 16 | u64::from(*ring));
        self.stream.normals::<I>(&blocks.collect::<Vec<_>>(), const { id::<E>() }, draw, normals);
        normals.resize(self.padded_len(), 0.0);
    }

    /// A normal number for the pulse of each echo, drawn as it is needed.
    #[inline(always)]
    fn lane_normals<E: Effect, F: Floats<f64, N>, const N: usize>(
        &self,
        draw: u16,
        echoes: &Echoes<F, N>,
    ) -> F {
        let mut normals = [0.0; N];
        for (normal, pulse) in normals.iter_mut().zip(&self.indices[echoes.pulses().start..]) {
            *normal = self.stream.normal(*pulse, const { id::<E>() }, draw);
        }
        F::load(&normals)
    }
}

/// The id of an effect that draws.
const fn id<E: Effect>() -> EffectId {
    match E::ID {
        Some(id) => id,
        None => panic!("an effect that draws needs an id"),
    }
}

/// Echoes of N pulses, one each, as the receiver processes them.
pub(super) struct Echoes<F, const N: usize> {
    /// Which N pulses of the batch: those from N·part on.
    pub(super) part: usize,
    /// The number of nearer echoes of the same pulse; 0 if N > 1.
    pub(super) number: u16,
    /// Range before any error, m.
    pub(super) range: F,
    pub(super) intensity: F,
    /// Received power, up to a constant: intensity/R².
    pub(super) power: F,
    /// What is added to the range, m.
    error: F,
    /// The range that the sensor finds, from its own zero, m.
    reading: F,
    /// The sensor's own range less that from the beam's origin, m.
    offset: F,
    /// A bit for each echo that is not lost.
    pub(super) kept: u32,
    /// By status, a bit for each echo that is lost and has this status.
    lost: [u32; Status::COUNT],
}

impl<F: Floats<f64, N>, const N: usize> Echoes<F, N> {
    /// `missed`: a bit for each pulse without an echo.
    #[inline(always)]
    pub(super) fn new(part: usize, number: u16, range: F, intensity: F, power: F, missed: u32) -> Self {
        let (zero, lost) = (F::splat(0.0), [0; Status::COUNT]);
        let kept = (1 << N) - 1;
        let mut echoes = Echoes {
            part,
            number,
            range,
            intensity,
            power,
            error: zero,
            reading: range,
            offset: zero,
            kept,
            lost,
        };
        echoes.lose(missed, Status::Miss);
        echoes
    }

    /// Loses those of some echoes that are not yet lost: the first effect that loses an echo tells its
    /// status.
    #[inline(always)]
    fn lose(&mut self, lanes: u32, status: Status) {
        self.lost[status as usize] |= lanes & self.kept;
        self.kept &= !lanes;
    }

    /// The range from the beam's origin that is reported of an echo that is kept.
    #[inline(always)]
    pub(super) fn reported_range(&self) -> F {
        self.reading.sub(self.offset)
    }

    /// The status of each pulse.
    #[inline(always)]
    pub(super) fn statuses(&self) -> [u8; 8] {
        let mut statuses = 0;
        for (status, lost) in (0..).zip(self.lost) {
            statuses |= lanes::bytes(lost, status);
        }
        statuses.to_le_bytes()
    }

    /// The numbers of these pulses in the batch.
    #[inline(always)]
    fn pulses(&self) -> Range<usize> {
        N * self.part..N * self.part + N
    }
}
