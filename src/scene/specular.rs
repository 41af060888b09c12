//! The specular part of materials: what a surface reflects beside its Lambertian part.
//!
//! The solver has no use for it. Path and light tracing follow it ([`crate::monte_carlo::reflection`]).

/// A model of specular reflection with its parameters. Reflectances are R G B in \[0, 1\].
#[derive(Debug, Clone, PartialEq)]
pub enum Specular {
    /// A perfect mirror.
    Mirror(Fresnel),
    /// The modified Phong model.
    Phong {
        /// Share of the light from straight above that the lobe reflects.
        reflectance: [f64; 3],
        /// Exponent of the cosine, at least 0.
        exponent: f64,
    },
    /// The Blinn-Phong model.
    BlinnPhong {
        /// Share of the light from straight above that the lobe reflects.
        reflectance: [f64; 3],
        /// Exponent of the cosine, at least 0.
        exponent: f64,
    },
    /// Ward's model.
    Ward {
        /// Upper bound of the share of light that the lobe reflects.
        reflectance: [f64; 3],
        /// Root mean square slopes along the tangent and across it, above 0.
        alpha: [f64; 2],
    },
    /// Cook and Torrance's microfacets.
    Microfacet {
        /// How the slopes of the facets are distributed.
        distribution: Distribution,
        /// Roughness along the tangent and across it, above 0.
        alpha: [f64; 2],
        /// What a facet reflects.
        fresnel: Fresnel,
        /// Which facets others hide.
        shadowing: Shadowing,
    },
    /// glTF's metallic-roughness model. The reflectance of the material, with its texture, is the base colour: what a metal reflects,
    /// or what is below the surface of a dielectric.
    MetallicRoughness {
        /// From 0, a dielectric, to 1, a metal.
        metallic: f64,
        /// Perceptual roughness from 0 to 1: the square root of GGX's alpha.
        roughness: f64,
        /// From 0, alike in all directions, to 1, brushed along the tangent.
        anisotropy: f64,
    },
}

/// How the slopes of microfacets are distributed.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Distribution {
    /// Gaussian slopes (Beckmann and Spizzichino, 1963).
    Beckmann,
    /// Trowbridge and Reitz' distribution, with longer tails (Walter et al., EGSR 2007).
    Ggx,
}

/// How Smith's masking of one direction and shadowing of the other combine.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum Shadowing {
    /// As facets of one height field: what is high is seen from both sides (Heitz, "Understanding the Masking-Shadowing Function in
    /// Microfacet-Based BRDFs", JCGT 3(2), 2014, equation 99).
    #[default]
    HeightCorrelated,
    /// As if independent: a little darker. Some other programs use it.
    Separable,
}

/// What a smooth surface reflects, by the angle of incidence.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Fresnel {
    /// The same at all angles.
    Constant([f64; 3]),
    /// Schlick's approximation, from its value at normal incidence.
    Schlick([f64; 3]),
    /// A metal, by its complex index of refraction η + iκ relative to what is outside.
    Conductor {
        /// The real part, above 0.
        eta: [f64; 3],
        /// The imaginary part, at least 0.
        kappa: [f64; 3],
    },
}

impl Specular {
    /// What is wrong with the parameters, if anything.
    ///
    /// # Errors
    /// The first parameter that is out of its range, in words.
    pub fn check(&self) -> Result<(), String> {
        let share = |x: f64, what: &str| match (0.0..=1.0).contains(&x) {
            true => Ok(()),
            false => Err(format!("{what} {x} is outside 0..1")),
        };
        let colour = |c: &[f64; 3], what: &str| c.iter().try_for_each(|&x| share(x, what));
        let exponent = |n: f64| match (0.0..=MOST_EXPONENT).contains(&n) {
            true => Ok(()),
            false => Err(format!("exponent {n} is outside 0..{MOST_EXPONENT:e}")),
        };
        let rough = |alpha: &[f64; 2]| match alpha.iter().find(|&&a| !(a > 0.0 && a <= 1.0)) {
            None => Ok(()),
            Some(a) => Err(format!("roughness {a} is not above 0 and at most 1")),
        };
        let fresnel = |fresnel: &Fresnel| match fresnel {
            Fresnel::Constant(r) | Fresnel::Schlick(r) => colour(r, "reflectance"),
            Fresnel::Conductor { eta, kappa } => {
                let good = |x: &f64, least: f64| *x >= least && x.is_finite();
                match eta.iter().all(|n| good(n, 1e-3)) && kappa.iter().all(|k| good(k, 0.0)) {
                    true => Ok(()),
                    false => Err("an index of refraction is out of range".into()),
                }
            }
        };
        match self {
            Specular::Mirror(f) => fresnel(f),
            Specular::Phong { reflectance, exponent: n }
            | Specular::BlinnPhong { reflectance, exponent: n } => {
                colour(reflectance, "reflectance").and(exponent(*n))
            }
            Specular::Ward { reflectance, alpha } => colour(reflectance, "reflectance").and(rough(alpha)),
            Specular::Microfacet { alpha, fresnel: f, .. } => rough(alpha).and(fresnel(f)),
            Specular::MetallicRoughness { metallic, roughness, anisotropy } => {
                share(*metallic, "metallic")?;
                share(*roughness, "roughness")?;
                share(*anisotropy, "anisotropy")
            }
        }
    }
}

/// Largest exponent: its lobe is a tenth of a degree wide, and single-precision directions still resolve it.
pub const MOST_EXPONENT: f64 = 1e6;
