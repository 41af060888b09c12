//! Options that several commands share.

use std::collections::HashSet;
use std::path::{Path, PathBuf};

use clap::{Args, ValueEnum};
use glam::DVec3;
use radiosity::{
    Error, Quality, Result as RadiosityResult, Scene,
    monte_carlo::reflection::SpecularPart,
    patch::Subdivision,
    scene::{LoadOptions, MOST_RADIANCE, is_radiance},
};

use super::{lights::LightArgs, models};

/// The scene, with options that add light and colour to it.
#[derive(Args)]
pub struct SceneArgs {
    /// The scene: Wavefront .obj with its .mtl beside it, .gltf, .glb, .ply or .stl
    #[arg(value_name = "SCENE")]
    pub path: PathBuf,
    /// Set the reflectance of a material, for example 0.6@wall or 0.6,0.5,0.4@wall. Without @, it applies to surfaces
    /// without a reflectance in the file [default: 0.5] and to surfaces that have only vertex or face colours. May be
    /// repeated
    #[arg(long, value_name = "R[,G,B][@MATERIAL]", allow_hyphen_values = true, value_parser = reflectance)]
    reflectance: Vec<Reflectance>,
    /// Let a material emit this radiance in W/(m2 sr), for example 10@lamp or 9,8,5@lamp. Without @, all materials
    /// emit. The name of a material in a .ply is its colour, for example 10@#ffcc00. May be repeated
    #[arg(long, value_name = "L[,M,N][@MATERIAL]", allow_hyphen_values = true, value_parser = emission)]
    emit: Vec<Emission>,
    /// Let unlit materials of a glTF file emit their colour. Otherwise the colour is their reflectance
    #[arg(long)]
    unlit_emits: bool,
    /// Leave out all faces of a material, for example window panes. May be repeated
    #[arg(long, value_name = "MATERIAL")]
    ignore: Vec<String>,
    /// Give a material a specular part in addition to its Kd, for example floor=ward:0.2,0.1,0.1. The models are
    /// mirror:KS, phong:KS,N, blinn-phong:KS,N, ward:KS,AX,AY, beckmann:KS,ALPHA, ggx:KS,ALPHA, schlick:KS,ALPHA,
    /// conductor:ETA,KAPPA,ALPHA and metallic-roughness:METALLIC,ROUGHNESS. May be repeated
    #[arg(long, value_name = "MATERIAL=MODEL", value_parser = models::model)]
    model: Vec<models::Model>,
    /// Treatment of specular parts where surfaces count as Lambertian: everywhere except in path and light tracing
    #[arg(long, value_enum, default_value_t = SpecularName::Diffuse)]
    specular: SpecularName,
    /// Let only these materials and lights emit. The results of separate lamps sum to the result of all lamps. The
    /// lights of --sun and --sky have the names sun and sky
    #[arg(long, value_name = "NAME,...", value_delimiter = ',')]
    emitters: Vec<String>,
    #[command(flatten)]
    pub lights: LightArgs,
}

#[derive(Clone, Copy, ValueEnum)]
enum SpecularName {
    /// Add the share of diffuse light that they reflect to the diffuse reflectance
    Diffuse,
    /// Leave them out
    Drop,
}

/// A reflectance, and the material that has it.
#[derive(Debug, Clone, PartialEq)]
struct Reflectance {
    share: [f64; 3],
    material: Option<String>,
}

/// A radiance, and the material that emits it.
#[derive(Debug, Clone, PartialEq)]
struct Emission {
    radiance: [f64; 3],
    material: Option<String>,
}

impl SceneArgs {
    /// The treatment of specular parts where surfaces count as Lambertian.
    pub fn specular(&self) -> SpecularPart {
        match self.specular {
            SpecularName::Drop => SpecularPart::Drop,
            SpecularName::Diffuse => SpecularPart::Diffuse,
        }
    }

