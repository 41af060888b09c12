//! Gaps that single precision resolves badly, or not at all.

use glam::DVec3;
use rayon::prelude::*;

use super::{Tracer, UnitTriangle};
use crate::{
    Error, Result,
    scene::{Scene, longest_edge},
};

/// Faces whose planes meet at less than this cosine bound no gap.
const PARALLEL: f64 = 0.5;
/// A gap narrower than this share of the smaller face lets so little light through that only what the two faces emit matters.
const NARROW: f64 = 1e-3;
/// Rounding leaves gaps between faces that touch: gaps narrower than both this share of the scene's size and this share of the smaller
/// face.
const TOUCHING: (f64, f64) = (1e-7, 1e-5);
/// Rays begin and end off their surfaces by less than this share of a wide gap.
const WIDE: f64 = 0.02;
/// Points of a face above which another one is looked for.
const POINTS: [[f64; 3]; 4] = [[1.0 / 3.0; 3], [0.8, 0.1, 0.1], [0.1, 0.8, 0.1], [0.1, 0.1, 0.8]];

/// A gap between two faces that is narrow beside the distance by which rays begin off their surfaces.
#[derive(Debug, Clone, Copy, PartialEq)]
#[non_exhaustive]
pub struct Gap {
    /// The two faces, indices into [`Scene::triangles`].
    pub triangles: [u32; 2],
    /// How far apart they are, in the file's unit.
    pub width: f64,
    /// The narrowest gap that rays would pass through there.
    pub resolved: f64,
}

impl Gap {
    /// The share of its width that the gap loses for rays.
    pub fn share(&self) -> f64 {
        self.resolved / self.width
    }
}

impl Tracer {
    /// The gap that rays resolve worst, if one seems narrower to them by some per cent. Gaps that hardly matter do not count.
    ///
    /// # Errors
    /// [`Error::UnresolvedGap`] if rays would begin or end on its wrong side.
    pub fn check_gaps(&self, scene: &Scene) -> Result<Option<Gap>> {
        let clearances = self.triangles().par_iter().map(|t| t.side(true).clearance());
        let highest = clearances.reduce(|| 0.0, f32::max);
        let of = |t: usize| POINTS.into_iter().flat_map(move |at| self.gaps(scene, t, at, highest));
        let gaps: Vec<Gap> = (0..scene.triangles.len()).into_par_iter().flat_map_iter(of).collect();
        let worst = gaps.into_iter().max_by(|a, b| a.share().total_cmp(&b.share()));
        match worst {
            Some(Gap { triangles, width, resolved }) if width < resolved => {
                Err(Error::UnresolvedGap { triangles, width, resolved })
            }
            gap => Ok(gap),
        }
    }

    /// Narrow gaps before the front of a triangle at a point of it. `highest` is the largest clearance of any side.
    fn gaps(&self, scene: &Scene, t: usize, at: [f64; 3], highest: f32) -> impl Iterator<Item = Gap> {
        let side = self.triangles()[t].side(true);
        let point = self.triangles()[t].point(at.map(|b| b as f32));
        let origin = side.leave(point);
        // Rays do not meet a face that is closer than both clearances, but from farther up they do.
        let close = self.closest(point + side.normal * (4.0 * highest), -side.normal);
        let far = point + side.normal * (highest / WIDE as f32);
        let beyond = if self.visible(origin, far) { None } else { self.closest(origin, side.normal) };
        let other =
            [close, beyond].map(|hit| hit.and_then(|hit| self.gap(scene, t, at, hit.triangle as usize)));
        other.into_iter().flatten()
    }

    /// The gap between two triangles at a point of the first, if it is narrow and matters.
    fn gap(&self, scene: &Scene, t: usize, at: [f64; 3], met: usize) -> Option<Gap> {
        let vertices = scene.triangles[t].vertices;
        if met == t || scene.triangles[met].vertices.iter().any(|v| vertices.contains(v)) {
            return None;
        }
        let (corners, others) = (scene.corners(t), scene.corners(met));
        let point: DVec3 = (0..3).map(|k| corners[k] * at[k]).sum();
        let (normal, other) = (scene.normal(t), scene.normal(met));
        let cosine = normal.dot(other).abs();
        if cosine < PARALLEL {
            return None;
        }
        let width = other.dot(others[0] - point) / other.dot(normal);
        let clearance = |of: &UnitTriangle| f64::from(of.side(true).clearance()) * self.scale();
        let resolved = clearance(&self.triangles()[t]) + clearance(&self.triangles()[met]) / cosine;
        let smaller = longest_edge(corners).min(longest_edge(others));
        let matters = width > NARROW * smaller || scene.emits(t) || scene.emits(met);
        let touches = width <= (TOUCHING.0 * 2.0 * self.scale()).min(TOUCHING.1 * smaller);
        let gap = Gap { triangles: [t as u32, met as u32], width, resolved };
        (matters && !touches && gap.share() > WIDE).then_some(gap)
    }
}
