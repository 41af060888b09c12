//! The forecast of the memory of a computation, and its limit.

use radiosity::{
    Error, Ranks, Result, Scene,
    accuracy::{
        memory::{self, Memory},
        survey::Survey,
    },
    form_factor::Estimator,
    patch::{Patches, Subdivision},
    solve::Solver,
    trace::Tracer,
};

use super::summary;

/// Patches are numbered with 31 bits.
const MOST_PATCHES: f64 = (1u64 << 31) as f64;
/// More bytes than this cause a warning.
const MUCH: f64 = (1u64 << 30) as f64;

/// Bytes that a computation may take.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Limit {
    bytes: f64,
    /// Whether `--memory` was given. Otherwise the limit is the memory of the machine.
    given: bool,
}

/// A computation, described by its number of patches and its mean number of rays per patch.
pub struct Work<'a> {
    pub scene: &'a Scene,
    pub patches: f64,
    pub rays: f64,
    /// Bytes for given numbers of patches and rays.
    pub bytes: &'a dyn Fn(f64, f64) -> f64,
    /// The options that set these numbers.
    pub options: [&'static str; 2],
}

/// Rays that estimate the area of visible backs.
const LOOKING: u64 = 10_000;

/// The number of all patches relative to the number of fronts. Rays will find backs, which need patches too.
pub fn with_backs(scene: &Scene, tracer: &Tracer, seed: u64) -> f64 {
    1.0 + Survey::of(scene, tracer, LOOKING, seed).back_area
}

/// The options that set the numbers of patches and rays in most commands.
pub const USUAL: [&str; 2] = ["--patches", "--rays"];

/// Bytes for one solution, on each rank. The number of patches includes backs.
pub fn bytes(scene: &Scene, estimator: Estimator, solver: Solver) -> impl Fn(f64, f64) -> f64 {
    move |patches, rays| {
        Memory::of(scene, patches, rays, estimator, solver).among(Ranks::world().count()).peak()
    }
}

/// Additional bytes for linear light, if it is wanted. The number of patches includes backs.
pub fn of_linear_light(scene: &Scene, wanted: bool) -> impl Fn(f64) -> f64 {
    move |patches| if wanted { memory::of_linear_light(scene, patches) } else { 0.0 }
}

impl Limit {
    /// The given limit, or else the share of a rank in the memory of this machine. There is no limit if both are
    /// unknown.
    pub fn new(given: Option<f64>) -> Limit {
        let bytes = given
            .or_else(|| Some(memory::of_machine()? / Ranks::world().on_this_machine() as f64))
            .unwrap_or(f64::INFINITY);
        Limit { bytes, given: given.is_some() }
    }

    /// The reason for refusing this number of bytes, if it is too large.
    fn objection(self, bytes: f64) -> Option<String> {
        let owner = if self.given { "--memory allows" } else { "this machine has" };
        let [need, limit] = [bytes, self.bytes].map(summary::memory);
        (!(bytes <= self.bytes)).then(|| format!("about {need} of memory, {owner} {limit}"))
    }

    /// Whether this number of bytes is allowed.
    pub fn allows(self, bytes: f64) -> bool {
        self.objection(bytes).is_none()
    }

    /// Refuses work that needs too much memory, with a hint about numbers that would fit. Returns a warning if it needs
    /// much.
    pub fn check(self, work: &Work) -> Result<Option<String>> {
        let &Work { patches, rays, bytes, options: [many_patches, many_rays], .. } = work;
        if patches >= MOST_PATCHES {
            let message = format!("{patches:.3e} patches are more than the program can number");
            let hint = format!("choose a larger --patch-size or fewer {many_patches}");
            return Err(Error::Usage { message, hint: Some(hint) });
        }
        let need = bytes(patches, rays);
        if let Some(objection) = self.objection(need) {
            let mut ways = Vec::new();
            ways.extend(self.patches(work).map(|n| format!("{many_patches} {n}")));
            ways.extend(self.rays(work).map(|n| format!("{many_rays} {n}")));
            ways.push(match self.given {
                true => format!("--memory {}", exact(need)),
                false => "a machine with more".into(),
            });
            let cast = if rays > 0.0 { format!(" with {rays:.0} rays each") } else { String::new() };
            return Err(Error::Usage {
                message: format!("{} patches{cast} need {objection}", count(patches)),
                hint: Some(format!("use {}", ways.join(", or "))),
            });
        }
        let warning = || format!("this may take up to {} of memory", summary::memory(need));
        Ok((need > MUCH).then(warning))
    }

