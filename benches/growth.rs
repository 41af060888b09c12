//! How time and memory grow from a thousand patches to a million. Prints a Markdown table and draws
//! `docs/images/growth.svg`.
//!
//!     cargo bench --bench growth -- [MOST_PATCHES [SCENE.obj | spheres | walls]]
//!
//! `spheres` and `walls` have a million triangles with one patch each, and do not draw the picture.
//!
//! The peak memory of a process never falls, so each size runs in its own process: this program, started again.

mod scenes;

use std::{error::Error, fmt::Write, path::PathBuf, process::Command, time::Instant};

use radiosity::{
    Progress, Scene,
    accuracy::{bias, discretisation::Discretisation, error_bars::ErrorBars},
    energy::EnergyLedger,
    form_factor::{CastOptions, FormFactors},
    output::{
        ply::{self, PlyOptions},
        report::peak_bytes,
    },
    patch::{Patches, Subdivision},
    solve::{SolveOptions, solve},
    trace::Tracer,
};

const RAYS: f64 = 64.0;
/// This environment variable gives a new process its number of patches.
const TASK: &str = "RADIOSITY_GROWTH_PATCHES";
const STAGES: [&str; 7] =
    ["casting", "form factors", "solving", "error bars", "patch size", "bias", "writing"];

/// The results of one size: patches, seconds of each stage, peak in bytes.
struct Run {
    patches: f64,
    seconds: Vec<f64>,
    peak: f64,
}

impl Run {
    fn total(&self) -> f64 {
        self.seconds.iter().sum()
    }
}

fn main() -> Result<(), Box<dyn Error>> {
    let mut args = std::env::args().skip(1).filter(|word| word != "--bench");
    let most: usize = args.next().map_or(Ok(1_000_000), |n| n.parse())?;
    let here = PathBuf::from(env!("CARGO_MANIFEST_DIR"));
    let named = args.next();
    let scene = named.clone().unwrap_or_else(|| here.join("meshes/cornell-box.obj").display().to_string());
    if let Ok(patches) = std::env::var(TASK) {
        let scene = match scene.as_str() {
            "spheres" => (scenes::SPHERES_1E6.make)(),
            "walls" => (scenes::WALLS_1E6.make)(),
            file => Scene::load(file)?,
        };
        return run(&scene, patches.parse()?);
    }
    println!("| patches | {} | all | all / casting | peak MiB | bytes per pair |", STAGES.join(" | "));
    println!("|---|{}---|---|---|---|", "---|".repeat(STAGES.len()));
    let mut runs: Vec<Run> = Vec::new();
    for count in
        [1_000, 3_000, 10_000, 30_000, 100_000, 300_000, 1_000_000].into_iter().filter(|&n| n <= most)
    {
        let mut again = Command::new(std::env::current_exe()?);
        let out = again.args([most.to_string()]).arg(&scene).env(TASK, count.to_string()).output()?;
        let text = String::from_utf8(out.stdout)?;
        let numbers: Vec<f64> = text.split_whitespace().map(str::parse).collect::<Result<_, _>>()?;
        let [patches, seconds @ .., peak, pair] = &numbers[..] else {
            return Err(format!("{count} patches: {}", String::from_utf8_lossy(&out.stderr)).into());
        };
        // There are never fewer patches than triangles.
        if runs.last().is_some_and(|last| last.patches == *patches) {
            continue;
        }
        let run = Run { patches: *patches, seconds: seconds.to_vec(), peak: *peak };
        let stages: Vec<String> = run.seconds.iter().map(|s| format!("{s:.3}")).collect();
        let ratio = run.total() / run.seconds[0];
        println!(
            "| {patches:.0} | {} | {:.3} | {ratio:.2} | {:.1} | {pair:.2} |",
            stages.join(" | "),
            run.total(),
            peak / f64::from(1 << 20)
        );
        runs.push(run);
    }
    if let [first, .., last] = &runs[..] {
        let exponent = |value: &dyn Fn(&Run) -> f64| {
            (value(last) / value(first)).ln() / (last.patches / first.patches).ln()
        };
        println!(
            "\nexponents from first to last: casting {:.2}, time {:.2}, memory {:.2}",
            exponent(&|r| r.seconds[0]),
            exponent(&Run::total),
            exponent(&|r| r.peak)
        );
        if named.is_none() {
            std::fs::write(here.join("docs/images/growth.svg"), svg(&runs))?;
        }
    }
    Ok(())
}

