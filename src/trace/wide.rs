//! Eight boxes or eight triangles at once: in plain Rust, and in AVX2 where the processor has it.
//!
//! Both do the same arithmetic in the same order, never fused, so that both give the same bytes; `minps` and `maxps`
//! decide what becomes of NaN. This is the one file with unsafe code. An [`Avx2`] exists only where [`Kernel::detect`]
//! found the instructions: that is all that its intrinsics ask for, but for the pointers they read and write, which
//! are those of whole arrays.
#![allow(unsafe_code, reason = "wide instructions chosen at run time")]

#[cfg(target_arch = "x86_64")]
use std::arch::x86_64::*;

use super::{
    bvh::{Bvh, Leaf, Node, WIDTH},
    watertight::{Met, PreparedRay},
};

/// How to work on all lanes.
pub(super) trait Lanes: Copy {
    /// Which boxes the ray meets no farther than `limit`, one bit each, and where it enters them: 0 inside.
    fn boxes(self, node: &Node, ray: &PreparedRay, limit: f32) -> (u32, [f32; WIDTH]);

    /// Which triangles the ray's line meets, one bit each, and their edge functions u, v, w.
    fn edges(self, leaf: &Leaf, ray: &PreparedRay) -> (u32, [[f32; WIDTH]; 3]);

    /// Says that an item will be read soon.
    fn prefetch<T>(self, items: &[T], index: usize);
}

/// The fastest way that this processor has.
#[derive(Clone, Copy, Debug)]
pub(super) enum Kernel {
    Portable,
    #[cfg(target_arch = "x86_64")]
    Avx2(Avx2),
}

impl Kernel {
    pub(super) fn detect() -> Kernel {
        #[cfg(target_arch = "x86_64")]
        if is_x86_feature_detected!("avx2") && is_x86_feature_detected!("bmi1") {
            return Kernel::Avx2(Avx2(()));
        }
        Kernel::Portable
    }

    /// [`Bvh::closest`].
    #[inline]
    pub(super) fn closest(self, bvh: &Bvh, ray: &PreparedRay) -> Option<(u32, Met)> {
        match self {
            Kernel::Portable => bvh.closest(Portable, ray),
            // SAFETY: the processor has AVX2 and BMI1, or there would be no `Avx2`.
            #[cfg(target_arch = "x86_64")]
            Kernel::Avx2(lanes) => unsafe { closest_avx2(lanes, bvh, ray) },
        }
    }

    /// [`Bvh::is_free`].
    #[inline]
    pub(super) fn is_free(self, bvh: &Bvh, ray: &PreparedRay) -> bool {
        match self {
            Kernel::Portable => bvh.is_free(Portable, ray),
            // SAFETY: as above.
            #[cfg(target_arch = "x86_64")]
            Kernel::Avx2(lanes) => unsafe { is_free_avx2(lanes, bvh, ray) },
        }
    }
}

#[cfg(target_arch = "x86_64")]
#[target_feature(enable = "avx2,bmi1")]
fn closest_avx2(lanes: Avx2, bvh: &Bvh, ray: &PreparedRay) -> Option<(u32, Met)> {
    bvh.closest(lanes, ray)
}

#[cfg(target_arch = "x86_64")]
#[target_feature(enable = "avx2,bmi1")]
fn is_free_avx2(lanes: Avx2, bvh: &Bvh, ray: &PreparedRay) -> bool {
    bvh.is_free(lanes, ray)
}

/// Plain Rust.
#[derive(Clone, Copy)]
pub(super) struct Portable;

/// What `minps` does.
#[inline(always)]
fn min(a: f32, b: f32) -> f32 {
    if a < b { a } else { b }
}

/// What `maxps` does.
#[inline(always)]
fn max(a: f32, b: f32) -> f32 {
    if a > b { a } else { b }
}

impl Lanes for Portable {
    #[inline(always)]
    fn boxes(self, node: &Node, ray: &PreparedRay, limit: f32) -> (u32, [f32; WIDTH]) {
        let mut entry = [0.0; WIDTH];
        let mut exit = [limit; WIDTH];
        for axis in 0..3 {
            let near = &node.bounds[axis][usize::from(ray.backward[axis])];
            let far = &node.bounds[axis][usize::from(!ray.backward[axis])];
            for lane in 0..WIDTH {
                entry[lane] = max((near[lane] - ray.origin[axis]) * ray.inverse[axis], entry[lane]);
                exit[lane] = min((far[lane] - ray.origin[axis]) * ray.inverse[axis], exit[lane]);
            }
        }
        let mut entered = 0;
        for lane in 0..WIDTH {
            entered |= u32::from(entry[lane] <= exit[lane]) << lane;
        }
        (entered, entry)
    }

    #[inline(always)]
    fn edges(self, leaf: &Leaf, ray: &PreparedRay) -> (u32, [[f32; WIDTH]; 3]) {
        let [kx, ky, kz] = ray.axes;
        let (mut x, mut y) = ([0.0; WIDTH], [0.0; WIDTH]);
        for vertex in 0..WIDTH {
            let along = |axis: usize| leaf.vertices[axis][vertex] - ray.origin[axis];
            x[vertex] = along(kx) - ray.shear[0] * along(kz);
            y[vertex] = along(ky) - ray.shear[1] * along(kz);
        }
        let mut edges = [[0.0; WIDTH]; 3];
        let mut inside = 0;
        for lane in 0..WIDTH {
            let vertex = |corner: usize| leaf.corners[corner][lane] as usize % WIDTH;
            let (a, b, c) = (vertex(0), vertex(1), vertex(2));
            let u = x[c] * y[b] - y[c] * x[b];
            let v = x[a] * y[c] - y[a] * x[c];
            let w = x[b] * y[a] - y[b] * x[a];
            let outside = min(min(u, v), w) < 0.0 && max(max(u, v), w) > 0.0;
            let flat = u + v + w == 0.0;
            inside |= u32::from(!outside && !flat) << lane;
            (edges[0][lane], edges[1][lane], edges[2][lane]) = (u, v, w);
        }
        (inside, edges)
    }

