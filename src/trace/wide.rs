//! Tests of a ray against eight boxes or eight triangles at once: in plain Rust, and in AVX2 if the processor has it.
//!
//! Both do the same arithmetic in the same order, without fused operations. So both give the same bytes. NaN behaves as
//! in `minps` and `maxps`. This is the only file with unsafe code. An [`Avx2`] exists only if [`Kernel::detect`] found
//! the instructions. Its intrinsics need nothing else, except valid pointers, which point to whole arrays. A [`Stack`]
//! reads only entries that it has written.
#![allow(unsafe_code, reason = "wide instructions chosen at run time")]

#[cfg(target_arch = "x86_64")]
use std::arch::x86_64::*;
use std::mem::MaybeUninit;

use glam::Vec3A;

use super::{
    bvh::{Bvh, Leaf, Node, WIDTH},
    query::Query,
    watertight::{PreparedRay, SLACK},
};

/// Operations on all lanes.
pub(super) trait Lanes: Copy {
    /// The boxes that the ray enters before `limit`, one bit each, and the distances where it enters them: 0 if it
    /// starts inside.
    fn boxes(self, node: &Node, ray: &PreparedRay, limit: f32) -> (u32, [f32; WIDTH]);

    /// The triangles that the ray's line hits, one bit each, and their edge functions u, v, w.
    fn edges(self, leaf: &Leaf, ray: &PreparedRay) -> (u32, [[f32; WIDTH]; 3]);

    /// Fetches an item that will be read soon.
    fn prefetch<T>(self, items: &[T], index: usize);
}

/// The fastest operations of this processor.
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

    /// [`Bvh::ask`].
    #[inline]
    pub(super) fn ask<Q: Query>(self, bvh: &Bvh, origin: Vec3A, direction: Vec3A) -> Q::Answer {
        match self {
            Kernel::Portable => bvh.ask::<_, Q>(Portable, &PreparedRay::new(origin, direction)),
            // SAFETY: the processor has AVX2 and BMI1, or there would be no `Avx2`.
            #[cfg(target_arch = "x86_64")]
            Kernel::Avx2(lanes) => unsafe { ask_avx2::<Q>(lanes, bvh, origin, direction) },
        }
    }

    /// [`Bvh::ask_each`].
    #[inline]
    pub(super) fn ask_each<Q: Query, T>(
        self,
        bvh: &Bvh,
        rays: impl IntoIterator<Item = (T, Vec3A, Vec3A)>,
        answered: impl FnMut(T, Q::Answer),
    ) {
        match self {
            Kernel::Portable => bvh.ask_each::<_, Q, T>(Portable, rays, answered),
            // SAFETY: as above.
            #[cfg(target_arch = "x86_64")]
            Kernel::Avx2(lanes) => unsafe { ask_each_avx2::<Q, T>(lanes, bvh, rays, answered) },
        }
    }
}

// The ray is prepared here and not passed by reference. Fields written one by one and read back as a vector cannot be
// forwarded from the writes, and two successive rays would hardly overlap (docs/performance.md).
#[cfg(target_arch = "x86_64")]
#[target_feature(enable = "avx2,bmi1")]
fn ask_avx2<Q: Query>(lanes: Avx2, bvh: &Bvh, origin: Vec3A, direction: Vec3A) -> Q::Answer {
    bvh.ask::<_, Q>(lanes, &PreparedRay::new(origin, direction))
}

#[cfg(target_arch = "x86_64")]
#[target_feature(enable = "avx2,bmi1")]
fn ask_each_avx2<Q: Query, T>(
    lanes: Avx2,
    bvh: &Bvh,
    rays: impl IntoIterator<Item = (T, Vec3A, Vec3A)>,
    answered: impl FnMut(T, Q::Answer),
) {
    bvh.ask_each::<_, Q, T>(lanes, rays, answered);
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
        let mut exit = [f32::INFINITY; WIDTH];
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
            entered |= u32::from(entry[lane] <= min(exit[lane] * SLACK, limit)) << lane;
        }
        (entered, entry)
    }

    #[inline(always)]
    fn edges(self, leaf: &Leaf, ray: &PreparedRay) -> (u32, [[f32; WIDTH]; 3]) {
        let [kx, ky, kz] = ray.axes;
        let (mut x, mut y) = ([0.0; WIDTH], [0.0; WIDTH]);
        for vertex in 0..WIDTH {
            let [px, py, pz] = ray.turned_origin;
            let z = leaf.vertices[kz][vertex] - pz;
            x[vertex] = (leaf.vertices[kx][vertex] - px) - ray.shear[0] * z;
            y[vertex] = (leaf.vertices[ky][vertex] - py) - ray.shear[1] * z;
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

/// AVX2. A value proves that the processor has it.
#[cfg(target_arch = "x86_64")]
#[derive(Clone, Copy, Debug)]
pub(super) struct Avx2(());

// Macros, because closures and `array::map` would be functions without AVX2 if they are not inlined.
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
            let mut exit = _mm256_set1_ps(f32::INFINITY);
            for axis in 0..3 {
                entry = _mm256_max_ps(distance!(axis, ray.backward[axis]), entry);
                exit = _mm256_min_ps(distance!(axis, !ray.backward[axis]), exit);
            }
            let exit = _mm256_min_ps(_mm256_mul_ps(exit, _mm256_set1_ps(SLACK)), _mm256_set1_ps(limit));
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
                ($axis:literal) => {
                    _mm256_sub_ps(
                        _mm256_loadu_ps(leaf.vertices[ray.axes[$axis]].as_ptr()),
                        _mm256_set1_ps(ray.turned_origin[$axis]),
                    )
                };
            }
            let z = along!(2);
            let x = _mm256_sub_ps(along!(0), _mm256_mul_ps(_mm256_set1_ps(ray.shear[0]), z));
            let y = _mm256_sub_ps(along!(1), _mm256_mul_ps(_mm256_set1_ps(ray.shear[1]), z));
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

/// Children yet to visit: distance in the upper half, index in the lower half. Unused entries are not initialised.
pub(super) struct Stack<'a> {
    /// Entries below `height` are initialised.
    entries: &'a mut [MaybeUninit<u64>],
    height: usize,
}

