//! The mean of a texture over a triangle, from a pyramid of means. A square inside the triangle costs one look-up.
//! Squares on its rim are split into four, down to texels.

use glam::DVec2;

use super::Texture;

/// A cell on the rim is split only if its side is larger than the triangle's extent divided by this number. A convex
/// curve crosses at most about four times this number of cells.
const CELLS_ACROSS: f64 = 512.0;

/// The lowest level that the pyramid stores. Its cells are 4 by 4 texels, so the pyramid takes a third of the memory of
/// the texels.
const FIRST_STORED: u32 = 2;

/// Means of squares with sides of 2^level texels. Squares on the right and lower rim of the image are cut off there.
#[derive(Debug, Clone, Default)]
pub(super) struct Pyramid {
    levels: Vec<Level>,
    /// The level at which the image is one cell.
    top: u32,
    mean: [f64; 3],
}

#[derive(Debug, Clone)]
struct Level {
    width: usize,
    means: Vec<[f32; 3]>,
}

impl Pyramid {
    pub(super) fn new(texture: &Texture) -> Pyramid {
        let (w, h) = texture.size();
        let top = w.max(h).next_power_of_two().trailing_zeros();
        let mut pyramid = Pyramid { levels: Vec::new(), top, mean: [0.0; 3] };
        for level in FIRST_STORED..=top {
            let (columns, rows) = (w.div_ceil(1 << level), h.div_ceil(1 << level));
            let means = (0..columns * rows)
                .map(|i| pyramid.gather(texture, level, i % columns, i / columns).map(|c| c as f32))
                .collect();
            pyramid.levels.push(Level { width: columns, means });
        }
        pyramid.mean = if top < FIRST_STORED {
            pyramid.gather(texture, top, 0, 0)
        } else {
            pyramid.cell(texture, top, 0, 0)
        };
        pyramid
    }

    /// The mean of cell `(i, j)` of a level that is stored.
    fn cell(&self, texture: &Texture, level: u32, i: usize, j: usize) -> [f64; 3] {
        match level {
            0 => texture.texel(i, j),
            1 => self.gather(texture, 1, i, j),
            _ => {
                let stored = &self.levels[(level - FIRST_STORED) as usize];
                stored.means[j * stored.width + i].map(f64::from)
            }
        }
    }

    /// The mean of cell `(i, j)` from the cells below it, weighted by their areas.
    fn gather(&self, texture: &Texture, level: u32, i: usize, j: usize) -> [f64; 3] {
        if level == 0 {
            return texture.texel(i, j);
        }
        let mut sum = Sum::default();
        for (x, y) in [(2 * i, 2 * j), (2 * i + 1, 2 * j), (2 * i, 2 * j + 1), (2 * i + 1, 2 * j + 1)] {
            let (low, high) = cell_bounds(texture, level - 1, x, y);
            if high.cmpgt(low).all() {
                let size = high - low;
                sum.add(size.x * size.y, self.cell(texture, level - 1, x, y));
            }
        }
        sum.mean()
    }
}

/// Corners of a cell in texels. Empty if the cell lies outside the image.
fn cell_bounds(texture: &Texture, level: u32, i: usize, j: usize) -> (DVec2, DVec2) {
    let (w, h) = texture.size();
    let bound = |i: usize, n: usize| (i << level).min(n) as f64;
    (DVec2::new(bound(i, w), bound(j, h)), DVec2::new(bound(i + 1, w), bound(j + 1, h)))
}

#[derive(Default)]
struct Sum {
    area: f64,
    value: [f64; 3],
}

impl Sum {
    fn add(&mut self, area: f64, value: [f64; 3]) {
        self.area += area;
        for (sum, v) in self.value.iter_mut().zip(value) {
            *sum += area * v;
        }
    }

    fn mean(&self) -> [f64; 3] {
        self.value.map(|v| v / self.area)
    }
}

/// A convex polygon. A triangle that is cut by the four sides of a cell has at most seven corners.
#[derive(Clone, Copy)]
struct Polygon {
    corners: [DVec2; 12],
    len: usize,
}

impl Polygon {
    fn push(&mut self, p: DVec2) {
        if self.len < self.corners.len() {
            self.corners[self.len] = p;
            self.len += 1;
        }
    }

