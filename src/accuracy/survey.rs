//! A quick survey with a few rays before a computation: whether surfaces see fronts, backs, or the outside.

use std::{collections::HashMap, time::Instant};

use glam::Vec3A;
use rayon::prelude::*;

use crate::{
    patch::{DisjointSets, shut_in_solids},
    scene::Scene,
    trace::{
        Tracer,
        sampling::{around, mix, sobol_4d, square_to_cosine_hemisphere, square_to_triangle},
    },
};

/// Rays per parallel task.
const BLOCK: u64 = 4096;

/// Counts of rays from some surfaces by what they hit.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct Seen {
    /// Rays cast.
    pub rays: u64,
    /// Rays that hit the front of a surface.
    pub fronts: u64,
    /// Rays that hit the back of a surface.
    pub backs: u64,
    /// Rays that hit nothing.
    pub escaped: u64,
}

impl Seen {
    /// Share of backs among the hits. Zero without hits.
    pub fn back_share(&self) -> f64 {
        self.backs as f64 / (self.fronts + self.backs).max(1) as f64
    }

    /// Share of the rays that escaped.
    pub fn escaped_share(&self) -> f64 {
        self.escaped as f64 / self.rays.max(1) as f64
    }
}

/// The hits of rays from the fronts of a scene.
#[derive(Debug, Clone, PartialEq)]
#[non_exhaustive]
pub struct Survey {
    /// Rays from all fronts, in proportion to their area.
    pub all: Seen,
    /// Rays from the fronts that emit.
    pub lamps: Seen,
    /// For each material of the scene, the number of rays that hit its back.
    pub backs_of: Vec<u64>,
    /// Estimated share of the area whose back can be seen. These backs will become patches too.
    pub back_area: f64,
    /// Area of fronts that are shut in solids, in square scene units. No rays were cast from them.
    pub shut_in_area: f64,
    /// Time of all rays in seconds.
    pub seconds: f64,
}

impl Survey {
    /// Casts `rays` cosine-distributed rays from all fronts, and a quarter as many from emitting fronts. Fronts that
    /// are shut in solids ([`shut_in_solids`]) are left out. The same seed gives the same counts for any number of
    /// threads.
    pub fn of(scene: &Scene, tracer: &Tracer, rays: u64, seed: u64) -> Survey {
        let shut_in = shut_in_solids(scene);
        let is_shut_in = |t: &usize| shut_in.get(*t).is_some_and(|[front, _]| *front);
        let shut_in_area = (0..scene.triangles.len()).filter(is_shut_in).map(|t| scene.area(t)).sum();
        let mut all: Vec<usize> = (0..scene.triangles.len()).collect();
        if shut_in_area > 0.0 {
            all.retain(|t| !is_shut_in(t));
        }
        let lamps: Vec<usize> = all.iter().copied().filter(|&t| scene.emits(t)).collect();
        let mut backs_of = vec![0; scene.materials.len()];
        let mut seconds = 0.0;
        let (seen, met) = cast(scene, tracer, &all, rays, mix(&[seed, 0]), &mut seconds);
        met.iter().for_each(|&t| backs_of[scene.triangles[t as usize].material as usize] += 1);
        let back_area = back_area(scene, met);
        let (lamps, _) = cast(scene, tracer, &lamps, rays / 4, mix(&[seed, 1]), &mut seconds);
        Survey { all: seen, lamps, backs_of, back_area, shut_in_area, seconds }
    }
}

/// A luminaire that is inside out: the light of its fronts stays in it or close to it, while its backs see the room.
#[derive(Debug, Clone, PartialEq)]
pub struct TurnedLamp {
    /// Index of its first triangle.
    pub triangle: usize,
    /// Index of the material that most of its light hits first.
    pub lit: u32,
    /// The share of its light that stays close to it.
    pub kept: f64,
}

impl TurnedLamp {
    /// A sentence that says where it is and what may be wrong.
    pub fn warning(&self, scene: &Scene) -> String {
        let [a, b, c] = scene.corners(self.triangle);
        let at = (a + b + c) / 3.0;
        format!(
            "the lamp of `{}` at {:.4} {:.4} {:.4} sends {:.0} % of its light to its own luminaire (`{}`), while its back faces the \
             room: is it inside out?",
            scene.material(self.triangle).name,
            at.x,
            at.y,
            at.z,
            100.0 * self.kept,
            scene.materials[self.lit as usize].name
        )
    }
}

