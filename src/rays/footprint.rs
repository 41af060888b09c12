//! Starting points and directions of rays from a patch.

use std::ops::Range;

use glam::Vec3A;

use crate::{
    patch::Patches,
    trace::{
        Side, Tracer,
        sampling::{cosine_hemisphere, square_to_triangle, tangents},
        sobol::{LANES, Sobol, blocks},
    },
};

/// The part of a patch from which rays start: its corners, inset from the triangle's edges, and its side, in unit
/// space.
#[derive(Debug, Clone)]
pub(crate) struct Footprint {
    pub(crate) corners: [Vec3A; 3],
    pub(crate) side: Side,
}

/// A ray from a point of a patch in a cosine-distributed direction.
#[derive(Debug, Clone, Copy)]
pub(crate) struct HemisphereRay {
    /// Index in the sequence.
    pub(crate) index: u32,
    pub(crate) origin: Vec3A,
    pub(crate) direction: Vec3A,
}

impl Footprint {
    /// The footprint of patch `i`.
    pub(crate) fn new(tracer: &Tracer, patches: &Patches, i: usize) -> Footprint {
        let triangle = &tracer.triangles()[patches.triangle(i)];
        Footprint {
            corners: patches.barycentric_corners(i).map(|b| triangle.point(b.map(|x| x as f32))),
            side: triangle.side(patches.is_front(i)),
        }
    }

    /// The unit normal.
    #[inline]
    pub(crate) fn normal(&self) -> Vec3A {
        self.side.normal
    }

    /// The point with these barycentric coordinates.
    #[inline]
    pub(crate) fn at(&self, b: [f32; 3]) -> Vec3A {
        self.corners[0] * b[0] + self.corners[1] * b[1] + self.corners[2] * b[2]
    }

    /// The hemisphere rays of a sequence with these indices.
    pub(crate) fn hemisphere_rays(
        &self,
        indices: Range<u32>,
        seed: u64,
    ) -> impl Iterator<Item = HemisphereRay> + '_ {
        let (sobol, [tangent, bitangent]) = (Sobol::new(seed), tangents(self.normal()));
        blocks(indices).flat_map(move |(first, lanes)| {
            // The first two dimensions are stratified better and choose the direction.
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
                self.side.leave_along(at, axis);
            }
            lanes.map(move |lane| {
                let [x, y, cosine] = lifted[lane];
                HemisphereRay {
                    index: first + lane as u32,
                    origin: Vec3A::new(at[0][lane], at[1][lane], at[2][lane]),
                    direction: tangent * x + bitangent * y + self.normal() * cosine,
                }
            })
        })
    }
}

/// cos θ cos θ' / (π r²) for a path between two points with these unit normals, which must face each other.
#[inline]
pub(crate) fn kernel(path: Vec3A, from: Vec3A, to: Vec3A) -> f32 {
    let squared = path.length_squared();
    path.dot(from) * -path.dot(to) / (std::f32::consts::PI * squared * squared)
}

/// Whether another face lies on the middle of patch `i` and faces the same way.
pub(crate) fn is_hidden(tracer: &Tracer, patches: &Patches, i: usize) -> bool {
    let Footprint { corners, side } = Footprint::new(tracer, patches, i);
    let middle = (corners[0] + corners[1] + corners[2]) / 3.0;
    // Rays begin beyond a face that is nearer than this.
    let same_place = 4.0 * side.clearance();
    tracer.closest(side.leave(middle), -side.normal).is_some_and(|hit| {
        hit.front == patches.is_front(i)
            && hit.t <= same_place
            && hit.triangle as usize != patches.triangle(i)
    })
}
