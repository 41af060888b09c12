//! Experiment.
use radiosity::{
    Progress, Scene,
    accuracy::{discretisation::Discretisation, error_bars::ErrorBars, solved::Solved},
    form_factor::{CastOptions, FormFactors},
    monte_carlo::{Effort, PathOptions, PathTracer, Region},
    output::{vertex_colors::at_vertices, vertices::PatchMesh},
    patch::{Patches, Subdivision},
    solve::{SolveOptions, solve},
    trace::Tracer,
};
use std::time::Instant;

fn truth(name: &str, scene: &Scene, tracer: &Tracer, common: &Patches) -> [Vec<f64>; 2] {
    let n = common.fronts();
    let c = common.channels();
    let cache = format!("/tmp/truth_{name}_{n}.txt");
    if let Ok(text) = std::fs::read_to_string(&cache) {
        let v: Vec<f64> = text.split_whitespace().map(|x| x.parse().unwrap()).collect();
        return [v[..n * c].to_vec(), v[n * c..].to_vec()];
    }
    let regions: Vec<Region> = (0..n)
        .map(|i| Region { triangle: common.triangle(i), part: common.corners(i), front: true })
        .collect();
    let start = Instant::now();
    let samples: u32 = std::env::var("PATHS").ok().map_or(8192, |x| x.parse().unwrap());
    let r = [1u64, 2].map(|seed| {
        let found = PathTracer::new(scene, tracer, PathOptions::default())
            .mean_irradiances(&regions, &Effort { samples, seed, ..Effort::default() }, &Progress::new())
            .unwrap();
        found.iter().flat_map(|e| e.mean.into_iter().take(c)).collect::<Vec<f64>>()
    });
    println!("truth took {:?}", start.elapsed());
    let text: Vec<String> = r.iter().flatten().map(|x| format!("{x:e}")).collect();
    std::fs::write(cache, text.join("\n")).unwrap();
    r
}

fn averaged(common: &Patches, fine: &Patches, values: &[f64]) -> Vec<f64> {
    let c = fine.channels();
    let mut sums = vec![0.0; common.fronts() * c];
    for j in 0..fine.fronts() {
        let (range, share) = fine.overlap(common, j);
        for i in range {
            for k in 0..c {
                sums[i * c + k] += share * values[j * c + k];
            }
        }
    }
    sums
}

/// Cross product RMS of (a - r1)(b - r2), relative.
fn rms(common: &Patches, a: &[f64], b: &[f64], r: &[Vec<f64>; 2]) -> f64 {
    let c = common.channels();
    let (mut s, mut m, mut w) = (0.0, 0.0, 0.0);
    for q in 0..a.len() {
        let area = common.area(q / c);
        s += area * 0.5 * ((a[q] - r[0][q]) * (b[q] - r[1][q]) + (a[q] - r[1][q]) * (b[q] - r[0][q]));
        m += area * 0.5 * (r[0][q] + r[1][q]);
        w += area;
    }
    let v = s * w / (m * m);
    v.signum() * v.abs().sqrt()
}

struct X<'a> {
    scene: &'a Scene,
    tracer: &'a Tracer,
    common: &'a Patches,
    truth: [Vec<f64>; 2],
}