    /// Reads the scene and applies the options. Does not cut triangles where surfaces touch or cross.
    pub fn load(&self) -> RadiosityResult<Scene> {
        let units = self.lights.units()?;
        let plain = self.reflectance.iter().rev().find(|r| r.material.is_none()).map(|r| r.share);
        let mut scene = Scene::load_with(
            &self.path,
            &LoadOptions::default()
                .with_reflectance(plain)
                .with_unlit_emits(self.unlit_emits)
                .with_faces(true)
                .with_keep_overlaps(true)
                .with_units(units),
        )?;
        ignore(&mut scene, &self.path, &self.ignore)?;
        for Reflectance { share, material } in &self.reflectance {
            if let Some(name) = material
                && scene.reflect(name, *share) == 0
            {
                return Err(self.no_material(&scene, "--reflectance", name));
            }
        }
        for Emission { radiance, material } in &self.emit {
            if scene.emit(material.as_deref(), *radiance) == 0 {
                return Err(self.no_material(&scene, "--emit", material.as_deref().unwrap_or_default()));
            }
        }
        for model in &self.model {
            if model.apply(&mut scene) == 0 {
                return Err(self.no_material(&scene, "--model", &model.material));
            }
        }
        scene.units = units;
        self.lights.add(&mut scene, Some(&self.path))?;
        self.keep_emitters(&mut scene)?;
        scene.cut_overlaps();
        Ok(scene)
    }

    fn no_material(&self, scene: &Scene, option: &str, name: &str) -> Error {
        no_material(scene, &self.path, option, name)
    }

    /// Lets only the materials of `--emitters` emit, if there are any.
    fn keep_emitters(&self, scene: &mut Scene) -> RadiosityResult<()> {
        if self.emitters.is_empty() {
            return Ok(());
        }
        let shining = scene.materials.iter().filter(|m| m.emits()).map(|m| m.name.clone());
        let names: Vec<String> = shining.chain(scene.lights.names().map(String::from)).collect();
        if let Some(name) = self.emitters.iter().find(|name| !names.contains(name)) {
            let names = distinct(&names);
            return Err(Error::Usage {
                message: format!(
                    "--emitters: no material or light `{name}` of {} emits",
                    self.path.display()
                ),
                hint: Some(format!("the emitters are {}", names[..names.len().min(10)].join(", "))),
            });
        }
        keep_emitters(scene, &self.emitters);
        Ok(())
    }
}

/// Lets only materials and lights of these names emit.
pub fn keep_emitters(scene: &mut Scene, names: &[String]) {
    let kept = |name: &str| names.iter().any(|kept| kept == name);
    scene.lights.retain(kept);
    for material in scene.materials.iter_mut().filter(|m| !kept(&m.name)) {
        material.emission = [0.0; 3];
        material.emission_map = None;
    }
}

/// The distinct names, in their order.
fn distinct<S: AsRef<str>>(names: &[S]) -> Vec<&str> {
    let mut known = HashSet::new();
    names.iter().map(AsRef::as_ref).filter(|name| known.insert(*name)).collect()
}

/// The error for an option that names a material without faces.
fn no_material(scene: &Scene, path: &Path, option: &str, name: &str) -> Error {
    let names: Vec<&str> = scene.materials.iter().map(|m| m.name.as_str()).collect();
    let names = distinct(&names);
    let (shown, more) = (names.len().min(10), names.len().saturating_sub(10));
    let rest = if more > 0 { format!(" and {more} more") } else { String::new() };
    Error::Usage {
        message: format!("{option}: no face of {} has material `{name}`", path.display()),
        hint: Some(format!("its materials are {}{rest}", names[..shown].join(", "))),
    }
}

/// Leaves out the faces of materials of these names.
pub fn ignore(scene: &mut Scene, path: &Path, materials: &[String]) -> RadiosityResult<()> {
    for name in materials {
        // If a name is given twice, its material has no faces the second time.
        if !scene.materials.iter().any(|m| m.name == *name) {
            return Err(no_material(scene, path, "--ignore", name));
        }
        scene.leave_out(name);
    }
    if scene.triangles.is_empty() {
        return Err(Error::input(path, None, "no face is left: all have materials that --ignore leaves out"));
    }
    Ok(())
}