impl<'a> Stack<'a> {
    pub(super) fn new(entries: &'a mut [MaybeUninit<u64>]) -> Self {
        Stack { entries, height: 0 }
    }

    #[inline(always)]
    pub(super) fn height(&self) -> usize {
        self.height
    }

    /// Inserts an entry among the entries above `below`, which stay in descending order.
    #[inline(always)]
    pub(super) fn insert(&mut self, below: usize, entry: u64) {
        let mut at = self.height;
        while at > below {
            // SAFETY: at - 1 is below the height.
            let under = unsafe { self.entries[at - 1].assume_init() };
            if under >= entry {
                break;
            }
            self.entries[at].write(under);
            at -= 1;
        }
        self.entries[at].write(entry);
        self.height += 1;
    }

    #[inline(always)]
    pub(super) fn pop(&mut self) -> Option<u64> {
        self.height = self.height.checked_sub(1)?;
        // SAFETY: it was below the height.
        Some(unsafe { self.entries[self.height].assume_init() })
    }
}

#[cfg(test)]
pub(super) mod tests {
    use glam::{DVec3, dvec3, vec3a};

    use super::*;
    use crate::{
        scene::{Material, Scene},
        trace::{
            Tracer, UnitTriangle,
            query::{Free, Nearest},
            sampling::mix,
            watertight::Met,
        },
    };

    /// Numbers in \[-1, 1), the same each time.
    pub(in super::super) struct Random(pub(in super::super) u64);

    impl Random {
        fn bits(&mut self) -> u64 {
            self.0 += 1;
            mix(&[self.0])
        }

        fn next(&mut self) -> f64 {
            self.bits() as f64 / 2f64.powi(63) - 1.0
        }

        pub(in super::super) fn point(&mut self) -> DVec3 {
            dvec3(self.next(), self.next(), self.next())
        }

        /// Ordinary numbers and special values.
        fn odd(&mut self) -> f32 {
            const ODD: [f32; 12] = [
                0.0,
                -0.0,
                1.0,
                -1.0,
                f32::INFINITY,
                f32::NEG_INFINITY,
                f32::NAN,
                f32::MIN_POSITIVE,
                -1e-45,
                f32::MAX,
                1e-20,
                -3e30,
            ];
            if self.bits().is_multiple_of(4) {
                ODD[self.bits() as usize % ODD.len()]
            } else {
                self.next() as f32
            }
        }

        pub(in super::super) fn odd_vector(&mut self) -> Vec3A {
            vec3a(self.odd(), self.odd(), self.odd())
        }
    }

    /// Bits, with all NaNs equal: it is not specified which of their bits survive.
    fn bits<const N: usize>(values: [f32; N]) -> [u32; N] {
        values.map(|x| if x.is_nan() { f32::NAN } else { x }.to_bits())
    }

    #[cfg(target_arch = "x86_64")]
    fn avx2() -> Option<Avx2> {
        match Kernel::detect() {
            Kernel::Avx2(lanes) => Some(lanes),
            Kernel::Portable => None,
        }
    }

    const ROUNDS: usize = if cfg!(miri) { 100 } else { 100_000 };

    #[cfg(target_arch = "x86_64")]
    #[test]
    fn wide_boxes_are_plain_boxes() {
        let Some(lanes) = avx2() else { return };
        let mut random = Random(1);
        let mut entered_any = 0;
        for _ in 0..ROUNDS {
            let mut node = Node::EMPTY;
            for bound in node.bounds.as_flattened_mut().as_flattened_mut() {
                *bound = random.odd();
            }
            let ray = PreparedRay::new(random.odd_vector(), random.odd_vector());
            let limit = random.odd();
            let (wide, plain) = (lanes.boxes(&node, &ray, limit), Portable.boxes(&node, &ray, limit));
            assert_eq!(wide.0, plain.0);
            assert_eq!(bits(wide.1), bits(plain.1));
            entered_any += usize::from(wide.0 != 0);
        }
        assert!(entered_any > ROUNDS / 100, "{entered_any} of {ROUNDS}");
    }

