//! The triangles that emit, and points on them chosen by power.

use glam::Vec3A;

use super::Samples;
use crate::{
    scene::Scene,
    trace::{Tracer, sampling::square_to_triangle},
};

const WHOLE: [[f64; 3]; 3] = [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]];
const NONE: u32 = u32::MAX;

/// One emitting triangle.
#[derive(Debug, Clone, Copy)]
struct Emitter {
    triangle: u32,
    /// Upper end of its share of \[0, 1).
    cumulative: f64,
    /// Probability per area, unit space.
    density: f64,
}

/// A point chosen on an emitter.
#[derive(Debug, Clone, Copy)]
pub(super) struct EmitterPoint {
    /// The point, unit space.
    pub(super) position: Vec3A,
    /// Normal of the side that emits.
    pub(super) normal: Vec3A,
    /// Radiance emitted.
    pub(super) radiance: [f64; 3],
    /// Probability per area in unit space.
    pub(super) density: f64,
}

/// The emitting triangles of a scene, each with a probability proportional to its power (R, G and B alike); uniform
/// on the triangle.
#[derive(Debug, Clone, Default)]
pub(super) struct Emitters {
    list: Vec<Emitter>,
    /// For each triangle of the scene its place in `list`, or [`NONE`]; empty without emitters.
    index: Vec<u32>,
}

impl Emitters {
    /// Lists the triangles of `scene` that emit.
    pub(super) fn new(scene: &Scene, tracer: &Tracer) -> Emitters {
        let mut emitters = Emitters::default();
        let mut powers = Vec::new();
        for t in (0..scene.triangles.len()).filter(|&t| scene.emits(t)) {
            let flux = scene.mean_emission(t, &WHOLE).map(|l| l * std::f64::consts::PI * scene.area(t));
            let weight: f64 = flux.iter().sum();
            if weight > 0.0 {
                let area = scene.area(t) / tracer.scale().powi(2);
                emitters.list.push(Emitter { triangle: t as u32, cumulative: 0.0, density: 1.0 / area });
                powers.push(weight);
            }
        }
        if emitters.list.is_empty() {
            return emitters;
        }
        let total: f64 = powers.iter().sum();
        let mut sum = 0.0;
        emitters.index = vec![NONE; scene.triangles.len()];
        for (i, (emitter, power)) in emitters.list.iter_mut().zip(&powers).enumerate() {
            // The density is that of the interval really held, so that rounding cannot favour anyone.
            let low = sum / total;
            sum += power;
            emitter.cumulative = sum / total;
            emitter.density *= emitter.cumulative - low;
            emitters.index[emitter.triangle as usize] = i as u32;
        }
        emitters
    }

    /// Whether nothing emits.
    pub(super) fn is_empty(&self) -> bool {
        self.list.is_empty()
    }

    /// Probability per area (unit space) with which [`Emitters::sample`] chooses a point of `triangle`.
    #[inline]
    pub(super) fn density(&self, triangle: u32) -> f64 {
        match self.index.get(triangle as usize) {
            Some(&i) if i != NONE => self.list[i as usize].density,
            _ => 0.0,
        }
    }

    /// Chooses a point. One pair of numbers does: the remainder of the number that chose the triangle is uniform
    /// again, so strata survive.
    ///
    /// # Panics
    /// When nothing emits.
    #[inline]
    pub(super) fn sample(&self, scene: &Scene, tracer: &Tracer, samples: &mut Samples) -> EmitterPoint {
        let (x, y) = samples.fine_square();
        let i = self.list.partition_point(|e| e.cumulative <= x).min(self.list.len() - 1);
        let low = if i == 0 { 0.0 } else { self.list[i - 1].cumulative };
        let Emitter { triangle, cumulative, density } = self.list[i];
        let rest = ((x - low) / (cumulative - low)) as f32;
        let barycentric = square_to_triangle(rest.min(1.0 - f32::EPSILON / 2.0), y);
        let shape = &tracer.triangles()[triangle as usize];
        EmitterPoint {
            position: shape.point(barycentric),
            normal: shape.normal,
            radiance: scene.emission_at(triangle as usize, barycentric.map(f64::from)),
            density,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::scene::Material;
    use glam::dvec3;

    #[test]
    fn points_follow_the_power() {
        let lamp = |x: f64, size: f64| [dvec3(x, 0.0, 0.0), dvec3(x + size, 0.0, 0.0), dvec3(x, size, 0.0)];
        let materials = vec![
            Material::new("wall", [0.5; 3], [0.0; 3]),
            Material::new("dim", [0.0; 3], [1.0, 0.0, 0.0]),
            Material::new("bright", [0.0; 3], [4.0, 1.0, 1.0]),
        ];
        let scene = Scene::new(&[(lamp(0.0, 1.0), 0), (lamp(2.0, 2.0), 1), (lamp(5.0, 1.0), 2)], materials);
        let tracer = Tracer::new(&scene);
        let emitters = Emitters::new(&scene, &tracer);
        // Areas 2 and 1/2, sums of channels 1 and 6: powers 2π and 3π.
        let mut counts = [0; 3];
        let mut centre = [Vec3A::ZERO; 3];
        for i in 0..1 << 12 {
            let point = emitters.sample(&scene, &tracer, &mut Samples::new(i, 3));
            let t = if tracer.to_file(point.position).x < 4.5 { 1 } else { 2 };
            counts[t] += 1;
            centre[t] += point.position;
            assert_eq!(point.density, emitters.density(t as u32));
            let area = [2.0, 0.5][t - 1] / tracer.scale().powi(2);
            assert!((point.density * area - [0.4, 0.6][t - 1]).abs() < 1e-12);
        }
        assert_eq!(emitters.density(0), 0.0);
        assert!((counts[1] as f64 / 4096.0 - 0.4).abs() < 1e-3, "{counts:?}");
        for t in 1..3 {
            let mean = centre[t] / counts[t] as f32;
            let middle = tracer.triangles()[t].point([1.0 / 3.0; 3]);
            assert!((mean - middle).length() < 2e-3, "{mean} {middle}");
        }
    }

    #[test]
    fn black_emitters_are_none() {
        let corners = [dvec3(0.0, 0.0, 0.0), dvec3(1.0, 0.0, 0.0), dvec3(0.0, 1.0, 0.0)];
        let scene = Scene::new(&[(corners, 0)], vec![Material::new("black", [0.5; 3], [0.0; 3])]);
        let emitters = Emitters::new(&scene, &Tracer::new(&scene));
        assert!(emitters.is_empty());
        assert_eq!(emitters.density(0), 0.0);
    }
}
