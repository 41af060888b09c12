//! Shadow rays: bright form factors measured between points on both patches.
//!
//! Hemisphere rays find a small lamp rarely, and most of the sampling error of a solution would be in its direct light.
//! From every patch, rays therefore also go to points on the *sources* (the patches that emit), chosen by power.
//!
//! A shadow ray samples pairs of points (x on i, y on j) with density N_i p_j / (A_i A_j), and its kernel is
//! g = cos θ cos θ' / (π r²). Where [lamps are few](super::lamp), some go to each, however dim it is beside others: it may be all
//! the light there is behind a door. And the kernels' mean G_il, blocked ones included, is known of each lamp l, so that what i
//! gets from it is the ratio estimate (the separate one: Cochran, *Sampling Techniques*, 1977, section 6.10)
//!
//!   Σ_(j in l) S_ij b_j = G_il / (Σ g / N_i) · Σ_visible g A_i A_j / N_i,
//!
//! in proportion to the brightness b. Where no sample has a kernel, since most of i is behind l, a few more rays [probe] it.
//!
//! How it divides among the sources, their own hemisphere rays tell too, with density (R_j / A_j) g: by the power heuristic
//! (Veach and Guibas, SIGGRAPH 95), and scaled to that sum.
//!
//! Where they are many, all hemisphere rays help: the balance heuristic combines every sample of a pair, whichever technique
//! found it and from whichever end,
//!
//!   S_ij = Σ w g / (h (R_i/A_i + R_j/A_j) g + (N_i p_j + N_j p_i) / (A_i A_j)),  w = 1 for shadow rays, h for hemisphere rays,
//!
//! where h is [how far](super::reciprocity) the latter are trusted. No term exceeds w / (h (R_i/A_i + R_j/A_j)), so that
//! lamps close to walls need no special case.

use std::ops::Range;

use glam::Vec3A;
use rayon::prelude::*;

use super::lamp::{self, Lamps};
use crate::{
    patch::Patches,
    trace::{
        Tracer,
        sampling::{cosine_hemisphere, mix, square_to_triangle, tangents},
        sobol::{LANES, Sobol, blocks},
    },
};

/// How a link was found.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Found {
    /// By a hemisphere ray.
    Hemisphere,
    /// By a shadow ray.
    Shadow,
    /// By a shadow ray that something stopped, or by any ray of a patch that is hidden.
    Blocked,
}

/// A sample of a pair of which at least one patch is a source.
#[derive(Debug, Clone, Copy)]
pub(super) struct Link {
    /// The patch it goes to.
    pub(super) to: u32,
    /// The kernel cos θ cos θ' / (π r²), lengths in unit space.
    pub(super) kernel: f32,
    /// Which of the rays of its kind that left the patch it is.
    pub(super) index: u32,
    /// How it was found.
    pub(super) found: Found,
}

/// The least index of a [probe](probe): no patch casts as many rays.
const FIRST_PROBE: u32 = u32::MAX - PROBES;

impl Link {
    fn found(self, visible: bool) -> Link {
        Link { found: if visible { Found::Shadow } else { Found::Blocked }, ..self }
    }

    /// Which probe of its lamp it is, if any.
    #[inline]
    pub(super) fn probe(&self) -> Option<u32> {
        self.index.checked_sub(FIRST_PROBE)
    }
}

/// The patches that shadow rays go to.
#[derive(Debug, Clone, Default)]
pub(super) struct Sources {
    patches: Vec<u32>,
    footprints: Vec<Footprint>,
    cumulative: Vec<f64>,
    probability: Vec<f32>,
    lamps: Option<Lamps>,
    /// Which lamp each patch is part of, and how much of the power it sends for each shadow ray, beside the mean of all; both
    /// empty where there is one lamp or many.
    lamp: Vec<u8>,
    weights: Vec<f64>,
    /// Patches that emit behind another face at the same place, in order: nobody sees their light.
    hidden: Vec<u32>,
}

/// Probes of a patch to a lamp, and points that are tried for each batch of them.
const PROBES: u32 = 4;
const MOST_TRIES: u32 = 4096;

/// The share of shadow rays that all lamps get alike, where they are few.
const TO_EACH: f64 = 0.25;

/// A face no farther before a patch than this, in unit space, is at the same place: rays begin beyond it.
const SAME_PLACE: f32 = 4e-6;

