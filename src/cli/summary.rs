//! The summary on stdout.

use std::fmt::Write;

use radiosity::{
    lightmap::report::{BakeReport, MapMaterialReport},
    output::{
        report::{ErrorReport, RegionReport, Seconds, SolveReport},
        sampling_report::{PictureReport, SamplingReport, SamplingSeconds},
    },
    patch::Patches,
};

/// The options that reduce an error, given the options in use.
pub struct Advice {
    pub sampling: &'static str,
    pub patches: &'static str,
}

/// The main figures of a solution.
pub fn table(
    report: &SolveReport,
    patches: &Patches,
    chosen: &str,
    advice: Advice,
    stops: f64,
    written: &str,
) -> String {
    let SolveReport { scene, form_factors: factors, solve, energy, seconds, .. } = report;
    let units = &scene.units;
    let mut text = String::new();
    let mut row = |name: &str, value: String| row(&mut text, name, &value);
    row("scene", format!("{}: {}", scene.file, count(scene.triangles, "triangle")));
    let edge = scene.patch_edge.map_or("of any size".into(), |edge| format!("edges up to {edge:.4}"));
    row(
        "patches",
        format!(
            "{} ({} front + {} back), {edge}; {chosen}",
            scene.patches,
            patches.fronts(),
            scene.back_patches
        ),
    );
    let mean = factors.rays as f64 / scene.patches as f64;
    let escaped = 100.0 * factors.escaped_fraction;
    row("rays", format!("{} ({mean:.0} per patch), {escaped:.2} % escaped", factors.rays));
    // Without a matrix, casting and solving are one.
    let casting = seconds.form_factors + if solve.residual.is_none() { seconds.solve } else { 0.0 };
    let (bytes, rate) = (memory(factors.bytes as f64), factors.rays as f64 / casting.max(1e-6));
    match solve.residual {
        Some(residual) => {
            let estimator = report.options.estimator;
            let non_zeros = factors.non_zeros;
            row("form factors", format!("{non_zeros} non-zeros, {bytes}, {estimator}, {rate:.2e} rays/s"));
            let bound = solve
                .error_bound
                .map_or("no error bound".into(), |b| format!("error below {b:.1e} {}", units.radiosity));
            row(
                "solver",
                format!(
                    "{}, {}, residual {residual:.1e}, {bound}",
                    solve.solver,
                    count(solve.iterations, "iteration")
                ),
            );
        }
        None => {
            row("form factors", format!("not stored, {rate:.2e} rays/s"));
            row("solver", format!("{}, {} without a matrix", solve.solver, count(solve.iterations, "sweep")));
        }
    }
    let channels =
        if scene.channels == 1 { vec![("", 0)] } else { vec![(" red", 0), (" green", 1), (" blue", 2)] };
    let power = units.power;
    for (name, c) in channels {
        let (emitted, absorbed, escaped) = (energy.emitted[c], energy.absorbed[c], energy.escaped[c]);
        let error = energy.entered_standard_error.map_or(0.0, |error| error[c]);
        let entered = match (energy.entered[c], error) {
            (0.0, _) => String::new(),
            (entered, 0.0) => format!(" entered {} {power},", figure(entered, 6)),
            (entered, error) => format!(" entered {} ± {} {power},", figure(entered, 6), figure(error, 2)),
        };
        row(
            &format!("power{name}"),
            format!(
                "emitted {} {power},{} absorbed {} {power}, escaped {} {power}",
                figure(emitted, 6),
                entered,
                figure(absorbed, 6),
                figure(escaped, 6)
            ),
        );
    }
    let parts = match (energy.sampled_imbalance, energy.sampled_imbalance_error) {
        (Some(sampled), Some(error)) => format!("{sampled:+.1e} as sampled, standard error {error:.1e}"),
        _ => format!("solver {}, reciprocity {}", small(energy.solver_part), small(energy.reciprocity_part)),
    };
    row("imbalance", format!("{} of the power of all lights: {parts}", small(Some(energy.imbalance))));
    let ErrorReport { rms_relative, bias_relative, discretisation_relative, solver_relative, .. } =
        report.error;
    let percent = |x: Option<f64>| x.map_or("unknown".into(), |x| format!("{:.2} %", rounded(100.0 * x, 2)));
    row(
        "error",
        format!(
            "sampling {} (RMS; bias {}), discretisation {}, solver {}; estimates relative to the mean irradiance",
            percent(rms_relative),
            percent(bias_relative),
            percent(discretisation_relative),
            solver_relative.map_or("unknown".into(), |x| format!("{x:.0e}")),
        ),
    );
    if let Some(RegionReport { region, rms_relative }) = &report.error.largest_region {
        let error = percent(Some(*rms_relative));
        row("by region", format!("sampling {error} at most, relative to its own mean: {region}"));
    }
    // If one error is unknown, the largest is unknown too.
    if let (Some(sampling), Some(size), Some(left)) = (rms_relative, discretisation_relative, solver_relative)
    {
        let parts = [
            (sampling, format!("sampling: {} reduces it", advice.sampling)),
            (size, format!("discretisation: {} reduces it", advice.patches)),
            (left, "solver: a lower --tolerance reduces it".into()),
        ];
        let largest = parts.into_iter().max_by(|a, b| a.0.total_cmp(&b.0));
        largest.into_iter().for_each(|(_, what)| row("largest error", what));
    }
    row(
        "exposure",
        format!(
            "white is {} {} (automatic {stops:+} stops)",
            figure(report.options.white, 4),
            units.radiosity
        ),
    );
    row("seconds", times(seconds));
    row("wrote", written.into());
    text
}