/// The indices of materials with these names. `option` is the option that names them, for messages.
pub fn materials(scene: &Scene, path: &Path, option: &str, names: &[String]) -> RadiosityResult<Vec<u32>> {
    let index = |name: &String| {
        let found = scene.materials.iter().position(|m| m.name == *name);
        found.map(|k| k as u32).ok_or_else(|| no_material(scene, path, option, name))
    };
    names.iter().map(index).collect()
}

/// The number of patches and rays: options of every command that solves for radiosity.
#[derive(Args)]
pub struct CastArgs {
    /// Preset of the numbers of patches and rays [default: medium]
    #[arg(long, value_enum)]
    quality: Option<QualityName>,
    /// Largest edge of a patch, in the unit of the scene. `inf` makes each triangle one patch of constant light
    #[arg(long, value_name = "LENGTH", value_parser = positive)]
    patch_size: Option<f64>,
    /// Approximate number of patches. There is at least one per triangle
    #[arg(long, value_name = "N", conflicts_with = "patch_size", value_parser = clap::value_parser!(u32).range(1..))]
    patches: Option<u32>,
    /// Mean number of rays per patch, hemisphere and shadow rays together. At least 16 are hemisphere rays
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u32).range(1..))]
    rays: Option<u32>,
    /// Let light be constant on each patch, instead of linear. Linear light leaves a sixth to three quarters
    /// of the discretisation error of constant light
    #[arg(long)]
    constant_light: bool,
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
    /// Whether light is linear over each patch. With `--patch-size inf`, the triangles of the file are the cells of the
    /// computation, as in the published solutions of such meshes.
    pub fn linear(&self) -> bool {
        !self.constant_light && self.patch_size != Some(f64::INFINITY)
    }

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

    /// The subdivision into patches, and the origin of this choice in words.
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

    /// A warning if the scene has more triangles than the requested number of patches. Each triangle is at least one
    /// patch.
    pub fn too_few(&self, scene: &Scene) -> Option<String> {
        let triangles = scene.triangles.len();
        match self.subdivision().0 {
            Subdivision::Count(patches) if triangles > patches => Some(format!(
                "the scene has {triangles} triangles, more than the {patches} patches asked for: each triangle is at least one patch"
            )),
            _ => None,
        }
    }

    /// Rays per patch.
    pub fn rays(&self) -> u32 {
        self.rays.unwrap_or(self.quality().rays)
    }

    /// The subdivision into patches, if an option sets it.
    pub fn given_subdivision(&self) -> Option<Subdivision> {
        self.given_patches().map(|_| self.subdivision().0)
    }

    /// Rays per patch, if an option sets them.
    pub fn given_rays(&self) -> Option<u32> {
        (self.quality.is_some() || self.rays.is_some()).then(|| self.rays())
    }

    /// The option that determines the patches, if one was given.
    pub fn given_patches(&self) -> Option<&'static str> {
        self.given().filter(|&option| option != "--rays")
    }

    /// The first of these options that was given. Some commands use them with some of their methods only.
    pub fn given(&self) -> Option<&'static str> {
        [
            (self.patch_size.is_some(), "--patch-size"),
            (self.patches.is_some(), "--patches"),
            (self.quality.is_some(), "--quality"),
            (self.rays.is_some(), "--rays"),
        ]
        .into_iter()
        .find_map(|(given, name)| given.then_some(name))
    }
}

pub fn positive(text: &str) -> Result<f64, String> {
    parse(text, |x| x > 0.0, "expected a length above 0, or inf")
}

pub fn finite_length(text: &str) -> Result<f64, String> {
    parse(text, |x| x > 0.0 && x.is_finite(), "expected a finite length above 0")
}

pub fn below_one(text: &str) -> Result<f64, String> {
    parse(text, |x| x > 0.0 && x < 1.0, "expected a number between 0 and 1")
}

pub fn percent(text: &str) -> Result<f64, String> {
    parse(text, |x| x > 0.0 && x <= 100.0, "expected a percentage above 0 and at most 100")
}

