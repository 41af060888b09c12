//! Shadow rays: bright form factors measured between points on both patches.
//!
//! Hemisphere rays find a small lamp rarely, and most of the sampling error of a solution is in its direct light. From
//! every patch, rays therefore also go to points on the *sources* (the patches that emit), chosen by power.
//!
//! Both techniques sample pairs of points (x on i, y on j). A hemisphere ray from i does so with density
//! (R_i / A_i) g(x, y), where g = cos θ cos θ' / (π r²), a shadow ray with density N_i p_j / (A_i A_j). The balance
//! heuristic (Veach and Guibas, SIGGRAPH 95) combines every sample of a pair, whichever technique found it and from
//! whichever end, into one unbiased exchange area
//!
//!   S_ij = Σ g / ((R_i/A_i + R_j/A_j) g + (N_i p_j + N_j p_i) / (A_i A_j)).
//!
//! No term exceeds A_i A_j / (R_i A_j + R_j A_i), so that lamps close to walls need no special case; without shadow rays
//! it is the pooling rule of [`reciprocity`](super::reciprocity).

use glam::Vec3A;

use crate::{
    patch::Patches,
    trace::{
        Tracer,
        sampling::{sobol_4d, square_to_triangle},
    },
};

/// A sample of a pair of which at least one patch is a source: a hemisphere ray that connects them, or an unoccluded
/// shadow ray.
#[derive(Debug, Clone, Copy)]
pub(super) struct Link {
    /// The patch the ray left.
    pub(super) from: u32,
    /// The patch it reached.
    pub(super) to: u32,
    /// The kernel cos θ cos θ' / (π r²), lengths in unit space.
    pub(super) kernel: f32,
    /// The replicate it belongs to.
    pub(super) replicate: u32,
    /// Whether a shadow ray found it.
    pub(super) shadow: bool,
}

/// The patches that shadow rays go to.
#[derive(Debug, Clone, Default)]
pub(super) struct Sources {
    patches: Vec<u32>,
    cumulative: Vec<f64>,
    probability: Vec<f32>,
}

impl Sources {
    /// All front patches that emit, by power.
    pub(super) fn emitters(patches: &Patches) -> Sources {
        let channels = patches.channels();
        let power: Vec<f64> = (0..patches.fronts())
            .map(|i| patches.area(i) * patches.emission()[i * channels..][..channels].iter().sum::<f64>())
            .collect();
        let total: f64 = power.iter().sum();
        let mut sources = Sources::default();
        let mut sum = 0.0;
        for (i, &power) in power.iter().enumerate() {
            sources.probability.push(if total > 0.0 { (power / total) as f32 } else { 0.0 });
            if power > 0.0 {
                sum += power;
                sources.patches.push(i as u32);
                sources.cumulative.push(sum / total);
            }
        }
        sources
    }

    pub(super) fn is_empty(&self) -> bool {
        self.patches.is_empty()
    }

    /// The highest index of a source.
    pub(super) fn most(&self) -> usize {
        self.patches.last().map_or(0, |&i| i as usize)
    }

    /// Probability that a shadow ray goes to patch `i`; zero for all that are no sources.
    #[inline]
    pub(super) fn probability(&self, i: usize) -> f64 {
        self.probability.get(i).map_or(0.0, |&p| f64::from(p))
    }

    /// Whether either patch is a source: then the pair is measured by links.
    #[inline]
    pub(super) fn concern(&self, i: usize, j: usize) -> bool {
        self.probability(i) > 0.0 || self.probability(j) > 0.0
    }

    /// The source for a number in \[0, 1), and what is left of the number, stretched to \[0, 1) again.
    fn choose(&self, u: f32) -> (usize, f32) {
        let u = f64::from(u);
        let k = self.cumulative.partition_point(|&c| c <= u).min(self.patches.len() - 1);
        let below = if k > 0 { self.cumulative[k - 1] } else { 0.0 };
        let rest = ((u - below) / (self.cumulative[k] - below)) as f32;
        (self.patches[k] as usize, rest.clamp(0.0, 1.0 - f32::EPSILON))
    }
}

/// Where rays leave a patch: its corners, inset from the triangle's edges, and its normal, in unit space.
pub(super) struct Footprint {
    corners: [Vec3A; 3],
    pub(super) normal: Vec3A,
}

impl Footprint {
    pub(super) fn new(tracer: &Tracer, patches: &Patches, i: usize) -> Footprint {
        let triangle = &tracer.triangles()[patches.triangle(i)];
        Footprint {
            corners: patches.corners(i).map(|b| triangle.point(b.map(|x| x as f32))),
            normal: triangle.side_normal(patches.is_front(i)),
        }
    }

    /// The point of the patch for a point of the unit square.
    #[inline]
    pub(super) fn point(&self, x: f32, y: f32) -> Vec3A {
        let b = square_to_triangle(x, y);
        self.corners[0] * b[0] + self.corners[1] * b[1] + self.corners[2] * b[2]
    }
}

/// Sends `count` shadow rays of one replicate from patch `i` and calls `link` for each that arrives.
pub(super) fn cast_patch(
    tracer: &Tracer,
    patches: &Patches,
    sources: &Sources,
    from: &Footprint,
    (i, replicate, count): (usize, u32, u32),
    seed: u64,
    links: &mut Vec<Link>,
) {
    for index in 0..count {
        let [x, y, u, v] = sobol_4d(index, seed);
        let (j, u) = sources.choose(u);
        let to = Footprint::new(tracer, patches, j);
        let (p, q) = (from.point(x, y), to.point(u, v));
        let path = q - p;
        let squared = path.length_squared();
        let (cos_p, cos_q) = (from.normal.dot(path), -to.normal.dot(path));
        if cos_p <= 0.0 || cos_q <= 0.0 {
            continue;
        }
        let kernel = cos_p * cos_q / (std::f32::consts::PI * squared * squared);
        if kernel > 0.0 && tracer.visible(Tracer::leave(p, from.normal), Tracer::leave(q, to.normal)) {
            links.push(Link { from: i as u32, to: j as u32, kernel, replicate, shadow: true });
        }
    }
}