impl X<'_> {
    fn solved(&self, patches: &Patches, rays: f64, seed: u64) -> Solved {
        let mut patches = patches.clone();
        let cast = CastOptions { rays, seed, ..CastOptions::default() };
        let form_factors =
            FormFactors::cast(self.scene, self.tracer, &mut patches, &cast, &Progress::new()).unwrap();
        let solution = solve(&form_factors, &patches, &SolveOptions::default(), &Progress::new()).unwrap();
        let error_bars = ErrorBars::of(&form_factors, &patches, &solution).unwrap();
        Solved { patches, form_factors, solution, error_bars }
    }
    /// floor of these patches, and error of one at these rays
    fn floor(&self, label: &str, patches: &Patches, rays: f64) -> f64 {
        let start = Instant::now();
        let s = [11, 12].map(|seed| self.solved(patches, rays, seed));
        let took = 0.5 * start.elapsed().as_secs_f64();
        let e = [0, 1].map(|k| averaged(self.common, &s[k].patches, &s[k].solution.irradiance));
        let floor = rms(self.common, &e[0], &e[1], &self.truth);
        let one = rms(self.common, &e[0], &e[0], &self.truth);
        let Solved { patches, form_factors, solution, .. } = &s[0];
        let d =
            Discretisation::of(form_factors, patches, solution, &SolveOptions::default(), &Progress::new())
                .unwrap();
        println!(
            "{label:24} {:6} patches {rays:5} rays: floor {:.3} %, one {:.3} %, told {:.3} %, {took:.2} s",
            patches.fronts(),
            100.0 * floor,
            100.0 * one,
            100.0 * d.map_or(0.0, |d| d.relative)
        );
        floor
    }
    fn indicator(&self, kind: &str, s: &Solved) -> Vec<f64> {
        let Solved { patches, form_factors, solution, error_bars } = s;
        let c = solution.channels;
        let n = patches.fronts();
        let e = if kind.ends_with('B') { &solution.radiosity } else { &solution.irradiance };
        match &kind[..1] {
            "A" => {
                let d = Discretisation::of(
                    form_factors,
                    patches,
                    solution,
                    &SolveOptions::default(),
                    &Progress::new(),
                )
                .unwrap()
                .unwrap();
                (0..n)
                    .map(|i| patches.area(i) * (0..c).map(|k| d.change[i * c + k].powi(2)).sum::<f64>())
                    .collect()
            }
            "V" => {
                let mut out = vec![0.0; n];
                for f in patches.families(1).take_while(|f| f.end <= n) {
                    let mut v = 0.0;
                    for k in 0..c {
                        let m = f.clone().map(|i| e[i * c + k]).sum::<f64>() / f.len() as f64;
                        v += f.clone().map(|i| (e[i * c + k] - m).powi(2)).sum::<f64>() / f.len() as f64;
                    }
                    for i in f {
                        out[i] = patches.area(i) * v;
                    }
                }
                out
            }
            "W" | "Y" => {
                let mut out = vec![0.0; n];
                for i in 0..n {
                    let c0 = patches.cell(i);
                    if c0.level == 0 {
                        continue;
                    }
                    let (pc, pl) = (c0.child >> 2, c0.level - 1);
                    let inside = |j: usize| {
                        let d = patches.cell(j);
                        d.triangle == c0.triangle && d.level > pl && d.child >> (2 * (d.level - pl)) == pc
                    };
                    let (mut a, mut b) = (i, i + 1);
                    while a > 0 && inside(a - 1) {
                        a -= 1
                    }
                    while b < n && inside(b) {
                        b += 1
                    }
                    let total: f64 = (a..b).map(|j| patches.area(j)).sum();
                    let mut v = 0.0;
                    for k in 0..c {
                        let m = (a..b).map(|j| patches.area(j) * e[j * c + k]).sum::<f64>() / total;
                        if &kind[..1] == "W" {
                            v += (a..b).map(|j| patches.area(j) * (e[j * c + k] - m).powi(2)).sum::<f64>()
                                / total;
                        } else {
                            // every child of the parent has one mean
                            let mut means = [0.0; 4];
                            let mut areas = [0.0; 4];
                            for j in a..b {
                                let d = patches.cell(j);
                                let q = (d.child >> (2 * (d.level - pl - 1))) as usize & 3;
                                areas[q] += patches.area(j);
                                means[q] += patches.area(j) * e[j * c + k];
                            }
                            v += (0..4).map(|q| (means[q] / areas[q] - m).powi(2)).sum::<f64>() / 4.0;
                        }
                    }
                    if std::env::var("NOISE").is_ok() {
                        let f: f64 = std::env::var("NOISE").unwrap().parse().unwrap();
                        let noise: f64 = (a..b)
                            .map(|j| {
                                patches.area(j) / total
                                    * (0..c)
                                        .map(|k| error_bars.standard_error[j * c + k].powi(2))
                                        .sum::<f64>()
                            })
                            .sum();
                        v = (v - f * noise).max(0.0);
                    }
                    let p: f64 = std::env::var("POWER").ok().map_or(1.0, |x| x.parse().unwrap());
                    out[i] = patches.area(i).powf(p) * v;
                }
                out
            }
            "G" => {
                let mesh = PatchMesh::new(self.scene, patches, 1.0);
                let v = at_vertices(self.scene, patches, &mesh, e);
                (0..n)
                    .map(|i| {
                        let mut sum = 0.0;
                        for k in 0..c {
                            let at = mesh.corners(i).map(|x| v[x as usize * c + k]);
                            let noise = error_bars.standard_error[i * c + k].powi(2);
                            let m = e[i * c + k];
                            sum += (at.iter().map(|x| (x - m).powi(2)).sum::<f64>() / 3.0 - noise).max(0.0);
                        }
                        // power of the area
                        let p: f64 = std::env::var("POWER").ok().map_or(1.0, |x| x.parse().unwrap());
                        patches.area(i).powf(p) * sum
                    })
                    .collect()
            }
            _ => panic!(),
        }
    }
    fn adapt(&self, kind: &str, base: usize, target: usize, rays: f64, growth: f64, floors: bool) -> Patches {
        let mut patches = Patches::subdivide(self.scene, &Subdivision::Count(base));
        let mut step = 0;
        while (patches.fronts() as f64) < target as f64 / growth.sqrt() {
            let s = self.solved(&patches, rays, 100 + step);
            step += 1;
            let eta = self.indicator(kind, &s);
            let mut order: Vec<usize> = (0..patches.fronts()).collect();
            order.sort_by(|&a, &b| eta[b].total_cmp(&eta[a]));
            let wanted = (patches.fronts() as f64 * growth).min(target as f64);
            let mut take = (wanted - patches.fronts() as f64) / 3.0;
            let mut next;
            // closure adds: bisect few
            let (mut lo, mut hi) = (0.0, take);
            loop {
                let mut marked = vec![false; patches.fronts()];
                order[..take as usize].iter().for_each(|&i| marked[i] = true);
                next = patches.refined(self.scene, &marked);
                let n = next.fronts() as f64;
                if n > 1.05 * wanted {
                    hi = take
                } else if n < 0.95 * wanted {
                    lo = take
                } else {
                    break;
                }
                if hi - lo < 2.0 {
                    break;
                }
                take = 0.5 * (lo + hi);
            }
            patches = next;
            if floors {
                self.floor(kind, &patches, 512.0);
            }
        }
        patches
    }
}

fn main() {
    let args: Vec<String> = std::env::args().collect();
    let name = &args[1];
    let scene = Scene::load(format!("meshes/{name}.obj")).unwrap();
    let tracer = Tracer::new(&scene);
    let common = Patches::subdivide(&scene, &Subdivision::Count(500));
    let truth = truth(name, &scene, &tracer, &common);
    println!(
        "{name}: {} common, noise of truth {:.3} %",
        common.fronts(),
        100.0 * rms(&common, &truth[0], &truth[0], &[truth[1].clone(), truth[1].clone()]) / 2f64.sqrt()
    );
    let x = X { scene: &scene, tracer: &tracer, common: &common, truth };
    for kind in &args[2..] {
        let (kind, rest) = kind.split_once(':').unwrap();
        let v: Vec<f64> = rest.split(',').map(|x| x.parse().unwrap()).collect();
        if kind == "U" {
            x.floor("uniform", &Patches::subdivide(&scene, &Subdivision::Count(v[0] as usize)), v[1]);
        } else {
            // base, target, rays, growth
            x.adapt(kind, v[0] as usize, v[1] as usize, v[2], v[3], true);
        }
    }
}