    /// The part where `sign · (coordinate - cut)` is not negative.
    fn clip(&self, axis: usize, cut: f64, sign: f64) -> Polygon {
        let mut part = Polygon { corners: [DVec2::ZERO; 12], len: 0 };
        let side = |p: DVec2| sign * (p[axis] - cut);
        for i in 0..self.len {
            let (p, q) = (self.corners[i], self.corners[(i + 1) % self.len]);
            let (d, e) = (side(p), side(q));
            if d >= 0.0 {
                part.push(p);
            }
            if d * e < 0.0 {
                let mut crossing = p + (q - p) * (d / (d - e));
                crossing[axis] = cut;
                part.push(crossing);
            }
        }
        part
    }

    fn within(&self, low: DVec2, high: DVec2) -> Polygon {
        self.clip(0, low.x, 1.0).clip(0, high.x, -1.0).clip(1, low.y, 1.0).clip(1, high.y, -1.0)
    }

    fn area(&self) -> f64 {
        let origin = self.corners[0];
        let doubled: f64 =
            (2..self.len).map(|i| (self.corners[i - 1] - origin).perp_dot(self.corners[i] - origin)).sum();
        0.5 * doubled.abs()
    }

    fn moved(mut self, by: DVec2) -> Polygon {
        self.corners[..self.len].iter_mut().for_each(|p| *p += by);
        self
    }
}

/// The mean over the triangle `corners`, in texels. `None` if it has no area.
pub(super) fn over(texture: &Texture, clamp: bool, corners: [DVec2; 3]) -> Option<[f64; 3]> {
    let size = DVec2::new(texture.width as f64, texture.height as f64);
    let low = corners[0].min(corners[1]).min(corners[2]);
    let high = corners[0].max(corners[1]).max(corners[2]);
    if !(low.is_finite() && high.is_finite()) {
        return None;
    }
    // Whole repeats are subtracted, because large coordinates would only add rounding errors.
    let home = if clamp { DVec2::ZERO } else { (low / size).floor() * size };
    let mut triangle = Polygon { corners: [DVec2::ZERO; 12], len: 0 };
    corners.iter().for_each(|&c| triangle.push(c - home));
    let extent = (high - low).element_sum();
    if triangle.area() <= 1e-14 * extent * extent {
        return None;
    }
    let mut walk = Walk { texture, extent, sum: Sum::default() };
    if clamp {
        walk.rim(&triangle, size);
        walk.cell(&triangle.within(DVec2::ZERO, size), texture.pyramid.top, 0, 0);
    } else {
        let repeats = ((high - home) / size).max_element().ceil();
        walk.repeats(&triangle, size, DVec2::ZERO, repeats.log2().ceil().max(0.0));
    }
    (walk.sum.area > 0.0).then(|| walk.sum.mean())
}

struct Walk<'a> {
    texture: &'a Texture,
    extent: f64,
    sum: Sum,
}