fn times(s: &Seconds) -> String {
    format!(
        "load {:.2}, subdivide {:.2}, bvh {:.2}, form factors {:.2}, solve {:.2}, output {:.2}; total {:.2}",
        s.load, s.subdivide, s.bvh, s.form_factors, s.solve, s.output, s.total
    )
}

/// The figures of a picture.
pub fn picture(report: &SamplingReport, fixed: bool, stops: f64, written: &str) -> String {
    let mut text = sampled(report, "per pixel");
    if let Some(picture) = &report.picture {
        let [eye, look_at, up] =
            [picture.eye, picture.look_at, picture.up].map(|p| p.map(|x| format!("{x:.6}")).join(","));
        let PictureReport { width, height, fov, white, .. } = picture;
        let ([r, g, b], unit) = (picture.mean_radiance, report.units.radiance);
        row(
            &mut text,
            "camera",
            &format!("{width} x {height}, --eye {eye} --look-at {look_at} --up {up} --fov {fov}"),
        );
        row(&mut text, "radiance", &format!("mean {} {unit}", [r, g, b].map(|x| figure(x, 4)).join(" ")));
        let chosen = if fixed { "--white" } else { "automatic" };
        row(&mut text, "exposure", &format!("white is {white:.4e} {unit} ({chosen} {stops:+} stops)"));
    }
    finish(text, report, written)
}

/// The figures of probes.
pub fn probes(report: &SamplingReport, written: &str) -> String {
    let mut text = sampled(report, "per point");
    if let Some(probes) = &report.probes {
        let [r, g, b] = probes.mean_irradiance;
        let error = 100.0 * probes.rms_relative;
        row(
            &mut text,
            "irradiance",
            &format!(
                "{}, mean {} {}",
                count(probes.points, "point"),
                [r, g, b].map(|x| figure(x, 4)).join(" "),
                report.units.irradiance
            ),
        );
        row(&mut text, "error", &format!("{error:.3} % RMS standard error"));
    }
    finish(text, report, written)
}

/// Largest number of materials in a line.
const MOST_MATERIALS: usize = 6;

/// The figures of a lightmap.
pub fn bake(report: &BakeReport, directory: &str) -> String {
    let BakeReport { scene, atlas, texels, flux, seams, seconds, options, .. } = report;
    let mut text = String::new();
    let mut row = |name: &str, value: String| row(&mut text, name, &value);
    row(
        "scene",
        format!("{}: {}, {} patches", scene.file, count(scene.triangles, "triangle"), scene.patches),
    );
    let whose = match &atlas.refused {
        None => "texture coordinates of the file".to_owned(),
        Some(why) => format!("new texture coordinates (not those of the file: {why})"),
    };
    row(
        "map",
        format!(
            "{} of {} x {}, texels of {:.4}, {}, {whose}",
            count(atlas.pages, "page"),
            atlas.width,
            atlas.height,
            atlas.texel_length,
            count(atlas.charts, "chart")
        ),
    );
    row(
        "texels",
        format!(
            "{} of surface, {} hidden, {} filled from neighbours, {} empty; {:.1} % used",
            texels.valid,
            texels.hidden,
            texels.dilated,
            texels.empty,
            100.0 * atlas.used_share
        ),
    );
    if atlas.cut_triangles > 0 {
        row("cut", format!("{} into smaller ones, to fit", count(atlas.cut_triangles, "triangle")));
    }
    let shares = |what: &str, share: &dyn Fn(&MapMaterialReport) -> f64| {
        let shown = report.materials.iter().map(|m| (share(m), m)).filter(|(share, _)| *share >= 5e-4);
        let listed: Vec<String> =
            shown.map(|(share, m)| format!("{:.1} % of {}", 100.0 * share, m.name)).collect();
        let rest = listed.len().saturating_sub(MOST_MATERIALS);
        let more = if rest > 0 { format!(" and of {rest} more") } else { String::new() };
        let named = &listed[..listed.len() - rest];
        (!named.is_empty()).then(|| format!("{what}: {}{more}", named.join(", ")))
    };
    let of_area = |part: f64, m: &MapMaterialReport| if m.area > 0.0 { part / m.area } else { 0.0 };
    let sides = [
        shares("shown by the back, which has more light", &|m| of_area(m.by_back, m)),
        shares("shown by both sides", &|m| of_area(m.by_both, m)),
    ];
    sides.into_iter().flatten().for_each(|text| row("sides", text));
    if let Some(text) = shares("inside solids, with values of neighbours", &|m| m.hidden_share) {
        row("hidden", text);
    }
    let relative = |e: f64| 100.0 * e / flux.solver.iter().sum::<f64>().max(f64::MIN_POSITIVE);
    let sampling = relative(flux.standard_error.iter().sum());
    row(
        "flux",
        format!(
            "differs by {:+.4} % from the solution, standard error {sampling:.4} %",
            rounded(100.0 * flux.relative_difference, 4)
        ),
    );
    if let Some(error) = report.rms_relative {
        let rays = options.map.final_gather;
        row("error", format!("{:.2} % RMS per texel, with {rays} rays of the final gather", 100.0 * error));
    }
    for step in &report.steps {
        row(step.name, format!("changed the flux by {:+.4} %", rounded(100.0 * step.relative, 4)));
    }
    if seams.samples > 0 {
        let largest = |x: [f64; 3]| x.into_iter().fold(0.0, f64::max);
        let (before, after) = (largest(seams.before), largest(seams.after));
        let (before, after, unit) = (figure(before, 3), figure(after, 3), report.scene.units.irradiance);
        row("across seams", format!("{before} {unit} before, {after} after (RMS)"));
    }
    let s = &seconds.stages;
    row(
        "seconds",
        format!(
            "load {:.2}, atlas {:.2}, solution {:.2}, texels {:.2}, output {:.2}; total {:.2}",
            s.load,
            seconds.atlas,
            s.subdivide + s.form_factors + s.solve,
            seconds.texels,
            s.output,
            s.total
        ),
    );
    row(
        "wrote",
        match &report.files[..] {
            [glb, others @ ..] if glb.ends_with(".glb") => {
                format!("{directory}; beside it {}", others.join(", "))
            }
            files => format!("{} files and report.json to {directory}", files.len()),
        },
    );
    text
}

