//! Emitters, and importance sampling of points on them by power.

use std::{cmp::Ordering, collections::BinaryHeap};

use glam::Vec3A;

use super::Samples;
use crate::{
    scene::{Scene, in_triangle, quadtree},
    trace::{Side, Tracer, sampling::square_to_triangle},
};

/// An emitting triangle, or a part of a triangle with an emission texture.
#[derive(Debug, Clone, Copy)]
struct Emitter {
    triangle: u32,
    /// The part, as a cell of the triangle's quadtree: the first of its descendants at level [`DEEPEST`], and its own
    /// level.
    first: u32,
    level: u8,
    /// Emitted radiance. A texture may reduce it.
    radiance: [f64; 3],
    /// Upper end of its share of \[0, 1).
    cumulative: f64,
    /// Probability per area in unit space.
    density: f64,
}

/// Number of parts that all triangles with emission textures are cut into, in addition to one part per triangle. If the
/// light of a texture comes from a few texels, points are then chosen there. A list of 2¹⁴ parts takes about a hundred
/// milliseconds to make.
const PARTS: f64 = 16384.0;

/// Deepest level of a part. Its index has 24 bits.
const DEEPEST: u8 = 12;

/// A point chosen on an emitter.
#[derive(Debug, Clone, Copy)]
pub(super) struct EmitterPoint {
    /// The point in unit space.
    pub(super) position: Vec3A,
    /// The side that emits.
    pub(super) side: Side,
    /// Emitted radiance.
    pub(super) radiance: [f64; 3],
    /// Probability per area in unit space.
    pub(super) density: f64,
}

/// The emitters of a scene. Each is chosen with a probability proportional to its power, summed over the channels.
/// Points are uniform on each emitter.
#[derive(Debug, Clone, Default)]
pub(super) struct Emitters {
    list: Vec<Emitter>,
    /// For each triangle of the scene, the index of its first part in `list`. The last entry is the length of the list.
    /// Empty without emitters.
    starts: Vec<u32>,
    /// The largest radiance that any material emits.
    brightest: [f64; 3],
    /// Whether any emitter has an emission texture.
    textured: bool,
    /// Power of all emitters, summed over the channels, W.
    power: f64,
}

impl Emitters {
    /// Lists the emitters of `scene`.
    pub(super) fn new(scene: &Scene, tracer: &Tracer) -> Emitters {
        let whole = |t: usize| if scene.emits(t) { Part::new(scene, t, 0, 0).power } else { 0.0 };
        let powers: Vec<f64> = (0..scene.triangles.len()).map(whole).collect();
        let total: f64 = powers.iter().sum();
        let mut emitters = Emitters::default();
        if total <= 0.0 {
            return emitters;
        }
        let textured = |t: usize| scene.emission_texels(t) > 0.0;
        let of_textures: f64 = (0..powers.len()).filter(|&t| textured(t)).map(|t| powers[t]).sum();
        let mut sum = 0.0;
        let mut cumulative = 0.0;
        for (t, &power) in powers.iter().enumerate() {
            emitters.starts.push(emitters.list.len() as u32);
            if power <= 0.0 {
                continue;
            }
            let emission = scene.material(t).emission;
            emitters.textured |= scene.material(t).emission_map.is_some();
            (0..3).for_each(|c| emitters.brightest[c] = emitters.brightest[c].max(emission[c]));
            let parts = if textured(t) {
                parts(scene, t, 1 + (PARTS * power / of_textures) as usize)
            } else {
                vec![Part { power, child: 0, level: 0 }]
            };
            // The power of all parts may differ from the whole by the rounding of their means.
            let share = power / parts.iter().map(|part| part.power).sum::<f64>();
            let area = scene.area(t) / tracer.scale().powi(2);
            for part in parts {
                let Part { power, child, level } = part;
                // The density follows from the rounded interval, so that rounding causes no bias.
                let low = cumulative;
                sum += power * share;
                cumulative = sum / total;
                let density = (cumulative - low) * f64::from(quadtree::children(level)) / area;
                let first = child << (2 * (DEEPEST - level));
                emitters.list.push(Emitter {
                    triangle: t as u32,
                    first,
                    level,
                    radiance: emission,
                    cumulative,
                    density,
                });
            }
        }
        emitters.starts.push(emitters.list.len() as u32);
        emitters.power = total;
        emitters
    }

    /// Power of all emitters, summed over the channels, W.
    pub(super) fn power(&self) -> f64 {
        self.power
    }

    /// Whether nothing emits.
    pub(super) fn is_empty(&self) -> bool {
        self.list.is_empty()
    }

    /// The largest radiance that any material emits. A texture may reduce it.
    pub(super) fn brightest(&self) -> [f64; 3] {
        self.brightest
    }