impl Sources {
    /// All front patches that emit and are not hidden, by power.
    pub(super) fn emitters(tracer: &Tracer, patches: &Patches) -> Sources {
        let channels = patches.channels();
        let mut power: Vec<f64> = (0..patches.fronts())
            .map(|i| patches.area(i) * patches.emission()[i * channels..][..channels].iter().sum::<f64>())
            .collect();
        let emits = |&i: &u32| power[i as usize] > 0.0;
        let hidden: Vec<u32> = (0..power.len() as u32)
            .into_par_iter()
            .filter(emits)
            .filter(|&i| is_hidden(tracer, patches, i as usize))
            .collect();
        hidden.iter().for_each(|&i| power[i as usize] = 0.0);
        let total: f64 = power.iter().sum();
        let mut sources = Sources { hidden, ..Sources::default() };
        let mut sum = 0.0;
        for (i, &power) in power.iter().enumerate() {
            sources.probability.push(if total > 0.0 { (power / total) as f32 } else { 0.0 });
            if power > 0.0 {
                sum += power;
                sources.patches.push(i as u32);
                sources.footprints.push(Footprint::new(tracer, patches, i));
                sources.cumulative.push(sum / total);
            }
        }
        sources.lamps = lamp::few(tracer, patches, &sources);
        sources.share_out();
        sources
    }

    /// Sees to it that no lamp, where they are few, goes without shadow rays.
    fn share_out(&mut self) {
        let Some(lamps) = self.lamps.as_ref().filter(|lamps| lamps.count > 1) else { return };
        let power = |i: u32| f64::from(self.probability[i as usize]);
        let mut of_lamps = vec![0.0; lamps.count];
        let parts = || self.patches.iter().zip(&lamps.of_sources);
        parts().for_each(|(&i, &lamp)| of_lamps[usize::from(lamp)] += power(i));
        let weigh = |power: f64| power / ((1.0 - TO_EACH) * power + TO_EACH / lamps.count as f64);
        self.weights = of_lamps.into_iter().map(weigh).collect();
        self.lamp = vec![0; self.probability.len()];
        parts().for_each(|(&i, &lamp)| self.lamp[i as usize] = lamp);
        let mut sum = 0.0;
        for (&i, cumulative) in self.patches.iter().zip(&mut self.cumulative) {
            let share =
                f64::from(self.probability[i as usize]) / self.weights[usize::from(self.lamp[i as usize])];
            self.probability[i as usize] = share as f32;
            sum += share;
            *cumulative = sum;
        }
    }

    pub(super) fn is_empty(&self) -> bool {
        self.patches.is_empty()
    }

    /// The sources, in order.
    pub(super) fn patches(&self) -> &[u32] {
        &self.patches
    }

    /// Whether the light of all sources is known but for shadows, so that hemisphere rays need not measure it.
    pub(super) fn are_lamps(&self) -> bool {
        self.lamps.is_some()
    }

    /// How many lamps there are, where they are few: else they count as one.
    pub(super) fn lamps(&self) -> usize {
        self.weights.len().max(1)
    }

    /// The lamp that source `i` is part of.
    #[inline]
    pub(super) fn lamp_of(&self, i: usize) -> usize {
        self.lamp.get(i).map_or(0, |&lamp| lamp.into())
    }

    /// The power that a shadow ray to source `i` stands for, where one chosen by power stands for 1.
    #[inline]
    pub(super) fn weight(&self, i: usize) -> f64 {
        self.weights.get(self.lamp_of(i)).copied().unwrap_or(1.0)
    }

    /// The mean kernel of the shadow rays of a patch to each lamp, were they chosen by power and none blocked; 1 where that is not
    /// known.
    pub(super) fn mean_kernels(&self, from: &Footprint) -> Vec<f64> {
        let means = |lamps: &Lamps| {
            lamp::mean_kernels(lamps, from.corners.map(|c| c.as_dvec3()), from.normal.as_dvec3())
        };
        self.lamps.as_ref().map_or_else(|| vec![1.0], means)
    }

    /// Whether patch `i` emits behind another face at the same place.
    pub(super) fn hide(&self, i: usize) -> bool {
        self.hidden.binary_search(&(i as u32)).is_ok()
    }

    /// Whether patch `i` is a source.
    #[inline]
    pub(super) fn contains(&self, i: usize) -> bool {
        self.probability.get(i).is_some_and(|&p| p > 0.0)
    }

