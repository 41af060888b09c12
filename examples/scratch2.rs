use radiosity::*;
use radiosity::{form_factor::*, patch::*, solve::*, trace::*};
fn main() {
    for f in [
        "meshes/cornell-box.obj",
        "meshes/door-ajar.obj",
        "meshes/furnace.obj",
        "meshes/textured.obj",
        "/work/shared/truth/cornell.obj",
    ] {
        let scene = Scene::load(f).unwrap();
        let tracer = Tracer::new(&scene);
        let sub = Subdivision::Count(1000);
        let run = |rays: f64, seed: u64| {
            let mut p = Patches::subdivide(&scene, &sub);
            let ff = FormFactors::cast(
                &scene,
                &tracer,
                &mut p,
                &CastOptions { rays, seed, ..Default::default() },
                &Progress::new(),
            )
            .unwrap();
            let t = std::time::Instant::now();
            let s = solve(&ff, &p, &SolveOptions::default(), &Progress::new()).unwrap();
            let t1 = t.elapsed();
            let e = radiosity::accuracy::error_bars::ErrorBars::of(&ff, &p, &s).unwrap().standard_error;
            (p, s, e, t1, t.elapsed() - t1)
        };
        let (rp, rs, _, _, _) = run(8192., 77);
        let n = rp.fronts();
        let c = rs.channels;
        for rays in [64., 256., 1024.] {
            let (mut inside, mut all, mut chi, mut act, mut est, mut m) = (0, 0, 0., 0., 0., 0.);
            let mut unk = 0;
            let mut te = Default::default();
            for seed in 0..6 {
                let (p, s, e, _, t2) = run(rays, seed);
                te = t2;
                unk = p.len();
                for i in 0..n {
                    for k in 0..c {
                        let q = i * c + k;
                        let d = s.irradiance[q] - rs.irradiance[q];
                        let a = p.area(i);
                        act += a * d * d;
                        est += a * e[q] * e[q];
                        m += a * rs.irradiance[q];
                        if e[q] > 0. {
                            all += 1;
                            let z = d / e[q];
                            chi += z * z;
                            if z.abs() < 2.131 {
                                inside += 1
                            }
                        } else if d.abs() > 1e-12 * rs.irradiance[q] {
                            all += 1;
                        }
                    }
                }
            }
            let norm = (0..n).map(|i| rp.area(i)).sum::<f64>() * c as f64 * 6.;
            println!(
                "{f} {n}/{unk} rays {rays}: inside {:.3} chi2 {:.2} actual {:.2}% est {:.2}%  errbar time {te:?}",
                inside as f64 / all as f64,
                chi / all as f64,
                100. * (act / norm).sqrt() / (m / norm),
                100. * (est / norm).sqrt() / (m / norm)
            );
        }
    }
}
