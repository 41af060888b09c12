//! Compares the discretisation error with its estimate, for constant and for linear light. The reference is a solution
//! with patches of a quarter of the edge, or path tracing. Products of the errors of different seeds against two
//! references have no sampling noise in the mean. Prints a Markdown table.
//!
//!     cargo bench --bench discretisation -- [PART OF A SCENE'S NAME | SCENE.obj | --patches N | --by-size | --paths] ...
//!
//! With `--by-size`, it also compares the estimates of single patches. The patches are sorted by their estimate and
//! divided into three groups of equal area. The table has the true and the estimated RMS error of each group.

#[path = "calibration/scenes.rs"]
mod scenes;

use radiosity::{
    Progress, Result, Scene,
    accuracy::{
        discretisation::Discretisation,
        solved::Solved,
        validation::{ValidationOptions, averaged, path_traced},
    },
    form_factor::CastOptions,
    patch::{Patches, Subdivision},
    solve::SolveOptions,
    trace::Tracer,
};

const SEEDS: u64 = 4;
const RAYS: f64 = 512.0;
/// Rays per patch in each reference of smaller patches, and paths per patch in each reference by path tracing.
const REFERENCE_RAYS: f64 = 512.0;
const PATHS: u32 = 16_384;
const GROUPS: usize = 3;

fn main() -> Result<()> {
    let mut words: Vec<String> = std::env::args().skip(1).filter(|word| word != "--bench").collect();
    let by_size = words.iter().any(|word| word == "--by-size");
    let paths = words.iter().any(|word| word == "--paths");
    words.retain(|word| word != "--by-size" && word != "--paths");
    let mut counts = Vec::new();
    while let Some(k) = words.iter().position(|word| word == "--patches") {
        counts.extend(words.get(k + 1).and_then(|number| number.parse::<usize>().ok()));
        words.drain(k..(k + 2).min(words.len()));
    }
    if counts.is_empty() {
        counts = vec![1000, 4000];
    }
    let (files, names): (Vec<String>, Vec<String>) =
        words.into_iter().partition(|word| word.ends_with(".obj"));
    let mut chosen = Vec::new();
    if files.is_empty() {
        chosen = scenes::all()?;
        chosen.push(("a sealed room over the ground".into(), scenes::sealed_room()));
        chosen.retain(|(name, _)| names.is_empty() || names.iter().any(|part| name.contains(&**part)));
        for (_, scene) in &mut chosen {
            scene.cut_overlaps();
            scene.cut_contacts();
        }
    }
    for path in files {
        chosen.push((path.clone(), Scene::load(&path)?));
    }
    println!(
        "| scene | patches | constant | estimated | ratio | linear | estimated | ratio | linear / constant |"
    );
    println!("|---|---|---|---|---|---|---|---|---|");
    for (name, scene) in chosen {
        for &count in &counts {
            Lab::new(&scene, count, paths)?.row(&name, by_size)?;
        }
    }
    Ok(())
}

struct Lab<'a> {
    scene: &'a Scene,
    tracer: Tracer,
    patches: Patches,
    truths: [Vec<f64>; 2],
}

/// Light of several seeds, and the root mean square over the seeds of the estimated error of each value.
struct Found {
    light: Vec<Vec<f64>>,
    estimated: Vec<f64>,
    relative: f64,
}

impl<'a> Lab<'a> {
    fn new(scene: &'a Scene, count: usize, paths: bool) -> Result<Self> {
        let tracer = Tracer::new(scene);
        let patches = Patches::subdivide(scene, &Subdivision::Count(count));
        let truth = |seed| {
            if paths {
                let options = ValidationOptions::default().with_paths(PATHS).with_seed(seed);
                return path_traced(scene, &tracer, &patches, &options, &Progress::new())
                    .map(|found| found.irradiance);
            }
            let fine = patches.quartered(scene).quartered(scene);
            let cast = CastOptions::default().with_rays(REFERENCE_RAYS).with_seed(seed);
            let options = SolveOptions::default().with_linear(true);
            let found = Solved::of_patches(scene, &tracer, fine, &cast, &options, &Progress::new())?;
            Ok(averaged(&patches, &found.patches, &found.solution.irradiance))
        };
        let truths = [truth(101)?, truth(102)?];
        Ok(Lab { scene, tracer, patches, truths })
    }

