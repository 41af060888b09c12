use glam::DVec3;
use radiosity::*;
use radiosity::{form_factor::*, patch::*, scene::*, solve::*, trace::*};
use std::collections::HashMap;
fn load(p: &str) -> Scene {
    let mtl = std::fs::read_to_string(format!("{p}.mtl")).unwrap();
    let obj = std::fs::read_to_string(format!("{p}.obj")).unwrap();
    let mut mats: Vec<Material> = vec![];
    let mut names = HashMap::new();
    let f = |w: &[&str]| {
        let v: Vec<f64> = w[1..4].iter().map(|x| x.parse().unwrap()).collect();
        [v[0], v[1], v[2]]
    };
    for l in mtl.lines() {
        let w: Vec<&str> = l.split_whitespace().collect();
        if w.is_empty() {
            continue;
        }
        match w[0] {
            "newmtl" => {
                names.insert(w[1].to_string(), mats.len() as u32);
                mats.push(Material::new(w[1], [0.5; 3], [0.0; 3]))
            }
            "Kd" => mats.last_mut().unwrap().reflectance = f(&w),
            "Ke" => mats.last_mut().unwrap().emission = f(&w),
            _ => {}
        }
    }
    let mut v = vec![];
    let mut t = vec![];
    let mut m = 0;
    for l in obj.lines() {
        let w: Vec<&str> = l.split_whitespace().collect();
        if w.is_empty() {
            continue;
        }
        match w[0] {
            "v" => {
                let a = f(&w);
                v.push(DVec3::from_array(a))
            }
            "usemtl" => m = names[w[1]],
            "f" => {
                let i: Vec<usize> = w[1..]
                    .iter()
                    .map(|x| x.split('/').next().unwrap().parse::<usize>().unwrap() - 1)
                    .collect();
                for k in 1..i.len() - 1 {
                    t.push(([v[i[0]], v[i[k]], v[i[k + 1]]], m))
                }
            }
            _ => {}
        }
    }
    Scene::new(&t, mats)
}
fn truth(p: &str) -> Vec<[f64; 3]> {
    let j: serde_json::Value =
        serde_json::from_str(&std::fs::read_to_string(format!("{p}.json")).unwrap()).unwrap();
    let arr = j["patches"].as_array().expect("patches");
    arr.iter()
        .map(|x| {
            let e = &x["irradiance"];
            [e[0].as_f64().unwrap(), e[1].as_f64().unwrap(), e[2].as_f64().unwrap()]
        })
        .collect()
}
// area weighted RMS relative to mean, over channels
fn rms(e: &[f64], r: &[f64], a: &[f64], c: usize, n: usize) -> f64 {
    let (mut s, mut m, mut w) = (0., 0., 0.);
    for i in 0..n {
        for k in 0..c {
            let d = e[i * c + k] - r[i * c + k];
            s += a[i] * d * d;
            m += a[i] * r[i * c + k];
            w += a[i];
        }
    }
    (s / w).sqrt() / (m / w)
}
fn main() {
    let p = "/work/shared/truth/cornell";
    let scene = load(p);
    let tracer = Tracer::new(&scene);
    let tr = truth(p);
    let opt = SolveOptions::default();
    for n in [960, 3840] {
        let sub = if n == 960 { Subdivision::Edge(f64::INFINITY) } else { Subdivision::Count(n) };
        let run = |rays: f64, seed: u64| {
            let sh: f64 = std::env::var("SH").map_or(0.5, |x| x.parse().unwrap());
            let by = std::env::var("EQ").is_err();
            let sh = if seed == 99 { 0.5 } else { sh };
            let mut patches = Patches::subdivide(&scene, &sub);
            let s = std::time::Instant::now();
            let ff = FormFactors::cast(
                &scene,
                &tracer,
                &mut patches,
                &CastOptions { rays, seed, shadow_share: sh, by_area: by, ..Default::default() },
                &Progress::new(),
            )
            .unwrap();
            let t = s.elapsed().as_secs_f64();
            let sol = solve(&ff, &patches, &opt, &Progress::new()).unwrap();
            (patches, ff, sol, t)
        };
        let (rp, _, rs, _) = run(16384.0, 99);
        let nf = rp.fronts();
        let areas: Vec<f64> = (0..nf).map(|i| rp.area(i)).collect();
        // aggregate to quads
        let agg = |e: &[f64], pt: &Patches| {
            let nq = tr.len();
            let mut s = vec![0.0; nq * 3];
            let mut w = vec![0.0; nq];
            for i in 0..pt.fronts() {
                let q = scene.triangles[pt.triangle(i)].source as usize / 2;
                w[q] += pt.area(i);
                for k in 0..3 {
                    s[q * 3 + k] += pt.area(i) * e[i * 3 + k];
                }
            }
            for q in 0..nq {
                for k in 0..3 {
                    s[q * 3 + k] /= w[q];
                }
            }
            (s, w)
        };
        let tf: Vec<f64> = tr.iter().flatten().copied().collect();
        let (q, w) = agg(&rs.irradiance, &rp);
        {
            let (pt, _, s, _) = run(256.0, 5);
            worst(&s.irradiance, &rs.irradiance, &areas, &scene, &pt);
        }
        println!(
            "{} fronts, {} unknowns: floor vs truth {:.2}%",
            nf,
            rp.len(),
            100. * rms(&q, &tf, &w, 3, tr.len())
        );
        for rays in [64., 256., 1024.] {
            let mut a = 0.;
            let mut b = 0.;
            let mut tt = 0.;
            let k = 4;
            for seed in 0..k {
                let (pt, _, s, t) = run(rays, seed);
                assert_eq!(pt.len(), rp.len());
                a += rms(&s.irradiance, &rs.irradiance, &areas, 3, nf).powi(2);
                let (q, w) = agg(&s.irradiance, &pt);
                b += rms(&q, &tf, &w, 3, tr.len()).powi(2);
                tt += t;
            }
            println!(
                "  {rays} rays: vs converged {:.2}% vs truth {:.2}%  {:.3}s",
                100. * (a / k as f64).sqrt(),
                100. * (b / k as f64).sqrt(),
                tt / k as f64
            );
        }
    }
}
pub fn worst(e: &[f64], r: &[f64], a: &[f64], scene: &Scene, pt: &Patches) {
    let mut v: Vec<(f64, usize)> = (0..a.len())
        .map(|i| ((0..3).map(|k| a[i] * (e[i * 3 + k] - r[i * 3 + k]).powi(2)).sum(), i))
        .collect();
    let tot: f64 = v.iter().map(|x| x.0).sum();
    v.sort_by(|x, y| y.0.total_cmp(&x.0));
    for (s, i) in v.iter().take(12) {
        let t = pt.triangle(*i);
        println!(
            "   share {:.3} area {:.1} E {:.3} ref {:.3} mat {} c {:?}",
            s / tot,
            a[*i],
            e[i * 3],
            r[i * 3],
            scene.material(t).name,
            (scene.corners(t)[0] + scene.corners(t)[1] + scene.corners(t)[2]) / 3.0
        );
    }
}
