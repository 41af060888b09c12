//! The specular part of materials, which is added to the Lambertian part.
//!
//! The solver ignores it. Path and light tracing follow it ([`crate::monte_carlo::reflection`]).

/// A model of specular reflection with its parameters. Reflectances are R G B in \[0, 1\].
#[derive(Debug, Clone, PartialEq)]
pub enum Specular {
    /// A perfect mirror.
    Mirror(Fresnel),
    /// The modified Phong model.
    Phong {
        /// Share of the light at normal incidence that the lobe reflects.
        reflectance: [f64; 3],
        /// Exponent of the cosine, at least 0.
        exponent: f64,
    },
    /// The Blinn-Phong model.
    BlinnPhong {
        /// Share of the light at normal incidence that the lobe reflects.
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
        /// Distribution of the slopes of the facets.
        distribution: Distribution,
        /// Roughness along the tangent and across it, above 0.
        alpha: [f64; 2],
        /// Reflectance of a facet.
        fresnel: Fresnel,
        /// Masking and shadowing of facets by other facets.
        shadowing: Shadowing,
    },
    /// The metallic-roughness model of glTF. The reflectance of the material, with its texture, is the base colour: the
    /// reflectance of a metal, or the diffuse reflectance of a dielectric.
    MetallicRoughness {
        /// From 0 for a dielectric to 1 for a metal.
        metallic: f64,
        /// Perceptual roughness from 0 to 1: the square root of GGX's alpha.
        roughness: f64,
        /// From 0 for an isotropic surface to 1 for one that is brushed along the tangent.
        anisotropy: f64,
    },
}

/// Distribution of the slopes of microfacets.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Distribution {
    /// Gaussian slopes (Beckmann and Spizzichino, 1963).
    Beckmann,
    /// Trowbridge and Reitz' distribution, with longer tails (Walter et al., EGSR 2007).
    Ggx,
}

/// The combination of Smith's masking in one direction with shadowing in the other.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum Shadowing {
    /// Correlated by height: a high facet is visible from both directions (Heitz, "Understanding the Masking-Shadowing
    /// Function in Microfacet-Based BRDFs", JCGT 3(2), 2014, equation 99).
    #[default]
    HeightCorrelated,
    /// Independent of each other, which is a little darker. Some other programs use it.
    Separable,
}

/// Reflectance of a smooth surface as a function of the angle of incidence.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Fresnel {
    /// The same at all angles.
    Constant([f64; 3]),
    /// Schlick's approximation, from its value at normal incidence.
    Schlick([f64; 3]),
    /// A metal with the complex index of refraction η + iκ relative to the outside.
    Conductor {
        /// The real part, above 0.
        eta: [f64; 3],
        /// The imaginary part, at least 0.
        kappa: [f64; 3],
    },
}

impl Specular {
    /// Checks the parameters.
    ///
    /// # Errors
    /// A sentence about the first parameter that is out of range.
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

/// The smallest roughness of microfacets. Its lobe is a tenth of a degree wide, which directions in single precision
/// resolve. glTF allows a roughness of 0, at which the model would become a mirror.
pub(crate) const LEAST_ALPHA: f64 = 1e-3;

/// Largest exponent. Its lobe is a tenth of a degree wide, which directions in single precision still resolve.
pub const MOST_EXPONENT: f64 = 1e6;