fn run(scene: &Scene, count: usize) -> Result<(), Box<dyn Error>> {
    let (progress, options) = (Progress::new(), SolveOptions::default());
    let tracer = Tracer::new(scene);
    let mut patches = Patches::subdivide(scene, &Subdivision::Count(count));
    let mut seconds = Vec::new();
    let mut start = Instant::now();
    let mut lap = |seconds: &mut Vec<f64>| {
        seconds.push(start.elapsed().as_secs_f64());
        start = Instant::now();
    };
    let cast = CastOptions::default().with_rays(RAYS);
    let form_factors = FormFactors::cast(scene, &tracer, &mut patches, &cast, &progress)?;
    lap(&mut seconds);
    let casting = form_factors.ray_set().map_or(0.0, |hits| hits.seconds());
    seconds.insert(0, casting);
    seconds[1] -= casting;
    let solution = solve(&form_factors, &patches, &options, &progress)?;
    lap(&mut seconds);
    let error_bars = ErrorBars::of(&form_factors, &patches, &solution).ok_or("no error bars")?;
    lap(&mut seconds);
    Discretisation::of((scene, &tracer), &form_factors, &patches, &solution, &progress)?;
    lap(&mut seconds);
    bias::relative(&form_factors, &tracer, &patches, &solution, &options, &progress)?;
    lap(&mut seconds);
    let ledger = EnergyLedger::of(&form_factors, &patches, &solution);
    assert!(ledger.imbalance().abs() < 1e-9);
    let options = PlyOptions::default().with_standard_errors(Some(&error_bars.standard_error));
    ply::encode(&mut std::io::sink(), scene, &patches, &solution, &options)?;
    lap(&mut seconds);
    let pair = form_factors.matrix_bytes() as f64 / (0.5 * form_factors.non_zeros() as f64);
    let peak = peak_bytes().ok_or("this system does not report the peak memory")?;
    print!("{}", patches.len());
    seconds.iter().for_each(|s| print!(" {s}"));
    println!(" {peak} {pair}");
    Ok(())
}

/// Draws seconds and memory over patches, on logarithmic axes.
fn svg(runs: &[Run]) -> String {
    let mut body = String::new();
    let casting = (runs.iter().map(|r| (r.patches, r.seconds[0])).collect(), "#e69f00", "casting alone");
    let all = (runs.iter().map(|r| (r.patches, r.total())).collect(), "#0072b2", "all");
    let peak = runs.iter().map(|r| (r.patches, r.peak / f64::from(1 << 20))).collect::<Vec<(f64, f64)>>();
    panel(&mut body, 70.0, "seconds", &[casting, all]);
    panel(&mut body, 540.0, "peak, MiB", &[(peak, "#0072b2", "process")]);
    format!(
        "<svg xmlns=\"http://www.w3.org/2000/svg\" viewBox=\"0 0 1000 430\" width=\"1000\" height=\"430\" \
         font-family=\"Helvetica, Arial, sans-serif\" font-size=\"12\" fill=\"#222222\" role=\"img\">\n\
         <title>Growth with patches</title>\n<rect width=\"1000\" height=\"430\" fill=\"white\"/>\n\
         <text x=\"20\" y=\"28\" font-size=\"18\">Time and memory of a solution with {RAYS} rays a patch</text>\n\
         <text x=\"20\" y=\"48\">Dashed: in proportion to the patches</text>\n{body}</svg>\n"
    )
}

