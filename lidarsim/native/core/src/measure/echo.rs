//! From light that comes back to the returns that are reported.

use super::parameters::{Parameters, Value};
use super::source::Source;
use super::status::Status;
use crate::arith::simd::Floats;

/// What a ray brings back.
#[derive(Clone, Copy)]
pub(super) struct Light {
    pub(super) ray: usize,
    pub(super) range: f64,
    pub(super) intensity: f64,
    /// Received, up to a constant: intensity/R².
    pub(super) power: f64,
    /// The power without extinction. It separates echoes, so extinction only ever weakens them.
    pub(super) clear_power: f64,
}

/// Light from one surface, or from some too close to be separated; or a false return.
#[derive(Clone, Copy, Debug)]
pub(super) struct Echo {
    pub(super) source: Source,
    /// The true hit, if there is one: the sub-ray nearest to the axis, on the object that returns most of the
    /// power.
    pub(super) ray: usize,
    pub(super) true_range: f64,
    /// The mean over the sub-rays, by power.
    pub(super) range: f64,
    pub(super) intensity: f64,
    pub(super) power: f64,
    /// The reported range, or why the echo is lost.
    pub(super) measured: Result<f64, Status>,
}

impl Light {
    /// Weakens the light to a share of its power.
    pub(super) fn dim(self, share: f64) -> Self {
        let Light { intensity, power, clear_power, .. } = self;
        Light { intensity: share * intensity, power: share * power, clear_power: share * clear_power, ..self }
    }
}

impl Echo {
    #[inline(always)]
    pub(super) fn status(&self) -> Status {
        self.measured.err().unwrap_or(Status::Hit)
    }

    #[inline(always)]
    pub(super) fn of(light: Light) -> Self {
        let Light { ray, range, intensity, power, .. } = light;
        Echo { source: Source::Surface, ray, true_range: range, range, intensity, power, measured: Ok(range) }
    }

    /// An echo of the air, before receiver effects, on ray `ray`.
    pub(super) fn of_air(ray: usize, range: f64, intensity: f64) -> Self {
        let power = intensity / (range * range);
        let (source, measured) = (Source::Atmosphere, Ok(range));
        Echo { source, ray, true_range: range, range, intensity, power, measured }
    }

    /// A false return of the pulse of ray `ray`.
    #[inline(always)]
    pub(super) fn falsely(ray: usize, range: f64, intensity: f64) -> Self {
        // Weaker than any light that is seen.
        let power = f64::NEG_INFINITY;
        let measured = Ok(range);
        Echo { source: Source::FalseReturn, ray, true_range: f64::NAN, range, intensity, power, measured }
    }
}

/// Which echoes of a pulse are reported, and in which order.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Returns {
    Strongest,
    First,
    Last,
    /// The strongest, then the last; where these are one, the next strongest.
    Dual,
    /// This many at most, from the nearest on.
    Nearest(usize),
}

impl Returns {
    pub(super) fn from_parameters<P: Parameters>(parameters: &P) -> Result<Self, P::Error> {
        const NAME: &str = "measurement.returns";
        match parameters.value(NAME)? {
            Value::Text(name) => match name.as_str() {
                "strongest" => Ok(Returns::Strongest),
                "first" => Ok(Returns::First),
                "last" => Ok(Returns::Last),
                "dual" => Ok(Returns::Dual),
                _ => Err(parameters.unexpected(NAME, Value::Text(name))),
            },
            most => Ok(Returns::Nearest(parameters.as_number(NAME, most)? as usize)),
        }
    }

    /// The most that are reported of a pulse.
    pub(super) fn most(self) -> usize {
        match self {
            Returns::Strongest | Returns::First | Returns::Last => 1,
            Returns::Dual => 2,
            Returns::Nearest(n) => n,
        }
    }

    /// Of N pulses with two echoes and one return, those that report the echo of this range and power rather
    /// than the other.
    #[inline(always)]
    pub(super) fn prefer<F: Floats<f64, N>, const N: usize>(
        self,
        [range, power]: [F; 2],
        other: [F; 2],
    ) -> u32 {
        match self {
            Returns::Strongest | Returns::Dual => other[1].lt(power),
            Returns::First | Returns::Nearest(_) => range.lt(other[0]),
            Returns::Last => other[0].lt(range),
        }
    }

    /// Of N pulses that have an echo and a false return and report one, those that report the false return.
    /// It is the weaker, but may be the first or the last.
    #[inline(always)]
    pub(super) fn prefer_false<F: Floats<f64, N>, const N: usize>(self, falsely: F, range: F) -> u32 {
        match self {
            Returns::Strongest | Returns::Dual => 0,
            Returns::First | Returns::Nearest(_) => falsely.lt(range),
            Returns::Last => range.lt(falsely),
        }
    }