pub fn row(text: &mut String, name: &str, value: &str) {
    let _ = writeln!(text, "{name:<13} {value}");
}

fn sampled(report: &SamplingReport, each: &str) -> String {
    let mut text = String::new();
    row(&mut text, "scene", &format!("{}: {}", report.scene, count(report.triangles, "triangle")));
    let mut method = format!("{}, {} {each}", report.method, count(report.samples as usize, "sample"));
    if let Some(patches) = report.patches {
        let _ = write!(method, ", {patches} patches");
    }
    if let Some(rays) = report.final_gather {
        let _ = write!(method, ", final gather of {rays} rays per sample");
    }
    row(&mut text, "method", &method);
    text
}

fn finish(mut text: String, report: &SamplingReport, written: &str) -> String {
    let SamplingSeconds { stages, sampling } = &report.seconds;
    let solution = stages.subdivide + stages.form_factors + stages.solve;
    let seconds = format!(
        "load {:.2}, bvh {:.2}, solution {solution:.2}, sampling {sampling:.2}, output {:.2}; total {:.2}",
        stages.load, stages.bvh, stages.output, stages.total
    );
    row(&mut text, "seconds", &seconds);
    row(&mut text, "wrote", written);
    text
}

/// A figure with two digits and its order of magnitude.
pub fn small(x: Option<f64>) -> String {
    x.map_or("unknown".into(), |x| figure(x, 1))
}

/// A figure with a number of decimals and its power of ten. Zero is plain `0`.
pub fn figure(x: f64, decimals: usize) -> String {
    if x == 0.0 { "0".into() } else { format!("{x:.decimals$e}") }
}

/// Rounds to a number of decimals. A value that is shown as zero has no sign.
pub fn rounded(x: f64, decimals: i32) -> f64 {
    let unit = 10f64.powi(decimals);
    (x * unit).round() / unit + 0.0
}

/// A number and its noun, in singular or plural.
pub fn count(n: usize, what: &str) -> String {
    format!("{n} {what}{}", if n == 1 { "" } else { "s" })
}

/// A number of bytes with a unit.
pub fn memory(bytes: f64) -> String {
    let units = ["bytes", "KiB", "MiB", "GiB", "TiB"];
    let mut unit = 0;
    let mut value = bytes;
    while value >= 1024.0 && unit + 1 < units.len() {
        value /= 1024.0;
        unit += 1;
    }
    if unit == 0 { format!("{value} {}", units[0]) } else { format!("{value:.1} {}", units[unit]) }
}

#[cfg(test)]
mod tests {
    #[test]
    fn memory_is_shown_in_a_fitting_unit() {
        assert_eq!(super::memory(1000.0), "1000 bytes");
        assert_eq!(super::memory(1536.0), "1.5 KiB");
        assert_eq!(super::memory(3.0 * 1024f64.powi(3)), "3.0 GiB");
    }

    #[test]
    fn zero_has_no_sign_and_one_no_plural() {
        let shown = |x| format!("{:+.2}", super::rounded(x, 2));
        assert_eq!([shown(-0.001), shown(-0.0), shown(-0.006)], ["+0.00", "+0.00", "-0.01"]);
        assert_eq!([super::small(Some(-0.0)), super::figure(1.25e-3, 2)], ["0", "1.25e-3"]);
        assert_eq!([0, 1, 2].map(|n| super::count(n, "page")), ["0 pages", "1 page", "2 pages"]);
    }
}