pub fn seconds_given(text: &str) -> Result<f64, String> {
    parse(text, |x| x > 0.0 && x.is_finite(), "expected a finite number of seconds above 0")
}

pub fn stops(text: &str) -> Result<f64, String> {
    parse(text, |x| x.abs() <= 100.0, "expected a number between -100 and 100")
}

/// A radiance with a finite inverse.
pub fn white(text: &str) -> Result<f64, String> {
    parse(text, |x| (1e-100..=1e100).contains(&x), "expected a radiance from 1e-100 to 1e100")
}

/// Three numbers, or one that counts for all three.
fn colour(text: &str) -> Option<[f64; 3]> {
    let numbers: Option<Vec<f64>> = text.split(',').map(|word| word.trim().parse().ok()).collect();
    match numbers.as_deref() {
        Some(&[grey]) => Some([grey; 3]),
        Some(&[r, g, b]) => Some([r, g, b]),
        _ => None,
    }
}

fn reflectance(text: &str) -> Result<Reflectance, String> {
    let (share, material) = match text.split_once('@') {
        Some((share, name)) => (share, Some(name.to_owned())),
        None => (text, None),
    };
    let good = |c: &[f64; 3]| c.iter().all(|r| (0.0..=1.0).contains(r));
    match colour(share).filter(good) {
        Some(share) => Ok(Reflectance { share, material }),
        None => Err(
            "expected one number or three (R,G,B) between 0 and 1, optionally followed by @ and the name of a material"
                .into(),
        ),
    }
}

fn emission(text: &str) -> Result<Emission, String> {
    let (radiance, material) = match text.split_once('@') {
        Some((radiance, name)) => (radiance, Some(name.to_owned())),
        None => (text, None),
    };
    let good = |c: &[f64; 3]| c.iter().all(|&l| is_radiance(l));
    match colour(radiance).filter(good) {
        Some(radiance) => Ok(Emission { radiance, material }),
        None => Err(format!(
            "expected one number or three from 0 to {MOST_RADIANCE:e}, optionally followed by @ and the name of a material"
        )),
    }
}

/// Reads `x,y,z`.
pub fn point(text: &str) -> Result<DVec3, String> {
    let numbers: Option<Vec<f64>> =
        text.split(',').map(|word| word.trim().parse().ok().filter(|x: &f64| x.is_finite())).collect();
    match numbers.as_deref() {
        Some(&[x, y, z]) => Ok(DVec3::new(x, y, z)),
        _ => Err("expected three numbers x,y,z without blanks".into()),
    }
}

pub fn parse(text: &str, good: impl Fn(f64) -> bool, wanted: &str) -> Result<f64, String> {
    text.parse().ok().filter(|&x| good(x)).ok_or_else(|| wanted.into())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn emission_is_a_radiance_and_an_optional_name() {
        let of = |radiance, name: Option<&str>| Ok(Emission { radiance, material: name.map(String::from) });
        assert_eq!(emission("10"), of([10.0; 3], None));
        assert_eq!(emission("1,0,2.5@my lamp@2"), of([1.0, 0.0, 2.5], Some("my lamp@2")));
        assert_eq!(emission("3@#ffcc00"), of([3.0; 3], Some("#ffcc00")));
        for wrong in
            ["", "@lamp", "1,2@lamp", "-1", "inf", "nan", "1e308", "1,1,1e101@lamp", "1,2,3,4", "lamp"]
        {
            assert!(emission(wrong).is_err(), "{wrong}");
        }
    }

    #[test]
    fn reflectance_is_a_share() {
        let of = |share, name: Option<&str>| Ok(Reflectance { share, material: name.map(String::from) });
        assert_eq!(reflectance("0.25"), of([0.25; 3], None));
        assert_eq!(reflectance("0,1, 0.5"), of([0.0, 1.0, 0.5], None));
        assert_eq!(reflectance("0.5@my wall"), of([0.5; 3], Some("my wall")));
        assert!(["1.1", "-0.1", "nan", "0.5,0.5", ""].iter().all(|wrong| reflectance(wrong).is_err()));
    }
}