    /// Chooses the echoes to report, in their order, from those of a pulse, which rise in range. If all are
    /// lost, the strongest.
    pub(super) fn choose(self, echoes: &[Echo], chosen: &mut Vec<Echo>) {
        chosen.clear();
        chosen.extend(echoes.iter().filter(|echo| echo.measured.is_ok()));
        if chosen.is_empty() {
            chosen.extend(echoes.get(strongest(echoes)));
        }
        if chosen.len() < 2 {
            return;
        }
        let i = strongest(chosen);
        match self {
            Returns::First | Returns::Nearest(_) => {}
            Returns::Last => chosen.reverse(),
            Returns::Strongest => chosen.swap(0, i),
            Returns::Dual => {
                let first = chosen.remove(i);
                let last = chosen.len() - 1;
                let second = if i > last { strongest(chosen) } else { last };
                chosen.swap(0, second);
                chosen.insert(0, first);
            }
        }
        chosen.truncate(self.most());
    }
}

/// Index of the strongest echo; of equal ones, the first.
fn strongest(echoes: &[Echo]) -> usize {
    let mut best = (0, f64::NEG_INFINITY);
    for (i, echo) in echoes.iter().enumerate() {
        if echo.power > best.1 {
            best = (i, echo.power);
        }
    }
    best.0
}

#[cfg(test)]
mod tests {
    use super::*;

    fn chosen(returns: Returns, powers: &[f64]) -> Vec<f64> {
        let echo = |range: f64, power: f64| {
            let light = Light { ray: 0, range, intensity: power, power, clear_power: power };
            if power < 0.0 {
                Echo { true_range: range, ..Echo::falsely(0, range, 0.0) }
            } else {
                Echo::of(light)
            }
        };
        let echoes: Vec<Echo> = (1..).zip(powers).map(|(i, &power)| echo(f64::from(i), power)).collect();
        let mut found = Vec::new();
        returns.choose(&echoes, &mut found);
        found.iter().map(|echo| echo.true_range).collect()
    }

    #[test]
    fn returns_are_chosen_and_ordered() {
        let powers = [1.0, 3.0, 2.0, 1.0];
        assert_eq!(chosen(Returns::Strongest, &powers), [2.0]);
        assert_eq!(chosen(Returns::First, &powers), [1.0]);
        assert_eq!(chosen(Returns::Last, &powers), [4.0]);
        assert_eq!(chosen(Returns::Dual, &powers), [2.0, 4.0]);
        assert_eq!(chosen(Returns::Dual, &[1.0, 2.0, 3.0]), [3.0, 2.0]);
        assert_eq!(chosen(Returns::Dual, &[1.0, 1.0]), [1.0, 2.0]);
        assert_eq!(chosen(Returns::Dual, &[1.0]), [1.0]);
        assert_eq!(chosen(Returns::Nearest(3), &powers), [1.0, 2.0, 3.0]);
        assert_eq!(chosen(Returns::Nearest(9), &powers), [1.0, 2.0, 3.0, 4.0]);
    }

    /// Below zero: a false return.
    #[test]
    fn false_returns_are_the_weakest() {
        let powers = [-1.0, 0.0, 2.0, 1.0];
        assert_eq!(chosen(Returns::Strongest, &powers), [3.0]);
        assert_eq!(chosen(Returns::Strongest, &powers[..2]), [2.0]);
        assert_eq!(chosen(Returns::Strongest, &powers[..1]), [1.0]);
        assert_eq!(chosen(Returns::First, &powers), [1.0]);
        assert_eq!(chosen(Returns::Last, &powers), [4.0]);
        assert_eq!(chosen(Returns::Dual, &[2.0, -1.0]), [1.0, 2.0]);
        assert_eq!(chosen(Returns::Dual, &[-1.0, 1.0, 3.0]), [3.0, 2.0]);
        assert_eq!(chosen(Returns::Nearest(2), &powers), [1.0, 2.0]);
        let ranges = [Returns::First, Returns::Last, Returns::Strongest, Returns::Dual, Returns::Nearest(1)];
        assert_eq!(ranges.map(|returns| returns.prefer_false(1.0, 2.0)), [1, 0, 0, 0, 1]);
        assert_eq!(ranges.map(|returns| returns.prefer_false(2.0, 1.0)), [0, 1, 0, 0, 0]);
    }
}
