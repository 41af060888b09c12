//! Sample patterns, and maps from the unit square to triangles and hemispheres.

use glam::Vec3A;

/// Number of points of a sequence before it needs a new seed.
pub(super) const SEQUENCE: u32 = 1 << 16;

/// Mixes words into a seed; every bit of the input moves every bit of the output.
#[inline]
pub fn mix(words: &[u64]) -> u64 {
    // The finaliser of SplitMix64 (Steele, Lea and Flood, OOPSLA 2014), chained.
    words.iter().fold(0x9e37_79b9_7f4a_7c15, |state, &word| {
        let mut z = (state ^ word).wrapping_add(0x9e37_79b9_7f4a_7c15);
        z = (z ^ (z >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
        z = (z ^ (z >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
        z ^ (z >> 31)
    })
}

/// Point `index` of the four-dimensional Owen-scrambled Sobol sequence with this seed; coordinates in \[0, 1).
///
/// Burley, "Practical Hash-based Owen Scrambling", JCGT 10(1), 2020. A sequence has 2¹⁶ points;
/// after them a new scramble begins.
#[inline]
pub fn sobol_4d(index: u32, seed: u64) -> [f32; 4] {
    sobol_burley::sample_4d(index % SEQUENCE, 0, seed_of(seed, index))
}

/// The seed of the sequence that contains point `index`.
#[inline]
pub(super) fn seed_of(seed: u64, index: u32) -> u32 {
    let seed = if index < SEQUENCE { seed } else { mix(&[seed, (index / SEQUENCE) as u64]) };
    (seed ^ (seed >> 32)) as u32
}

/// Uniform point of a triangle as barycentric coordinates, from a point of the unit square.
///
/// Heitz, "A Low-Distortion Map Between Triangle and Square", 2019: keeps strata compact.
#[inline]
pub fn square_to_triangle(x: f32, y: f32) -> [f32; 3] {
    // Written without branches, since their outcome cannot be predicted.
    let (near, far) = (if y > x { x } else { y } * 0.5, if y > x { y } else { x });
    let rest = far - near;
    let (b0, b1) = if y > x { (near, rest) } else { (rest, near) };
    [b0, b1, (1.0 - b0 - b1).max(0.0)]
}

/// Maps a point of the unit square to a direction on the hemisphere around +z with density cos θ / π (Malley's method:
/// a uniform disk, lifted).
///
/// Shirley and Chiu, "A Low Distortion Map Between Disk and Square", JGT 2(3), 1997.
#[inline]
pub fn square_to_cosine_hemisphere(x: f32, y: f32) -> Vec3A {
    Vec3A::from_array(cosine_hemisphere(x, y))
}

/// [`square_to_cosine_hemisphere`] by coordinates, without branches and calls, so that the compiler can vectorise it.
#[inline]
pub(crate) fn cosine_hemisphere(x: f32, y: f32) -> [f32; 3] {
    let (a, b) = (2.0 * x - 1.0, 2.0 * y - 1.0);
    let wide = a.abs() > b.abs();
    let (r, other) = if wide { (a, b) } else { (b, a) };
    let (sin, cos) = sin_cos(std::f32::consts::FRAC_PI_4 * (other / if r == 0.0 { 1.0 } else { r }));
    let (cos, sin) = if wide { (cos, sin) } else { (sin, cos) };
    [r * cos, r * sin, (1.0 - r * r).max(0.0).sqrt()]
}

/// Sine and cosine of an angle between -π/4 and π/4, to 10⁻⁷. They are the same on every machine; the functions of the
/// standard library need not be.
///
/// Moshier, *Methods and Programs for Mathematical Functions* (Cephes), `sinf` and `cosf`.
#[inline]
fn sin_cos(x: f32) -> (f32, f32) {
    let z = x * x;
    let sin = ((-1.951_529_6e-4 * z + 8.332_161e-3) * z - 0.166_666_55) * z * x + x;
    let cos = ((2.443_315_7e-5 * z - 1.388_731_6e-3) * z + 4.166_664_6e-2) * z * z - 0.5 * z + 1.0;
    (sin, cos)
}

/// Rotates a direction so that +z becomes the unit vector `normal`.
///
/// Duff et al., "Building an Orthonormal Basis, Revisited", JCGT 6(1), 2017.
#[inline]
pub fn around(normal: Vec3A, d: Vec3A) -> Vec3A {
    let [tangent, bitangent] = tangents(normal);
    tangent * d.x + bitangent * d.y + normal * d.z
}

/// Two unit vectors that are perpendicular to the unit vector `normal` and to each other.
#[inline]
pub(crate) fn tangents(normal: Vec3A) -> [Vec3A; 2] {
    let sign = 1f32.copysign(normal.z);
    let a = -1.0 / (sign + normal.z);
    let b = normal.x * normal.y * a;
    [
        Vec3A::new(1.0 + sign * normal.x * normal.x * a, sign * b, -sign * normal.x),
        Vec3A::new(b, sign + normal.y * normal.y * a, -normal.y),
    ]
}