    #[cfg(target_arch = "x86_64")]
    #[test]
    fn wide_triangles_are_plain_triangles() {
        let Some(lanes) = avx2() else { return };
        let mut random = Random(2);
        let mut inside_any = 0;
        for _ in 0..ROUNDS {
            let mut leaf = Leaf::new(&[], &[]);
            for coordinate in leaf.vertices.as_flattened_mut() {
                *coordinate = random.odd();
            }
            for corner in leaf.corners.as_flattened_mut() {
                *corner = (random.bits() % 8) as u8;
            }
            let ray = PreparedRay::new(random.odd_vector(), random.odd_vector());
            let (wide, plain) = (lanes.edges(&leaf, &ray), Portable.edges(&leaf, &ray));
            assert_eq!(wide.0, plain.0);
            assert_eq!(wide.1.map(bits), plain.1.map(bits));
            inside_any += usize::from(wide.0 != 0);
        }
        assert!(inside_any > ROUNDS / 100, "{inside_any} of {ROUNDS}");
    }

    /// Triangles of all sizes, slivers, coincident triangles, and needles as long as the scene.
    pub(in super::super) fn soup(count: usize, random: &mut Random) -> Vec<([DVec3; 3], u32)> {
        let mut triangles = Vec::new();
        while triangles.len() < count {
            let a = random.point();
            let size = 10f64.powf(-1.5 + 1.5 * random.next());
            let (b, c) = (a + random.point() * size, a + random.point() * size);
            match random.bits() % 4 {
                0 => triangles.push(([a, b, b + (c - b) * 1e-5], 0)),
                1 => triangles.extend([([a, b, c], 0), ([a, c, b], 0), ([b, c, a], 0)]),
                2 => triangles.extend([([a, b, c], 0), ([c, b, b + c - a], 0)]),
                _ => triangles.push(([a, random.point(), c], 0)),
            }
        }
        triangles
    }

    pub(in super::super) fn tracer(triangles: &[([DVec3; 3], u32)]) -> Tracer {
        Tracer::new(&Scene::new(triangles, vec![Material::new("black", [0.0; 3], [0.0; 3])]))
    }

    #[test]
    fn wide_rays_are_plain_rays() {
        for count in [0, 1, 2, 9, 300, 5000] {
            let mut random = Random(count as u64);
            let wide = tracer(&soup(if cfg!(miri) { count.min(9) } else { count }, &mut random));
            let rays = ROUNDS / 10;
            for i in 0..rays {
                let (from, to) = if i % 4 == 0 {
                    (random.odd_vector(), random.odd_vector())
                } else {
                    (random.point().as_vec3a(), random.point().as_vec3a())
                };
                let hit = |kernel: Kernel| {
                    let met = kernel.ask::<Nearest>(&wide.bvh, from, to - from)?;
                    Some((met.triangle, met.front(), met.t.to_bits(), bits(met.barycentric())))
                };
                assert_eq!(hit(Kernel::detect()), hit(Kernel::Portable), "{count} {from} {to}");
                let free = |kernel: Kernel| kernel.ask::<Free>(&wide.bvh, from, to - from);
                assert_eq!(free(Kernel::detect()), free(Kernel::Portable), "{count} {from} {to}");
            }
        }
    }

    /// Tests every triangle in turn, each in a leaf of its own.
    fn closest_of_all(triangles: &[UnitTriangle], ray: &PreparedRay) -> Option<Met> {
        let mut nearest = Nearest::default();
        for (t, triangle) in triangles.iter().enumerate() {
            let (inside, edges) = Portable.edges(&Leaf::new(&[t as u32], triangles), ray);
            if inside & 1 != 0 {
                let edges = [edges[0][0], edges[1][0], edges[2][0]];
                if let Some(met) = ray.meet(t as u32, (triangle.corners[0], triangle.normal), edges) {
                    nearest.meet(met);
                }
            }
        }
        nearest.answer(|met| {
            let triangle = &triangles[met.triangle as usize];
            met.rounding(ray.reach(triangle.corners[0], triangle.normal))
        })
    }

    #[test]
    fn the_hierarchy_loses_nothing() {
        let mut random = Random(7);
        let tracer = tracer(&soup(if cfg!(miri) { 9 } else { 300 }, &mut random));
        let mut met = 0;
        for _ in 0..ROUNDS / 5 {
            let (from, to) = (random.point().as_vec3a(), random.point().as_vec3a());
            let all = closest_of_all(tracer.triangles(), &PreparedRay::new(from, to - from));
            let found = tracer.closest(from, to - from);
            let known = all.map(|met| (met.triangle, met.front(), met.t));
            assert_eq!(found.map(|hit| (hit.triangle, hit.front, hit.t)), known, "{from} {to}");
            met += usize::from(found.is_some());
        }
        assert!(met > ROUNDS / 20 || cfg!(miri), "{met}");
    }
}
