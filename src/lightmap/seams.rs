//! Seams: edges of the surface that lie at two places of the map.
//!
//! Bilinear samples along such an edge differ between its two sides, because of noise and the positions of the texels.
//! A least-squares fit makes them agree while every texel stays close to its value. Texels that hold surface are kept
//! closer to their values than texels without (after Iwanicki, "Lighting Technology of The Last of Us", SIGGRAPH 2013
//! talks). Creases are not seams, because the light differs across them.

use std::collections::HashMap;

use glam::DVec2;

use super::{
    atlas::{Atlas, CREASE, NONE},
    bilinear,
};
use crate::{output::surfaces::smooth_edges, scene::Scene};

/// Samples along a seam per texel of its longer image.
const SAMPLES: f64 = 2.0;
/// Weight of the squared change of a texel that holds surface. The weight of a squared difference across the seam is 1.
const INSIDE: f64 = 0.05;
/// Weight of the squared change of a texel without surface.
const OUTSIDE: f64 = 0.005;
const MOST_ITERATIONS: usize = 200;
const TOLERANCE: f64 = 1e-6;

/// A point of a seam: the texels of the bilinear samples at its two images, with their weights. The weights of the
/// second image are negative.
type Sample = [(u32, f64); 8];

/// The points where seams are sampled.
#[derive(Debug, Clone, Default)]
pub struct Seams {
    samples: Vec<Sample>,
}

impl Seams {
    /// Finds the edges across which the surface is smooth but the map is not. `shown` has for each chart whether it holds
    /// light: a dark chart inside a solid may border on a lit one.
    pub fn new(scene: &Scene, atlas: &Atlas, sides: &[bool], shown: &[bool]) -> Seams {
        let mut samples = Vec::new();
        for [e, f] in smooth_edges(scene, CREASE) {
            let (t, u) = (e as usize / 3, f as usize / 3);
            let is_shown = |t: usize| atlas.chart[t] != NONE && shown[atlas.chart[t] as usize];
            if !is_shown(t) || !is_shown(u) || sides[t] != sides[u] {
                continue;
            }
            // The edge runs from corner k to the next one. On the other triangle it has the opposite direction.
            let ends = |slot: u32, reversed: bool| {
                let (t, k) = (slot as usize / 3, slot as usize % 3);
                let [from, to] = if reversed { [(k + 1) % 3, k] } else { [k, (k + 1) % 3] };
                (atlas.corners[t][from], atlas.corners[t][to])
            };
            let (here, there) = (ends(e, false), ends(f, true));
            if here != there {
                let images = [(t, here), (u, there)].map(|(t, (a, b))| Image::new(atlas, t, a, b));
                sample(atlas, &images, &mut samples);
            }
        }
        Seams { samples }
    }

    /// Number of sample points.
    pub fn points(&self) -> usize {
        self.samples.len()
    }

    /// Root mean square of the differences across seams, per channel.
    pub fn difference(&self, values: &[[f32; 3]]) -> [f64; 3] {
        let square = |c: usize| {
            self.samples.iter().map(|s| across(s, |at| f64::from(values[at][c])).powi(2)).sum::<f64>()
        };
        std::array::from_fn(|c| (square(c) / self.samples.len().max(1) as f64).sqrt())
    }

    /// Closes the seams in place: minimises Σ (difference across)² + Σ weight (change)² by conjugate gradients.
    pub fn close(&self, values: &mut [[f32; 3]], holds_surface: impl Fn(usize) -> bool) {
        let (places, samples) = self.numbered();
        let stay: Vec<f64> =
            places.iter().map(|&at| if holds_surface(at as usize) { INSIDE } else { OUTSIDE }).collect();
        for c in 0..3 {
            let start: Vec<f64> = places.iter().map(|&at| f64::from(values[at as usize][c])).collect();
            let change = change(&samples, &stay, &start);
            for (k, &at) in places.iter().enumerate() {
                values[at as usize][c] = (start[k] + change[k]).max(0.0) as f32;
            }
        }
    }

    /// The texels that the samples read, without duplicates, and the samples with indices into this list.
    fn numbered(&self) -> (Vec<u32>, Vec<Sample>) {
        let (mut places, mut number) = (Vec::new(), HashMap::new());
        let samples = self
            .samples
            .iter()
            .map(|sample| {
                sample.map(|(at, weight)| {
                    let k = *number.entry(at).or_insert_with(|| {
                        places.push(at);
                        places.len() as u32 - 1
                    });
                    (k, weight)
                })
            })
            .collect();
        (places, samples)
    }
}

/// The image of an edge in the map, in texels.
struct Image {
    page: usize,
    from: DVec2,
    to: DVec2,
}

impl Image {
    fn new(atlas: &Atlas, t: usize, from: u32, to: u32) -> Image {
        let size = DVec2::new(atlas.width as f64, atlas.height as f64);
        let [from, to] = [from, to].map(|i| atlas.coordinates[i as usize] * size);
        Image { page: atlas.page[t] as usize, from, to }
    }
}

fn sample(atlas: &Atlas, images: &[Image; 2], samples: &mut Vec<Sample>) {
    let length = images.iter().map(|i| (i.to - i.from).length()).fold(0.0, f64::max);
    let n = (SAMPLES * length).ceil().max(1.0) as usize;
    for k in 0..n {
        let along = (k as f64 + 0.5) / n as f64;
        let [here, there] = images.each_ref().map(|i| bilinear(atlas, i.page, i.from.lerp(i.to, along)));
        let mut sample = [(0, 0.0); 8];
        sample[..4].copy_from_slice(&here);
        for (slot, (at, weight)) in sample[4..].iter_mut().zip(there) {
            *slot = (at, -weight);
        }
        samples.push(sample);
    }
}

fn across(sample: &Sample, value: impl Fn(usize) -> f64) -> f64 {
    sample.iter().map(|&(at, weight)| weight * value(at as usize)).sum()
}

/// The change d that minimises |S (start + d)|² + Σ stay d²: (SᵀS + stay) d = -SᵀS start.
fn change(samples: &[Sample], stay: &[f64], start: &[f64]) -> Vec<f64> {
    let product = |x: &[f64], weight: f64| {
        let mut out: Vec<f64> = x.iter().zip(stay).map(|(x, s)| weight * x * s).collect();
        for sample in samples {
            let difference = across(sample, |k| x[k]);
            for &(k, w) in sample {
                out[k as usize] += w * difference;
            }
        }
        out
    };
    let dot = |a: &[f64], b: &[f64]| a.iter().zip(b).map(|(a, b)| a * b).sum::<f64>();
    let mut d = vec![0.0; start.len()];
    let mut residual: Vec<f64> = product(start, 0.0).into_iter().map(|x| -x).collect();
    let mut direction = residual.clone();
    let mut squared = dot(&residual, &residual);
    let enough = TOLERANCE * TOLERANCE * squared;
    for _ in 0..MOST_ITERATIONS {
        if !(squared > enough) {
            break;
        }
        let image = product(&direction, 1.0);
        let step = squared / dot(&direction, &image);
        for k in 0..d.len() {
            d[k] += step * direction[k];
            residual[k] -= step * image[k];
        }
        let before = squared;
        squared = dot(&residual, &residual);
        for (p, r) in direction.iter_mut().zip(&residual) {
            *p = r + squared / before * *p;
        }
    }
    d
}