    fn found(&self, linear: bool) -> Result<Found> {
        let values = self.patches.fronts() * self.patches.channels();
        let mut found = Found { light: Vec::new(), estimated: vec![0.0; values], relative: 0.0 };
        for seed in 0..SEEDS {
            let cast = CastOptions::default().with_rays(RAYS).with_seed(seed);
            let options = SolveOptions::default().with_linear(linear);
            let (patches, progress) = (self.patches.clone(), Progress::new());
            let solved = Solved::of_patches(self.scene, &self.tracer, patches, &cast, &options, &progress)?;
            let Solved { patches, form_factors, solution, .. } = solved;
            let estimate = Discretisation::of(
                (self.scene, &self.tracer),
                &form_factors,
                &patches,
                &solution,
                &progress,
            )?;
            if let Some(estimate) = estimate {
                let squares = found.estimated.iter_mut().zip(&estimate.error);
                squares.for_each(|(sum, e)| *sum += e * e / SEEDS as f64);
                found.relative += estimate.relative.powi(2) / SEEDS as f64;
            }
            found.light.push(solution.irradiance[..values].to_vec());
        }
        found.estimated.iter_mut().for_each(|x| *x = x.sqrt());
        found.relative = found.relative.sqrt();
        Ok(found)
    }

    fn area(&self, q: usize) -> f64 {
        self.patches.area(q / self.patches.channels())
    }

    /// The area-weighted mean over some values.
    fn mean(&self, of: &[usize], value: impl Fn(usize) -> f64) -> f64 {
        let sum: f64 = of.iter().map(|&q| self.area(q) * value(q)).sum();
        sum / of.iter().map(|&q| self.area(q)).sum::<f64>()
    }

    /// The true RMS error over some values, in units of the mean irradiance of all.
    fn error(&self, of: &[usize], light: &[Vec<f64>], unit: f64) -> f64 {
        let (mut sum, mut pairs) = (0.0, 0.0);
        for a in 0..light.len() {
            for b in (0..light.len()).filter(|&b| b != a) {
                let [first, second] = &self.truths;
                sum += self.mean(of, |q| (light[a][q] - first[q]) * (light[b][q] - second[q]));
                pairs += 1.0;
            }
        }
        (sum / pairs).max(0.0).sqrt() / unit
    }

    fn row(&self, name: &str, by_size: bool) -> Result<()> {
        let all: Vec<usize> = (0..self.truths[0].len()).collect();
        let unit = self.mean(&all, |q| 0.5 * (self.truths[0][q] + self.truths[1][q]));
        let found = [self.found(false)?, self.found(true)?];
        let [constant, linear] = [0, 1].map(|k| self.error(&all, &found[k].light, unit));
        print!("| {name} | {}", self.patches.fronts());
        for (found, actual) in found.iter().zip([constant, linear]) {
            let (actual, estimated) = (100.0 * actual, 100.0 * found.relative);
            print!(" | {actual:.3} % | {estimated:.3} % | {:.2}", estimated / actual);
        }
        println!(" | {:.2} |", linear / constant);
        for (name, found) in ["constant", "linear"].iter().zip(&found).filter(|_| by_size) {
            let mut sorted = all.clone();
            sorted.sort_by(|&p, &q| found.estimated[p].total_cmp(&found.estimated[q]));
            let whole: f64 = sorted.iter().map(|&q| self.area(q)).sum();
            let (mut groups, mut sum) = (vec![Vec::new(); GROUPS], 0.0);
            for q in sorted {
                groups[((sum / whole * GROUPS as f64) as usize).min(GROUPS - 1)].push(q);
                sum += self.area(q);
            }
            for group in groups {
                let actual = 100.0 * self.error(&group, &found.light, unit);
                let estimated = 100.0 * self.mean(&group, |q| found.estimated[q].powi(2)).sqrt() / unit;
                println!(
                    "  {name}: {} values, error {actual:.3} %, estimated {estimated:.3} %, ratio {:.2}",
                    group.len(),
                    estimated / actual
                );
            }
        }
        Ok(())
    }
}