/// Random walks from each side of a luminaire. They give shares to a few per cent, enough to distinguish a half from a
/// quarter.
const WALKS: u32 = 256;
/// Number of hits of a walk. Light that leaves the neighbourhood of its luminaire within this many hits counts as gone.
const STEPS: u32 = 4;
/// Largest number of luminaires to check. The largest ones are checked.
const MOST_LAMPS: usize = 256;

/// The luminaires that are inside out. More than half of the light of their fronts is still close to them after some
/// reflections: in a box whose faces are inside out, or between a lamp and the ceiling that it faces. Fewer than a
/// quarter of the walks from their backs stay as close. A lamp deep in a recess does not count, because its light
/// leaves the recess after some reflections. A luminaire whose neighbourhood includes the whole scene, like a room that
/// glows all around, does not count either.
pub fn turned_lamps(scene: &Scene, tracer: &Tracer) -> Vec<TurnedLamp> {
    let area = |lamp: &[usize]| lamp.iter().map(|&t| scene.area(t)).sum::<f64>();
    let mut lamps: Vec<(f64, Vec<usize>)> =
        luminaires(scene).into_iter().map(|lamp| (area(&lamp), lamp)).collect();
    lamps.sort_by(|(a, s), (b, t)| b.total_cmp(a).then(s.cmp(t)));
    lamps.truncate(MOST_LAMPS);
    let all: Vec<usize> = (0..scene.triangles.len()).collect();
    let [lowest, highest] = bounds(tracer, &all);
    let turned = |(area, lamp): &(f64, Vec<usize>)| {
        let reach = (0.5 * area.sqrt() / tracer.scale()) as f32;
        let [low, high] = bounds(tracer, lamp);
        let near = [low - reach, high + reach];
        if near[0].cmple(lowest).all() && near[1].cmpge(highest).all() {
            return None;
        }
        let kept = |front: bool| kept(scene, tracer, lamp, front, near);
        let (share, lit) = kept(true);
        (share > 0.5 && kept(false).0 < 0.25).then_some(TurnedLamp { triangle: lamp[0], lit, kept: share })
    };
    lamps.par_iter().filter_map(turned).collect()
}

/// Bounding box of triangles, in unit space.
fn bounds(tracer: &Tracer, triangles: &[usize]) -> [Vec3A; 2] {
    const CORNERS: [[f32; 3]; 3] = [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]];
    let corners = triangles.iter().flat_map(|&t| CORNERS.map(|b| tracer.triangles()[t].point(b)));
    let none = [Vec3A::INFINITY, Vec3A::NEG_INFINITY];
    corners.fold(none, |[low, high], p| [low.min(p), high.max(p)])
}

/// Groups of emitting triangles that are connected by shared vertices and have the same material.
fn luminaires(scene: &Scene) -> Vec<Vec<usize>> {
    let emitters: Vec<usize> = (0..scene.triangles.len()).filter(|&t| scene.emits(t)).collect();
    let mut sets = DisjointSets::new(emitters.len());
    let mut first = HashMap::new();
    for (k, &t) in emitters.iter().enumerate() {
        let triangle = &scene.triangles[t];
        for v in triangle.vertices {
            sets.unite(k, *first.entry((triangle.material, v)).or_insert(k));
        }
    }
    let (numbers, count) = sets.numbers();
    let mut luminaires = vec![Vec::new(); count];
    emitters.into_iter().zip(numbers).for_each(|(t, number)| luminaires[number as usize].push(t));
    luminaires
}