    /// A number of patches that fits with the same rays.
    fn patches(self, work: &Work) -> Option<u64> {
        let least = work.scene.triangles.len() as f64;
        let mut wanted = work.patches;
        loop {
            wanted = round_down(0.8 * wanted);
            if wanted < least {
                return None;
            }
            // The actual number of patches may be larger than the requested number.
            let made = Patches::forecast(work.scene, &Subdivision::Count(wanted as usize));
            if self.allows((work.bytes)(made.max(wanted), work.rays)) {
                return Some(wanted as u64);
            }
        }
    }

    /// A number of rays that fits with the same patches.
    fn rays(self, work: &Work) -> Option<u64> {
        let rays = round_down(self.most_rays(work.patches, work.bytes));
        (rays >= 16.0 && rays < work.rays).then_some(rays as u64)
    }

    /// The largest number of rays per patch that fits for a number of patches.
    pub fn most_rays(self, patches: f64, bytes: impl Fn(f64, f64) -> f64) -> f64 {
        memory::most_rays(self.bytes, |rays| bytes(patches, rays))
    }

    /// Refuses a picture that needs too much memory.
    pub fn check_picture(self, pixels: f64, by_particles: bool) -> Result<()> {
        // The film, the values that automatic exposure sorts, and the encoded picture. Light tracing adds a sum for
        // each thread and an estimate per pixel.
        let threads = rayon::current_num_threads() as f64;
        let a_pixel = if by_particles { 200.0 + 24.0 * threads } else { 60.0 };
        self.check_image("picture", "pixels", pixels, a_pixel, "a smaller --width and --height")
    }

    /// Refuses a lightmap that needs too much memory.
    pub fn check_map(self, texels: f64) -> Result<()> {
        // Pieces of surface, two signals with their errors before and after denoising, the image and the encoded files.
        self.check_image("map", "texels", texels, 300.0, "a longer --texel or a smaller --resolution")
    }

    /// Refuses view factors between a number of polygons if they need too much memory.
    pub fn check_polygons(self, polygons: usize) -> Result<()> {
        // Memory holds the polygons with their points. For each visible pair, it holds the pair while pairs are
        // collected, and then both view factors and their standard errors. In streets of 22,176 polygons, each polygon
        // sees 1,700 others.
        let count = polygons as f64;
        let need = 2e3 * count + 60.0 * count * (0.5 * count).min(1.5e3);
        match self.objection(need) {
            None => Ok(()),
            Some(objection) => Err(Error::Usage {
                message: format!("view factors between {polygons} polygons need {objection}"),
                hint: Some(format!("give a mesh of fewer faces, or --memory {}", exact(need))),
            }),
        }
    }

    fn check_image(self, what: &str, of: &str, count: f64, a_piece: f64, smaller: &str) -> Result<()> {
        match self.objection(count * a_piece) {
            None => Ok(()),
            Some(objection) => Err(Error::Usage {
                message: format!("a {what} of {} {of} needs {objection}", self::count(count)),
                hint: Some(format!("give {smaller}: {:.1e} {of} fit", round_down(self.bytes / a_piece))),
            }),
        }
    }
}

/// A number in a readable form.
fn count(x: f64) -> String {
    if x < 1e7 { format!("{x:.0}") } else { format!("{x:.2e}") }
}

/// Rounds down to two digits.
fn round_down(x: f64) -> f64 {
    let unit = 10f64.powf(x.max(1.0).log10().floor() - 1.0).max(1.0);
    (x / unit).floor() * unit
}

/// A size in the form of `--memory`, rounded up.
pub fn exact(bytes: f64) -> String {
    format!("{}MiB", (bytes / f64::from(1 << 20)).ceil())
}