impl Walk<'_> {
    /// Adds the part of a polygon in a square of 2^`level` by 2^`level` repeats, the first of them at `low`.
    fn repeats(&mut self, polygon: &Polygon, size: DVec2, low: DVec2, level: f64) {
        let area = polygon.area();
        if area <= 0.0 {
            return;
        }
        let side = size * level.exp2();
        if is_covered(area, side) || side.max_element() * CELLS_ACROSS <= self.extent {
            self.sum.add(area, self.texture.pyramid.mean);
        } else if level < 1.0 {
            self.cell(&polygon.moved(-low), self.texture.pyramid.top, 0, 0);
        } else {
            let middle = low + 0.5 * side;
            for (x, y) in [(0.0, 0.0), (1.0, 0.0), (0.0, 1.0), (1.0, 1.0)] {
                let corner = low + 0.5 * side * DVec2::new(x, y);
                let part = polygon.clip(0, middle.x, 2.0 * x - 1.0).clip(1, middle.y, 2.0 * y - 1.0);
                self.repeats(&part, size, corner, level - 1.0);
            }
        }
    }

    /// Adds the part of a polygon in cell `(i, j)` of the image.
    fn cell(&mut self, polygon: &Polygon, level: u32, i: usize, j: usize) {
        let area = polygon.area();
        let (low, high) = cell_bounds(self.texture, level, i, j);
        if area <= 0.0 || !high.cmpgt(low).all() {
            return;
        }
        let whole = is_covered(area, high - low) || f64::from(1 << level) * CELLS_ACROSS <= self.extent;
        if level == 0 || (whole && level >= FIRST_STORED) {
            self.sum.add(area, self.texture.pyramid.cell(self.texture, level, i, j));
            return;
        }
        let (middle, _) = cell_bounds(self.texture, level - 1, 2 * i + 1, 2 * j + 1);
        let [left, right] = [polygon.clip(0, middle.x, -1.0), polygon.clip(0, middle.x, 1.0)];
        for (half, x) in [(left, 2 * i), (right, 2 * i + 1)] {
            self.cell(&half.clip(1, middle.y, -1.0), level - 1, x, 2 * j);
            self.cell(&half.clip(1, middle.y, 1.0), level - 1, x, 2 * j + 1);
        }
    }

    /// Adds the part outside a clamped image, where the texels of its rim extend.
    fn rim(&mut self, triangle: &Polygon, size: DVec2) {
        let last = [self.texture.width - 1, self.texture.height - 1];
        for axis in [0, 1] {
            let across = 1 - axis;
            for (cut, sign, edge) in [(0.0, -1.0, 0), (size[axis], 1.0, last[axis])] {
                let outside = triangle.clip(axis, cut, sign);
                if outside.area() <= 0.0 {
                    continue;
                }
                for i in 0..=last[across] {
                    let strip = outside.clip(across, i as f64, 1.0).clip(across, (i + 1) as f64, -1.0);
                    let (x, y) = if axis == 0 { (edge, i) } else { (i, edge) };
                    self.sum.add(strip.area(), self.texture.texel(x, y));
                }
            }
        }
        for (x, x_cut, x_sign) in [(0, 0.0, -1.0), (last[0], size.x, 1.0)] {
            for (y, y_cut, y_sign) in [(0, 0.0, -1.0), (last[1], size.y, 1.0)] {
                let corner = triangle.clip(0, x_cut, x_sign).clip(1, y_cut, y_sign);
                self.sum.add(corner.area(), self.texture.texel(x, y));
            }
        }
    }
}