    /// Probability per area in unit space with which [`Emitters::sample`] chooses a point of a triangle.
    #[inline]
    pub(super) fn density(&self, triangle: u32, barycentric: [f32; 3]) -> f64 {
        let t = triangle as usize;
        let [Some(&start), Some(&end)] = [t, t + 1].map(|t| self.starts.get(t)) else { return 0.0 };
        match &self.list[start as usize..end as usize] {
            [] => 0.0,
            [whole] if whole.level == 0 => whole.density,
            parts => {
                let child = quadtree::child_at(barycentric, DEEPEST);
                let after = parts.partition_point(|part| part.first <= child);
                let held = |part: &&Emitter| child - part.first < quadtree::children(DEEPEST - part.level);
                after.checked_sub(1).map(|k| &parts[k]).filter(held).map_or(0.0, |part| part.density)
            }
        }
    }

    /// Chooses a point on an emitter. It needs only one pair of numbers, because the remainder of the number that chose
    /// the emitter is uniform again. This preserves the stratification of the samples.
    ///
    /// # Panics
    /// If nothing emits.
    #[inline]
    pub(super) fn sample(&self, scene: &Scene, tracer: &Tracer, samples: &mut Samples) -> EmitterPoint {
        let (x, y) = samples.fine_square();
        let i = self.list.partition_point(|e| e.cumulative <= x).min(self.list.len() - 1);
        let low = if i == 0 { 0.0 } else { self.list[i - 1].cumulative };
        let Emitter { triangle, first, level, mut radiance, cumulative, density } = self.list[i];
        let rest = ((x - low) / (cumulative - low)) as f32;
        let mut barycentric = square_to_triangle(rest.min(1.0 - f32::EPSILON / 2.0), y);
        if level > 0 {
            let corners = quadtree::corners(first >> (2 * (DEEPEST - level)), level);
            barycentric = in_triangle(barycentric.map(f64::from), &corners).map(|b| b as f32);
        }
        if self.textured {
            radiance = scene.emission_at(triangle as usize, barycentric.map(f64::from));
        }
        let shape = &tracer.triangles()[triangle as usize];
        EmitterPoint { position: shape.point(barycentric), side: shape.side(true), radiance, density }
    }
}

/// A part of a triangle and its emitted power, ordered by power for a heap.
#[derive(Debug, Clone, Copy)]
struct Part {
    power: f64,
    child: u32,
    level: u8,
}

impl Part {
    fn new(scene: &Scene, t: usize, child: u32, level: u8) -> Part {
        let area = scene.area(t) / f64::from(quadtree::children(level));
        let flux =
            scene.mean_emission(t, &quadtree::corners(child, level)).map(|l| l * std::f64::consts::PI * area);
        Part { power: flux.iter().sum(), child, level }
    }
}

impl PartialEq for Part {
    fn eq(&self, other: &Part) -> bool {
        self.cmp(other).is_eq()
    }
}

impl Eq for Part {}

impl PartialOrd for Part {
    fn partial_cmp(&self, other: &Part) -> Option<Ordering> {
        Some(self.cmp(other))
    }
}

impl Ord for Part {
    fn cmp(&self, other: &Part) -> Ordering {
        self.power
            .total_cmp(&other.power)
            .then(other.level.cmp(&self.level))
            .then(other.child.cmp(&self.child))
    }
}

/// Cuts a triangle into at most `most` + 2 parts, in the order of the quadtree. It repeatedly cuts the part with the
/// most power, down to the size of a texel. Parts that emit nothing are left out.
fn parts(scene: &Scene, t: usize, most: usize) -> Vec<Part> {
    let texels = scene.emission_texels(t);
    let mut open = BinaryHeap::from([Part::new(scene, t, 0, 0)]);
    let mut done = Vec::new();
    while open.len() + done.len() < most
        && let Some(part) = open.pop()
    {
        let level = part.level + 1;
        if level > DEEPEST || texels * 0.5f64.powi(part.level.into()) < 1.0 {
            done.push(part);
            continue;
        }
        let children = (0..4).map(|digit| Part::new(scene, t, 4 * part.child + digit, level));
        open.extend(children.filter(|child| child.power > 0.0));
    }
    done.extend(open);
    done.sort_unstable_by_key(|part| part.child << (2 * (DEEPEST - part.level)));
    done
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
            assert_eq!(point.density, emitters.density(t as u32, [1.0 / 3.0; 3]));
            let area = [2.0, 0.5][t - 1] / tracer.scale().powi(2);
            assert!((point.density * area - [0.4, 0.6][t - 1]).abs() < 1e-12);
        }
        assert_eq!(emitters.density(0, [1.0 / 3.0; 3]), 0.0);
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
        assert_eq!(emitters.density(0, [1.0 / 3.0; 3]), 0.0);
    }
}
