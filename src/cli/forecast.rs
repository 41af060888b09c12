//! What a computation will need, before it starts.

use radiosity::{Error, Result};

const GIB: f64 = (1u64 << 30) as f64;
/// Patches are numbered with 31 bits.
const MOST_PATCHES: f64 = (1u64 << 31) as f64;

/// Bytes that the rays' hits and the matrix of so many patches take.
///
/// Were the hits spread evenly, a row of the matrix would have n (1 - exp(-2 r / n)) entries, of its own r rays and those
/// that other patches send it; in a real scene they crowd together and it has fewer. An upper estimate, then, but
/// for backs, which only the rays find.
pub fn bytes(patches: f64, rays: f64) -> f64 {
    let entries = patches * (-(-2.0 * rays / patches).exp_m1());
    // Values and columns, hits, and about 20 numbers a patch.
    patches * (8.0 * entries + 4.0 * rays + 160.0)
}

/// Refuses what cannot be held; returns a warning when it is much.
pub fn check(patches: f64, rays: f64) -> Result<Option<String>> {
    let bytes = bytes(patches, rays);
    let fewer = || Some("choose a larger --patch-size, fewer --patches or fewer --rays".into());
    if patches >= MOST_PATCHES {
        let message = format!("{patches:.3e} patches are more than the program can number");
        return Err(Error::Usage { message, hint: fewer() });
    }
    if let Some(memory) = memory().filter(|&memory| bytes > memory) {
        return Err(Error::Usage {
            message: format!(
                "{patches:.3e} patches with {rays} rays each need about {:.0} GiB of memory, this machine has {:.0}",
                bytes / GIB,
                memory / GIB
            ),
            hint: fewer(),
        });
    }
    Ok((bytes > GIB).then(|| {
        format!(
            "the form factors of {patches:.0} patches will take about {:.1} GiB of memory, up to twice that while they \
             are made",
            bytes / GIB
        )
    }))
}

/// The most rays a patch that memory can hold for so many patches.
pub fn most_rays(patches: f64) -> f64 {
    let Some(memory) = memory() else { return f64::INFINITY };
    let (mut few, mut many) = (0.0, memory);
    for _ in 0..60 {
        let middle = 0.5 * (few + many);
        if bytes(patches, middle) > memory { many = middle } else { few = middle }
    }
    few
}

/// Refuses a picture that memory cannot hold.
pub fn check_picture(pixels: f64, by_particles: bool) -> Result<()> {
    // The film, what automatic exposure sorts, the encoded picture; by particles a sum for each thread and an estimate
    // a pixel too.
    let threads = rayon::current_num_threads() as f64;
    let bytes = pixels * if by_particles { 200.0 + 24.0 * threads } else { 60.0 };
    match memory().filter(|&memory| bytes > memory) {
        None => Ok(()),
        Some(memory) => Err(Error::Usage {
            message: format!(
                "a picture of {pixels:.2e} pixels needs about {:.0} GiB of memory, this machine has {:.0}",
                bytes / GIB,
                memory / GIB
            ),
            hint: Some("give a smaller --width and --height".into()),
        }),
    }
}

/// Refuses a lightmap that memory cannot hold.
pub fn check_map(texels: f64) -> Result<()> {
    // Pieces of surface, two signals with their errors before and after denoising, the image and what files need.
    let bytes = texels * 300.0;
    match memory().filter(|&memory| bytes > memory) {
        None => Ok(()),
        Some(memory) => Err(Error::Usage {
            message: format!(
                "a map of {texels:.2e} texels needs about {:.0} GiB of memory, this machine has {:.0}",
                bytes / GIB,
                memory / GIB
            ),
            hint: Some("give a longer --texel or a smaller --resolution".into()),
        }),
    }
}

/// Memory and swap space of this machine, as Linux tells.
fn memory() -> Option<f64> {
    let info = std::fs::read_to_string("/proc/meminfo").ok()?;
    let kibibytes = |name: &str| -> Option<f64> {
        let line = info.lines().find_map(|line| line.strip_prefix(name))?;
        line.trim().strip_suffix("kB")?.trim().parse().ok()
    };
    Some(1024.0 * (kibibytes("MemTotal:")? + kibibytes("SwapTotal:").unwrap_or(0.0)))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_forecast_grows_to_a_full_matrix_and_no_further() {
        let full = |n: f64, rays: f64| (bytes(n, rays) - n * (4.0 * rays + 160.0)) / (8.0 * n * n);
        assert!((full(100.0, 1e6) - 1.0).abs() < 1e-12);
        // Few rays: two entries a ray.
        assert!((full(1e8, 10.0) - 20.0 / 1e8).abs() < 1e-13);
    }

    #[test]
    fn much_memory_is_told_and_too_much_is_refused() {
        assert!(check(8_000.0, 64.0).unwrap().is_none());
        let message = check(1e9, 1e6).unwrap_err().to_string();
        assert!(message.contains("GiB of memory"), "{message}");
        assert!(check(3e9, 64.0).is_err());
    }
}