/// Reads a number of bytes with or without a unit: B; kB, MB, GB, TB; KiB, MiB, GiB, TiB or K, M, G, T.
pub fn size(text: &str) -> std::result::Result<f64, String> {
    let text = text.trim();
    let digits = text.find(|c: char| c.is_ascii_alphabetic()).unwrap_or(text.len());
    // An exponent is not a unit.
    let (number, unit) = match text.parse::<f64>() {
        Ok(_) => (text, ""),
        Err(_) => text.split_at(digits),
    };
    let unit = unit.to_lowercase();
    let power =
        |base: f64, letter: u8| base.powi(1 + b"kmgt".iter().position(|&l| l == letter)? as i32).into();
    let factor: Option<f64> = match unit.as_bytes() {
        b"" | b"b" => Some(1.0),
        [letter] | [letter, b'i', b'b'] => power(1024.0, *letter),
        [letter, b'b'] => power(1000.0, *letter),
        _ => None,
    };
    let bytes = factor.and_then(|factor| Some(factor * number.trim().parse::<f64>().ok()?));
    bytes.filter(|b| b.is_finite() && *b >= 1.0).ok_or("expected a size like 500MB or 4GiB".into())
}

#[cfg(test)]
mod tests {
    use super::*;
    use glam::DVec3;
    use radiosity::scene::Material;

    fn triangle() -> Scene {
        let corners = [DVec3::ZERO, DVec3::X, DVec3::Y];
        Scene::new(&[(corners, 0)], vec![Material::new("m", [0.5; 3], [1.0; 3])])
    }

    #[test]
    fn sizes_are_read_with_their_units() {
        for (text, bytes) in [
            ("1000", 1e3),
            ("1e9", 1e9),
            ("500MB", 5e8),
            ("4GiB", 4.0 * 1024f64.powi(3)),
            ("1.5 g", 1.5 * 1024f64.powi(3)),
            ("2k", 2048.0),
            ("1TB", 1e12),
            ("7b", 7.0),
        ] {
            assert_eq!(size(text), Ok(bytes), "{text}");
        }
        for wrong in ["", "GB", "-1GB", "0", "nan", "inf", "1XB", "1GiBs", "1 2", "1e400", "1é"] {
            assert!(size(wrong).is_err(), "{wrong}");
        }
    }

    #[test]
    fn a_hint_gives_numbers_that_fit() {
        let scene = triangle();
        let bytes = bytes(&scene, Estimator::Pooled, Solver::Auto);
        for (memory, patches, rays) in [(1e8, 1e5, 64.0), (1e9, 4096.0, 1e6), (4e9, 1e7, 1e3)] {
            let limit = Limit { bytes: memory, given: true };
            let work = |patches, rays| Work { scene: &scene, patches, rays, bytes: &bytes, options: USUAL };
            let error = limit.check(&work(patches, rays)).unwrap_err();
            let hint = error.hint().unwrap();
            let value = |option: &str| -> Option<&str> {
                Some(hint.split_once(option)?.1.trim_start().split([',', ' ']).next().unwrap())
            };
            if let Some(n) = value("--patches") {
                let made = Patches::forecast(&scene, &Subdivision::Count(n.parse().unwrap()));
                assert!(limit.check(&work(made, rays)).is_ok(), "{hint}");
            }
            if let Some(n) = value("--rays") {
                assert!(limit.check(&work(patches, n.parse().unwrap())).is_ok(), "{hint}");
            }
            assert!(value("--patches").is_some() || value("--rays").is_some(), "{hint}");
            let more = Limit { bytes: size(value("--memory").unwrap()).unwrap(), given: true };
            assert!(more.check(&work(patches, rays)).is_ok(), "{hint}");
        }
    }

    #[test]
    fn much_memory_is_warned_of_and_too_much_is_refused() {
        let scene = triangle();
        let bytes = bytes(&scene, Estimator::Pooled, Solver::Auto);
        let work = |patches, rays| Work { scene: &scene, patches, rays, bytes: &bytes, options: USUAL };
        let limit = Limit { bytes: 16e9, given: false };
        assert!(limit.check(&work(8_000.0, 64.0)).unwrap().is_none());
        assert!(limit.check(&work(100_000.0, 512.0)).unwrap().is_some());
        let message = limit.check(&work(1e9, 1e6)).unwrap_err().to_string();
        assert!(message.contains("GiB of memory") || message.contains("TiB of memory"), "{message}");
        assert!(limit.check(&work(3e9, 64.0)).is_err());
        assert!(limit.check_picture(1e9, false).is_err() && limit.check_picture(1e6, true).is_ok());
        assert!(limit.check_map(1e9).is_err() && limit.check_map(1e6).is_ok());
    }
}