fn is_covered(area: f64, size: DVec2) -> bool {
    area >= size.x * size.y * (1.0 - 1e-13)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::scene::TextureMap;
    use proptest::prelude::*;

    /// Texels without a pattern.
    fn noise(w: usize, h: usize) -> Texture {
        let mut state = 12345u32;
        let texels = (0..3 * w * h).map(|_| {
            state = state.wrapping_mul(1664525).wrapping_add(1013904223);
            (state >> 24) as u8
        });
        Texture::new(w, h, texels.collect())
    }

    /// The mean of [`Texture::at`] over the centroids of n² small triangles that make up the triangle.
    fn sampled(texture: &Texture, map: &TextureMap, uv: [DVec2; 3], n: usize) -> [f64; 3] {
        let mut sum = Sum::default();
        for i in 0..n {
            for j in 0..n - i {
                for (third, inside) in [(1.0 / 3.0, true), (2.0 / 3.0, i + j + 1 < n)] {
                    let (a, b) = ((i as f64 + third) / n as f64, (j as f64 + third) / n as f64);
                    if inside {
                        sum.add(1.0, texture.at(map, uv[0] + (uv[1] - uv[0]) * a + (uv[2] - uv[0]) * b));
                    }
                }
            }
        }
        sum.mean()
    }

    fn uv() -> impl Strategy<Value = [DVec2; 3]> {
        let point = || (-2.0f64..2.0, -2.0f64..2.0).prop_map(|(x, y)| DVec2::new(x, y));
        [point(), point(), point()]
    }

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(64))]
        #[test]
        fn mean_agrees_with_many_samples(uv in uv(), clamp: bool, w in 1usize..9, h in 1usize..9) {
            prop_assume!((uv[1] - uv[0]).perp_dot(uv[2] - uv[0]).abs() > 0.01);
            let texture = noise(w, h);
            let map = TextureMap { clamp, ..TextureMap::new(0) };
            let exact = texture.mean(&map, uv);
            let samples = sampled(&texture, &map, uv, 600);
            for c in 0..3 {
                prop_assert!((exact[c] - samples[c]).abs() < 6e-3, "{exact:?} {samples:?}");
            }
        }

        #[test]
        fn parts_make_the_whole(uv in uv(), clamp: bool, a in 0.1f64..0.9) {
            prop_assume!((uv[1] - uv[0]).perp_dot(uv[2] - uv[0]).abs() > 0.01);
            let texture = noise(37, 21);
            let map = TextureMap { clamp, ..TextureMap::new(0) };
            let cut = uv[0].lerp(uv[1], a);
            let whole = texture.mean(&map, uv);
            let (one, two) = (texture.mean(&map, [uv[0], cut, uv[2]]), texture.mean(&map, [cut, uv[1], uv[2]]));
            for c in 0..3 {
                prop_assert!((whole[c] - a * one[c] - (1.0 - a) * two[c]).abs() < 1e-6);
            }
        }
    }

    #[test]
    fn half_a_texel_each() {
        let texture = Texture::new(2, 1, vec![0, 0, 0, 255, 255, 255]);
        let map = TextureMap::new(0);
        let [a, b, c, d] = [[0., 0.], [1., 0.], [1., 1.], [0., 1.]].map(DVec2::from);
        // The left half is black: three quarters of the upper left triangle.
        assert!((texture.mean(&map, [a, c, d])[0] - 0.25).abs() < 1e-12);
        assert!((texture.mean(&map, [a, b, c])[0] - 0.75).abs() < 1e-12);
        let far = DVec2::new(-7.0, 5.0);
        assert!((texture.mean(&map, [a + far, b + far, c + far])[0] - 0.75).abs() < 1e-12);
    }

    #[test]
    fn v_points_up() {
        let texture = Texture::new(1, 2, vec![255, 255, 255, 0, 0, 0]);
        let map = TextureMap::new(0);
        assert_eq!(texture.at(&map, DVec2::new(0.5, 0.9)), [1.0; 3]);
        assert_eq!(texture.at(&map, DVec2::new(0.5, 0.1)), [0.0; 3]);
        assert_eq!(texture.at(&map, DVec2::new(0.5, -0.1)), [1.0; 3]);
    }

    #[test]
    fn clamped_rim_goes_on() {
        let texture = Texture::new(2, 1, vec![0, 0, 0, 255, 255, 255]);
        let map = TextureMap { clamp: true, ..TextureMap::new(0) };
        assert_eq!(texture.at(&map, DVec2::new(9.0, -4.0)), [1.0; 3]);
        assert_eq!(texture.mean(&map, [[2., 2.], [3., 2.], [2., 3.]].map(DVec2::from)), [1.0; 3]);
        assert_eq!(texture.mean(&map, [[-2., 0.2], [-3., 0.3], [-2., 0.8]].map(DVec2::from)), [0.0; 3]);
    }

    #[test]
    fn no_area_is_the_value_at_the_centroid() {
        let texture = Texture::new(2, 1, vec![0, 0, 0, 255, 255, 255]);
        let map = TextureMap::new(0);
        assert_eq!(texture.mean(&map, [DVec2::splat(0.75); 3]), [1.0; 3]);
        let line = [[0.1, 0.5], [0.2, 0.5], [0.3, 0.5]].map(DVec2::from);
        assert_eq!(texture.mean(&map, line), [0.0; 3]);
        let nowhere = [DVec2::NAN, DVec2::INFINITY, DVec2::ZERO];
        assert!(texture.mean(&map, nowhere)[0].is_finite());
    }

    /// A sum over texels would take years here.
    #[test]
    fn huge_footprints_are_quick_and_right() {
        let texture = noise(300, 200);
        let map = TextureMap::new(0);
        let all = texture.pyramid.mean;
        for size in [1e2, 1e4, 1e9] {
            let start = std::time::Instant::now();
            let mean = texture.mean(&map, [[-size, 0.1], [size, -0.7 * size], [0.3, size]].map(DVec2::from));
            assert!(start.elapsed().as_secs_f64() < 0.5);
            for c in 0..3 {
                assert!((mean[c] - all[c]).abs() < 1e-3, "{mean:?} {all:?}");
            }
        }
    }

    #[test]
    fn means_are_of_linear_values() {
        let texture = Texture::new(2, 2, [[0u8; 3], [255; 3], [255; 3], [0; 3]].concat());
        let square = [[0., 0.], [2., 0.], [0., 2.]].map(DVec2::from);
        let mean = texture.mean(&TextureMap::new(0), square);
        assert!((mean[1] - 0.5).abs() < 1e-12);
        let grey = Texture::new(1, 1, vec![188; 3]);
        assert!((grey.at(&TextureMap::new(0), DVec2::ZERO)[0] - 0.502886).abs() < 1e-6);
    }
}