    /// Probability that a shadow ray goes to patch `i`; zero for all that are no sources.
    #[inline]
    pub(super) fn probability(&self, i: usize) -> f64 {
        self.probability.get(i).map_or(0.0, |&p| f64::from(p))
    }

    /// Whether either patch is a source: then the pair is measured by links.
    #[inline]
    pub(super) fn concern(&self, i: usize, j: usize) -> bool {
        self.contains(i) || self.contains(j)
    }

    /// A shadow ray from a patch with its points, moved off their surfaces, where these face each other.
    #[inline]
    fn link(&self, from: &Footprint, index: u32, [x, y, u, v]: [f32; 4]) -> Option<(Link, Vec3A, Vec3A)> {
        let (source, u) = self.choose(u);
        let to = &self.footprints[source];
        let (p, q) = (from.point(x, y), to.point(u, v));
        let path = q - p;
        if path.dot(from.normal) <= 0.0 || path.dot(to.normal) >= 0.0 {
            return None;
        }
        let kernel = kernel(path, from.normal, to.normal);
        let link = Link { to: self.patches[source], kernel, index, found: Found::Blocked };
        (kernel > 0.0).then(|| (link, Tracer::leave(p, from.normal), Tracer::leave(q, to.normal)))
    }

    /// Which of the numbers in \[0, 1) choose sources of a lamp, where lamps are few.
    fn range(&self, lamp: usize) -> Range<f64> {
        let of_sources = self.lamps.as_ref().map_or(&[][..], |lamps| &lamps.of_sources);
        let below = |lamp: usize| match of_sources.partition_point(|&l| usize::from(l) < lamp) {
            0 => 0.0,
            k => self.cumulative[k - 1],
        };
        below(lamp)..below(lamp + 1)
    }

    /// Index of the source for a number in \[0, 1), and what is left of the number, stretched to \[0, 1) again.
    fn choose(&self, u: f32) -> (usize, f32) {
        let u = f64::from(u);
        let k = self.cumulative.partition_point(|&c| c <= u).min(self.patches.len() - 1);
        let below = if k > 0 { self.cumulative[k - 1] } else { 0.0 };
        let rest = ((u - below) / (self.cumulative[k] - below)) as f32;
        (k, rest.clamp(0.0, 1.0 - f32::EPSILON))
    }
}

/// Whether a ray that comes to the middle of patch `i` meets another face there, which faces the same way.
pub(crate) fn is_hidden(tracer: &Tracer, patches: &Patches, i: usize) -> bool {
    let Footprint { corners, normal } = Footprint::new(tracer, patches, i);
    let middle = (corners[0] + corners[1] + corners[2]) / 3.0;
    tracer.closest(Tracer::leave(middle, normal), -normal).is_some_and(|hit| {
        hit.front == patches.is_front(i)
            && hit.t <= SAME_PLACE
            && hit.triangle as usize != patches.triangle(i)
    })
}

/// Where rays leave a patch: its corners, inset from the triangle's edges, and its normal, in unit space.
#[derive(Debug, Clone)]
pub(super) struct Footprint {
    corners: [Vec3A; 3],
    pub(super) normal: Vec3A,
}

impl Footprint {
    pub(super) fn new(tracer: &Tracer, patches: &Patches, i: usize) -> Footprint {
        let triangle = &tracer.triangles()[patches.triangle(i)];
        Footprint {
            corners: patches.barycentric_corners(i).map(|b| triangle.point(b.map(|x| x as f32))),
            normal: triangle.side_normal(patches.is_front(i)),
        }
    }