type Line<'a> = (Vec<(f64, f64)>, &'a str, &'a str);

fn panel(out: &mut String, left: f64, label: &str, lines: &[Line]) {
    const SIZE: (f64, f64) = (400.0, 300.0);
    const BOTTOM: f64 = 380.0;
    let points = || lines.iter().flat_map(|line| &line.0);
    let decades = |value: fn(&(f64, f64)) -> f64| {
        let logs = || points().map(value).map(f64::log10);
        (logs().fold(f64::INFINITY, f64::min).floor(), logs().fold(-f64::INFINITY, f64::max).ceil())
    };
    let ((x0, x1), (y0, y1)) = (decades(|p| p.0), decades(|p| p.1));
    let x = |value: f64| left + SIZE.0 * (value.log10() - x0) / (x1 - x0);
    let y = |value: f64| BOTTOM - SIZE.1 * (value.log10() - y0) / (y1 - y0);
    let (top, right) = (BOTTOM - SIZE.1, left + SIZE.0);
    let mut put = |text: String| writeln!(out, "{text}").expect("strings hold all");
    let rule = |x1: f64, y1: f64, x2: f64, y2: f64| {
        format!("<line x1=\"{x1:.1}\" y1=\"{y1:.1}\" x2=\"{x2:.1}\" y2=\"{y2:.1}\" stroke=\"#cccccc\"/>")
    };
    for decade in x0 as i32..=x1 as i32 {
        let at = x(10f64.powi(decade));
        put(rule(at, BOTTOM, at, top));
        put(format!(
            "<text x=\"{at:.1}\" y=\"{:.1}\" text-anchor=\"middle\">{}</text>",
            BOTTOM + 18.0,
            plain(decade)
        ));
    }
    for decade in y0 as i32..=y1 as i32 {
        let at = y(10f64.powi(decade));
        put(rule(left, at, right, at));
        put(format!(
            "<text x=\"{:.1}\" y=\"{:.1}\" text-anchor=\"end\">{}</text>",
            left - 6.0,
            at + 4.0,
            plain(decade)
        ));
    }
    put(format!(
        "<text x=\"{:.1}\" y=\"{:.1}\" text-anchor=\"middle\">patches</text>",
        left + 0.5 * SIZE.0,
        BOTTOM + 38.0
    ));
    put(format!("<text x=\"{left:.1}\" y=\"{:.1}\" font-weight=\"bold\">{label}</text>", top - 8.0));
    for (points, colour, name) in lines {
        let first = points[0];
        let (end, _) = points[points.len() - 1];
        let along =
            format!("{:.1},{:.1} {:.1},{:.1}", x(first.0), y(first.1), x(end), y(first.1 * end / first.0));
        put(format!(
            "<polyline points=\"{along}\" fill=\"none\" stroke=\"{colour}\" stroke-dasharray=\"4 4\"/>"
        ));
        let path: Vec<String> = points.iter().map(|p| format!("{:.1},{:.1}", x(p.0), y(p.1))).collect();
        put(format!(
            "<polyline points=\"{}\" fill=\"none\" stroke=\"{colour}\" stroke-width=\"2\"/>",
            path.join(" ")
        ));
        for p in points {
            put(format!("<circle cx=\"{:.1}\" cy=\"{:.1}\" r=\"3.5\" fill=\"{colour}\"/>", x(p.0), y(p.1)));
        }
        let p = points[points.len() / 2];
        put(format!(
            "<text x=\"{:.1}\" y=\"{:.1}\" fill=\"{colour}\" text-anchor=\"end\">{name}</text>",
            x(p.0) - 8.0,
            y(p.1) - 8.0
        ));
    }
}

/// A power of ten as a plain number.
fn plain(decade: i32) -> String {
    if decade < 0 { format!("{}", 1.0 / 10f64.powi(-decade)) } else { format!("{}", 10f64.powi(decade)) }
}
