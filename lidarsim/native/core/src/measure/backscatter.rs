//! How much light a surface that is not Lambert's returns to where the light came from.

use crate::arith::elementary::exp;
use crate::arith::simd::Floats;

/// f(θ) = A·cos θ + B·sin²θ + s·exp(−tan²θ/w²)/cos⁵θ, in place of Lambert's cos θ.
///
/// The first two terms are those of a rough diffuser (M. Oren, S. K. Nayar: Generalization of Lambert's
/// reflectance model. SIGGRAPH 94, the qualitative model): cos θᵢ·(A + B·max(0, cos Δφ)·sin α·tan β), with α
/// the larger and β the smaller of the angles of source and receiver. A lidar has both in one place: θᵢ = θᵣ
/// = θ and Δφ = 0, so the second term is B·cos θ·sin θ·tan θ = B·sin²θ.
///
/// The third is a highlight of microfacets whose slopes have Beckmann's distribution, exp(−tan²α/w²)/cos⁴α up
/// to a constant (R. L. Cook, K. E. Torrance: A reflectance model for computer graphics. ACM Transactions on
/// Graphics 1, 1982). The facets that send light back face the source, so α = θ. Their radiance has 1/(cos θᵢ
/// cos θᵣ) beside the distribution, and cos θᵢ for the light that arrives, hence cos⁵θ. It is s at θ = 0.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Backscatter {
    /// A.
    cosine: f64,
    /// B.
    squared_sine: f64,
    /// s.
    specular: f64,
    /// w.
    width: f64,
}

impl Backscatter {
    /// Its f(θ) is cos θ, with no rounding.
    pub(super) const LAMBERT: Self =
        Backscatter { cosine: 1.0, squared_sine: 0.0, specular: 0.0, width: 1.0 };

    /// `roughness`: the standard deviation of the slopes of the facets of a rough diffuser, as angles, rad.
    /// None: Lambert's.
    pub fn new(roughness: f64, specular: f64, width: f64) -> Option<Self> {
        if roughness == 0.0 && specular == 0.0 {
            return None;
        }
        let square = roughness * roughness;
        Some(Backscatter {
            cosine: 1.0 - 0.5 * square / (square + 0.33),
            squared_sine: 0.45 * square / (square + 0.09),
            specular,
            // Without a highlight any width will do, of which this has no overflow.
            width: if specular > 0.0 { width } else { Self::LAMBERT.width },
        })
    }

    /// f of N surfaces at N angles of incidence.
    #[inline(always)]
    pub(super) fn of<F: Floats<f64, N>, const N: usize>(
        surfaces: &[Self; N],
        cosine: F,
        squared_sine: F,
    ) -> F {
        let (mut a, mut b, mut specular, mut width) = ([0.0; N], [0.0; N], [0.0; N], [0.0; N]);
        for (k, surface) in surfaces.iter().enumerate() {
            (a[k], b[k]) = (surface.cosine, surface.squared_sine);
            (specular[k], width[k]) = (surface.specular, surface.width);
        }
        let diffuse = F::load(&a).mul(cosine).add(F::load(&b).mul(squared_sine));
        // Surfaces without a highlight add 0.
        if specular == [0.0; N] {
            return diffuse;
        }
        let slope = squared_sine.sqrt().div(cosine.mul(F::load(&width)));
        let mut falloff = slope.mul(slope).negated().store();
        for x in &mut falloff {
            *x = exp(*x);
        }
        let (falloff, square) = (F::load(&falloff), cosine.mul(cosine));
        let highlight = F::load(&specular).mul(falloff).div(square.mul(square).mul(cosine)).store();
        // The quotient is 0/0 where the surface is grazed. Where the exponential is 0, its argument q is more
        // than 745, and the highlight, e^(−q)·(1 + q·w²)^2.5, is less than 2⁻¹⁰⁰⁰ for all w up to 1000.
        let is_seen = F::splat(0.0).lt(falloff);
        let seen = std::array::from_fn(|k| if is_seen >> k & 1 != 0 { highlight[k] } else { 0.0 });
        diffuse.add(F::load(&seen))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn at(surface: Backscatter, theta: f64) -> f64 {
        Backscatter::of(&[surface], theta.cos(), theta.sin() * theta.sin())
    }

    #[test]
    fn neither_rough_nor_specular_is_lambert() {
        assert_eq!(Backscatter::new(0.0, 0.0, 0.1), None);
        for i in 0..=1000 {
            let cosine = f64::from(i) / 1000.0;
            let found: f64 = Backscatter::of(&[Backscatter::LAMBERT], cosine, 1.0 - cosine * cosine);
            assert_eq!(found.to_bits(), cosine.to_bits());
        }
    }

    /// Worked by hand: m² = 0.09 and 0.33, θ = 0 and π/6.
    #[test]
    fn rough_surfaces_follow_the_formula() {
        let rough = Backscatter::new(0.3, 0.0, 0.1).unwrap();
        assert!((rough.cosine - (1.0 - 0.045 / 0.42)).abs() <= f64::EPSILON);
        assert!((rough.squared_sine - 0.225).abs() <= f64::EPSILON);
        assert_eq!(at(rough, 0.0), rough.cosine);
        let other = Backscatter::new(0.33_f64.sqrt(), 0.0, 0.1).unwrap();
        let expected = 0.75 * 0.75_f64.sqrt() + 0.45 * 0.33 / 0.42 * 0.25;
        assert!((at(other, std::f64::consts::FRAC_PI_6) - expected).abs() <= 4.0 * f64::EPSILON);
    }

    #[test]
    fn highlights_end_where_surfaces_are_grazed() {
        for width in [1e-200, 1e-3, 0.1, 1.0, 1000.0] {
            let glossy = Backscatter::new(0.0, 3.0, width).unwrap();
            assert_eq!(at(glossy, 0.0), 4.0);
            for cosine in [0.0, f64::from_bits(1), 1e-100, 1e-30] {
                let found: f64 = Backscatter::of(&[glossy], cosine, 1.0);
                assert_eq!(found, cosine, "{width} {cosine}");
            }
        }
        // tan θ = w = 1: exp(−1)·2^2.5 = 2.0811… beside cos θ.
        let broad = Backscatter::new(0.0, 1.0, 1.0).unwrap();
        let expected = (-1.0_f64).exp() * 32.0_f64.sqrt() + 0.5_f64.sqrt();
        assert!((at(broad, std::f64::consts::FRAC_PI_4) / expected - 1.0).abs() <= 8.0 * f64::EPSILON);
    }
}