    /// Hemisphere rays of a sequence.
    pub(super) fn hemisphere_rays(
        &self,
        indices: Range<u32>,
        seed: u64,
    ) -> impl Iterator<Item = HemisphereRay> + '_ {
        let (sobol, [tangent, bitangent]) = (Sobol::new(seed), tangents(self.normal));
        blocks(indices).flat_map(move |(first, lanes)| {
            // The first two dimensions are the better stratified.
            let [u, v, x, y] = sobol.points(first);
            let (mut lifted, mut at) = ([[0.0; 3]; LANES], [[0.0; LANES]; 3]);
            for lane in 0..LANES {
                lifted[lane] = cosine_hemisphere(u[lane], v[lane]);
                let b = square_to_triangle(x[lane], y[lane]);
                for axis in 0..3 {
                    let corner = |k: usize| self.corners[k][axis] * b[k];
                    at[axis][lane] = corner(0) + corner(1) + corner(2);
                }
            }
            for (axis, at) in at.iter_mut().enumerate() {
                Tracer::leave_along(at, self.normal, axis);
            }
            lanes.map(move |lane| {
                let [x, y, cosine] = lifted[lane];
                HemisphereRay {
                    index: first + lane as u32,
                    origin: Vec3A::new(at[0][lane], at[1][lane], at[2][lane]),
                    direction: tangent * x + bitangent * y + self.normal * cosine,
                    cosine,
                }
            })
        })
    }

    /// The point of the patch for a point of the unit square.
    #[inline]
    pub(super) fn point(&self, x: f32, y: f32) -> Vec3A {
        let b = square_to_triangle(x, y);
        self.corners[0] * b[0] + self.corners[1] * b[1] + self.corners[2] * b[2]
    }
}

/// A ray from a point of a patch in a cosine-distributed direction.
#[derive(Debug, Clone, Copy)]
pub(super) struct HemisphereRay {
    /// Its place in the sequence.
    pub(super) index: u32,
    pub(super) origin: Vec3A,
    pub(super) direction: Vec3A,
    /// Of its angle with the normal.
    pub(super) cosine: f32,
}

/// cos θ cos θ' / (π r²) over a path between two points whose unit normals face each other.
#[inline]
pub(crate) fn kernel(path: Vec3A, from: Vec3A, to: Vec3A) -> f32 {
    let squared = path.length_squared();
    path.dot(from) * -path.dot(to) / (std::f32::consts::PI * squared * squared)
}

/// Sends the shadow rays of a patch with these indices, and appends those whose kernel is positive to `links`: of lamps
/// all, else only those that arrive.
pub(super) fn cast_patch(
    tracer: &Tracer,
    sources: &Sources,
    from: &Footprint,
    indices: Range<u32>,
    seed: u64,
    links: &mut Vec<Link>,
) {
    let (sobol, known) = (Sobol::new(seed), links.len());
    let rays = blocks(indices).flat_map(|(first, lanes)| {
        let points = sobol.points(first);
        lanes.filter_map(move |lane| {
            sources.link(from, first + lane as u32, points.map(|coordinates| coordinates[lane]))
        })
    });
    tracer.visible_each(rays, |link, visible| {
        if visible || sources.are_lamps() {
            links.push(link.found(visible));
        }
    });
    // In the order of the sequence, not that in which rays end: sums over links go by it.
    links[known..].sort_unstable_by_key(|link| link.index);
}

/// Sends some rays to each lamp, where these are few, that a patch sees part of, though none of its shadow rays left from what is
/// before the lamp, or came to what is before the patch. What it gets from there unblocked is known, and would count as nothing.
pub(super) fn probe(
    tracer: &Tracer,
    sources: &Sources,
    from: &Footprint,
    mean_kernels: &[f64],
    seed: u64,
    before: &[Link],
    links: &mut Vec<Link>,
) {
    let mut unseen: Vec<bool> = mean_kernels.iter().map(|&mean| mean > 0.0).collect();
    let cast = |link: &&Link| link.found != Found::Hemisphere && link.probe().is_none();
    before
        .iter()
        .chain(&*links)
        .filter(cast)
        .for_each(|link| unseen[sources.lamp_of(link.to as usize)] = false);
    for lamp in (0..unseen.len()).filter(|&lamp| unseen[lamp]) {
        let sobol = Sobol::new(mix(&[seed, lamp as u64]));
        let range = sources.range(lamp);
        let tries = blocks(0..MOST_TRIES).flat_map(|(first, lanes)| {
            let points = sobol.points(first);
            lanes.map(move |lane| points.map(|coordinates| coordinates[lane]))
        });
        let facing = tries.filter_map(|[x, y, u, v]| {
            let u = f64::from(u).mul_add(range.end - range.start, range.start) as f32;
            let link = sources.link(from, FIRST_PROBE, [x, y, u, v]);
            link.filter(|(link, ..)| sources.lamp_of(link.to as usize) == lamp)
        });
        for (k, (link, p, q)) in (0..PROBES).zip(facing) {
            let link = Link { index: FIRST_PROBE + k, ..link };
            links.push(link.found(tracer.visible(p, q)));
        }
    }
}
