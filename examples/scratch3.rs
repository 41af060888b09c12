use radiosity::accuracy::validation::*;
use radiosity::*;
fn main() {
    for f in std::env::args().skip(1) {
        let scene = Scene::load(&f).unwrap();
        for seed in 0..3 {
            let t = std::time::Instant::now();
            let v =
                Validation::of(&scene, &ValidationOptions { seed, ..Default::default() }, &Progress::new())
                    .unwrap();
            println!(
                "{f} {seed} disc {:.2}% {:?} objections {:?}",
                100. * v.discretisation_relative,
                t.elapsed(),
                v.objections()
            );
            for (n, c) in v.comparisons() {
                println!(
                    "   {n}: rms {:.2}% mean {:.3}% z {:.1}  zmean {:.2} spread {:.2} b2 {:.3} b3 {:.3} n {}",
                    100. * c.rms_relative,
                    100. * c.mean_relative,
                    c.mean_z,
                    c.z_mean,
                    c.z_spread,
                    c.beyond_2,
                    c.beyond_3,
                    c.compared
                );
            }
        }
    }
}