    #[inline(always)]
    fn prefetch<T>(self, _: &[T], _: usize) {}
}

/// AVX2; proof that the processor has it.
#[cfg(target_arch = "x86_64")]
#[derive(Clone, Copy, Debug)]
pub(super) struct Avx2(());

// Closures and `array::map` would be functions of their own without AVX2 where they are not inlined: macros instead.
#[cfg(target_arch = "x86_64")]
impl Lanes for Avx2 {
    #[inline(always)]
    fn boxes(self, node: &Node, ray: &PreparedRay, limit: f32) -> (u32, [f32; WIDTH]) {
        // SAFETY: the processor has AVX2; arrays of eight are read and written whole.
        unsafe {
            macro_rules! distance {
                ($axis:expr, $high:expr) => {{
                    let bounds = _mm256_loadu_ps(node.bounds[$axis][usize::from($high)].as_ptr());
                    let offset = _mm256_sub_ps(bounds, _mm256_set1_ps(ray.origin[$axis]));
                    _mm256_mul_ps(offset, _mm256_set1_ps(ray.inverse[$axis]))
                }};
            }
            let mut entry = _mm256_setzero_ps();
            let mut exit = _mm256_set1_ps(limit);
            for axis in 0..3 {
                entry = _mm256_max_ps(distance!(axis, ray.backward[axis]), entry);
                exit = _mm256_min_ps(distance!(axis, !ray.backward[axis]), exit);
            }
            let entered = _mm256_movemask_ps(_mm256_cmp_ps::<_CMP_LE_OQ>(entry, exit)) as u32;
            let mut entries = [0.0; WIDTH];
            _mm256_storeu_ps(entries.as_mut_ptr(), entry);
            (entered, entries)
        }
    }

    #[inline(always)]
    fn edges(self, leaf: &Leaf, ray: &PreparedRay) -> (u32, [[f32; WIDTH]; 3]) {
        // SAFETY: as above; the corners are eight bytes. A permutation looks at three bits of every index.
        unsafe {
            macro_rules! along {
                ($axis:expr) => {
                    _mm256_sub_ps(
                        _mm256_loadu_ps(leaf.vertices[$axis].as_ptr()),
                        _mm256_set1_ps(ray.origin[$axis]),
                    )
                };
            }
            let [kx, ky, kz] = ray.axes;
            let z = along!(kz);
            let x = _mm256_sub_ps(along!(kx), _mm256_mul_ps(_mm256_set1_ps(ray.shear[0]), z));
            let y = _mm256_sub_ps(along!(ky), _mm256_mul_ps(_mm256_set1_ps(ray.shear[1]), z));
            macro_rules! corner {
                ($corner:literal) => {{
                    let vertices =
                        _mm256_cvtepu8_epi32(_mm_loadl_epi64(leaf.corners[$corner].as_ptr().cast()));
                    (_mm256_permutevar8x32_ps(x, vertices), _mm256_permutevar8x32_ps(y, vertices))
                }};
            }
            let ((ax, ay), (bx, by), (cx, cy)) = (corner!(0), corner!(1), corner!(2));
            let u = _mm256_sub_ps(_mm256_mul_ps(cx, by), _mm256_mul_ps(cy, bx));
            let v = _mm256_sub_ps(_mm256_mul_ps(ax, cy), _mm256_mul_ps(ay, cx));
            let w = _mm256_sub_ps(_mm256_mul_ps(bx, ay), _mm256_mul_ps(by, ax));
            let zero = _mm256_setzero_ps();
            let below = _mm256_cmp_ps::<_CMP_LT_OQ>(_mm256_min_ps(_mm256_min_ps(u, v), w), zero);
            let above = _mm256_cmp_ps::<_CMP_GT_OQ>(_mm256_max_ps(_mm256_max_ps(u, v), w), zero);
            let flat = _mm256_cmp_ps::<_CMP_EQ_OQ>(_mm256_add_ps(_mm256_add_ps(u, v), w), zero);
            let missed = _mm256_or_ps(_mm256_and_ps(below, above), flat);
            let mut edges = [[0.0; WIDTH]; 3];
            _mm256_storeu_ps(edges[0].as_mut_ptr(), u);
            _mm256_storeu_ps(edges[1].as_mut_ptr(), v);
            _mm256_storeu_ps(edges[2].as_mut_ptr(), w);
            (!_mm256_movemask_ps(missed) as u32 & 0xff, edges)
        }
    }

    #[inline(always)]
    fn prefetch<T>(self, items: &[T], index: usize) {
        let item = items.as_ptr().wrapping_add(index).cast::<i8>();
        for line in 0..size_of::<T>().div_ceil(64) {
            // SAFETY: a prefetch reads nothing and may be given any address.
            unsafe { _mm_prefetch::<_MM_HINT_T0>(item.wrapping_add(64 * line)) };
        }
    }
}