/// The share of the random walks from one side of some triangles that stay in a box, and the material that most of them
/// hit first.
fn kept(scene: &Scene, tracer: &Tracer, lamp: &[usize], front: bool, [low, high]: [Vec3A; 2]) -> (f64, u32) {
    let total: f64 = lamp.iter().map(|&t| scene.area(t)).sum();
    let (mut below, mut at) = (scene.area(lamp[0]), 0);
    let (mut met, mut kept) = (vec![0u32; scene.materials.len()], 0);
    for k in 0..WALKS {
        while (f64::from(k) + 0.5) / f64::from(WALKS) * total > below && at + 1 < lamp.len() {
            at += 1;
            below += scene.area(lamp[at]);
        }
        let triangle = &tracer.triangles()[lamp[at]];
        let [x, y, mut u, mut v] = sobol_4d(k, 0);
        let (mut point, mut side) = (triangle.point(square_to_triangle(x, y)), triangle.side(front));
        kept += 1;
        for step in 0..STEPS {
            let direction = around(side.normal, square_to_cosine_hemisphere(u, v));
            let hit = tracer.closest(side.leave(point), direction);
            let Some(hit) = hit else {
                kept -= 1;
                break;
            };
            if step == 0 {
                met[scene.triangles[hit.triangle as usize].material as usize] += 1;
            }
            let triangle = &tracer.triangles()[hit.triangle as usize];
            (point, side) = (triangle.point(hit.barycentric), triangle.side(hit.front));
            if point.cmplt(low).any() || point.cmpgt(high).any() {
                kept -= 1;
                break;
            }
            [u, v, ..] = sobol_4d(k, mix(&[u64::from(step) + 1]));
        }
    }
    let most = (0..met.len()).max_by_key(|&m| (met[m], std::cmp::Reverse(m))).unwrap_or(0);
    (f64::from(kept) / f64::from(WALKS), most as u32)
}

/// The share of the area in triangles whose back was hit or would be hit by more rays. `met` holds a triangle per hit.
/// If a sample contains f1 kinds once and f2 kinds twice, at least f1² / 2 f2 kinds are missing (Chao, Scandinavian
/// Journal of Statistics 11, 1984).
fn back_area(scene: &Scene, mut met: Vec<u32>) -> f64 {
    met.sort_unstable();
    let (mut area, mut kinds, mut once, mut twice) = (0.0, 0.0, 0.0, 0.0);
    for same in met.chunk_by(|a, b| a == b) {
        area += scene.area(same[0] as usize);
        kinds += 1.0;
        once += f64::from(same.len() == 1);
        twice += f64::from(same.len() == 2);
    }
    if kinds == 0.0 {
        return 0.0;
    }
    let missing = once * (once - 1.0) / (2.0 * (twice + 1.0));
    let total: f64 = (0..scene.triangles.len()).map(|t| scene.area(t)).sum();
    (area / total * (kinds + missing) / kinds).min(1.0)
}

/// Casts `rays` rays from the triangles `from`. Returns the counts, and the triangle of each hit on a back. Adds the
/// time of the rays to `seconds`.
fn cast(
    scene: &Scene,
    tracer: &Tracer,
    from: &[usize],
    rays: u64,
    seed: u64,
    seconds: &mut f64,
) -> (Seen, Vec<u32>) {
    // Areas may overflow in the sum, and they may vanish in the single precision of unit space.
    let largest = from.iter().map(|&t| scene.area(t)).fold(0.0, f64::max);
    let mut below = Vec::with_capacity(from.len());
    let mut total = 0.0;
    for &t in from {
        total += scene.area(t) / largest;
        below.push(total);
    }
    if from.is_empty() {
        return (Seen::default(), Vec::new());
    }
    let start = Instant::now();
    let blocks: Vec<(Seen, Vec<u32>)> = (0..rays.div_ceil(BLOCK))
        .into_par_iter()
        .map(|block| {
            let (mut seen, mut backs) = (Seen::default(), Vec::new());
            for k in block * BLOCK..((block + 1) * BLOCK).min(rays) {
                let at = (k as f64 + 0.5) / rays as f64 * total;
                let t = from[below.partition_point(|&b| b < at).min(from.len() - 1)];
                let triangle = &tracer.triangles()[t];
                let [x, y, u, v] = sobol_4d(k as u32, seed);
                let origin = triangle.side(true).leave(triangle.point(square_to_triangle(x, y)));
                let direction = around(triangle.normal, square_to_cosine_hemisphere(u, v));
                seen.rays += 1;
                match tracer.closest(origin, direction) {
                    None => seen.escaped += 1,
                    Some(hit) if hit.front => seen.fronts += 1,
                    Some(hit) => {
                        seen.backs += 1;
                        backs.push(hit.triangle);
                    }
                }
            }
            (seen, backs)
        })
        .collect();
    *seconds += start.elapsed().as_secs_f64();
    blocks.into_iter().fold((Seen::default(), Vec::new()), |(mut sum, mut met), (seen, mut backs)| {
        sum.rays += seen.rays;
        sum.fronts += seen.fronts;
        sum.backs += seen.backs;
        sum.escaped += seen.escaped;
        met.append(&mut backs);
        (sum, met)
    })
}
