//! Options that several commands share.

use clap::{Args, ValueEnum};
use glam::DVec3;
use radiosity::{Quality, patch::Subdivision};

/// How finely to cut the scene and how many rays to cast: options of every command that solves for radiosity.
#[derive(Args)]
pub struct CastArgs {
    /// A preset of patches and rays [default: medium]
    #[arg(long, value_enum)]
    quality: Option<QualityName>,
    /// Largest edge of a patch in the scene's unit; `inf` leaves the triangles whole
    #[arg(long, value_name = "LENGTH", value_parser = positive)]
    patch_size: Option<f64>,
    /// About how many patches; at least one a triangle
    #[arg(long, value_name = "N", conflicts_with = "patch_size", value_parser = clap::value_parser!(u32).range(1..))]
    patches: Option<u32>,
    /// Rays a patch, hemisphere and shadow rays together
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u32).range(1..))]
    rays: Option<u32>,
}

#[derive(Clone, Copy, ValueEnum)]
enum QualityName {
    /// 1,000 patches, 64 rays
    Draft,
    /// 8,000 patches, 256 rays
    Medium,
    /// 32,000 patches, 512 rays
    High,
    /// 100,000 patches, 1,024 rays
    Reference,
}

impl CastArgs {
    fn named(&self) -> QualityName {
        self.quality.unwrap_or(QualityName::Medium)
    }

    fn quality(&self) -> Quality {
        match self.named() {
            QualityName::Draft => Quality::DRAFT,
            QualityName::Medium => Quality::MEDIUM,
            QualityName::High => Quality::HIGH,
            QualityName::Reference => Quality::REFERENCE,
        }
    }

    /// How to cut the scene, and a word on who chose that.
    pub fn subdivision(&self) -> (Subdivision, String) {
        if let Some(edge) = self.patch_size {
            return (Subdivision::Edge(edge), format!("--patch-size {edge}"));
        }
        if let Some(patches) = self.patches {
            return (Subdivision::Count(patches as usize), format!("--patches {patches}"));
        }
        let name = self.named().to_possible_value().map_or(String::new(), |v| v.get_name().to_owned());
        let patches = self.quality().patches;
        (Subdivision::Count(patches), format!("about {patches} for quality {name}"))
    }

    /// Rays a patch.
    pub fn rays(&self) -> u32 {
        self.rays.unwrap_or(self.quality().rays)
    }

    /// How to cut the scene, where that was said.
    pub fn given_subdivision(&self) -> Option<Subdivision> {
        let said = self.quality.is_some() || self.patch_size.is_some() || self.patches.is_some();
        said.then(|| self.subdivision().0)
    }

    /// Rays a patch, where that was said.
    pub fn given_rays(&self) -> Option<u32> {
        (self.quality.is_some() || self.rays.is_some()).then(|| self.rays())
    }

    /// The first of these options that was given: for commands that solve only sometimes.
    pub fn given(&self) -> Option<&'static str> {
        [
            (self.quality.is_some(), "--quality"),
            (self.patch_size.is_some(), "--patch-size"),
            (self.patches.is_some(), "--patches"),
            (self.rays.is_some(), "--rays"),
        ]
        .into_iter()
        .find_map(|(given, name)| given.then_some(name))
    }
}

pub fn positive(text: &str) -> Result<f64, String> {
    parse(text, |x| x > 0.0, "a length above 0, or inf, is wanted")
}

pub fn below_one(text: &str) -> Result<f64, String> {
    parse(text, |x| x > 0.0 && x < 1.0, "a number between 0 and 1 is wanted")
}

pub fn stops(text: &str) -> Result<f64, String> {
    parse(text, |x| x.abs() <= 100.0, "a number between -100 and 100 is wanted")
}

/// A radiance whose inverse is finite too.
pub fn white(text: &str) -> Result<f64, String> {
    parse(text, |x| (1e-100..=1e100).contains(&x), "a radiance above 0 is wanted")
}

/// `x,y,z`.
pub fn point(text: &str) -> Result<DVec3, String> {
    let numbers: Option<Vec<f64>> =
        text.split(',').map(|word| word.trim().parse().ok().filter(|x: &f64| x.is_finite())).collect();
    match numbers.as_deref() {
        Some(&[x, y, z]) => Ok(DVec3::new(x, y, z)),
        _ => Err("three numbers x,y,z without blanks are wanted".into()),
    }
}

fn parse(text: &str, good: impl Fn(f64) -> bool, wanted: &str) -> Result<f64, String> {
    text.parse().ok().filter(|&x| good(x)).ok_or_else(|| wanted.into())
}
