//! Sample patterns and the maps that carry them to triangles and hemispheres.

use glam::Vec3A;

/// Points a sequence holds before it must be seeded anew.
const SEQUENCE: u32 = 1 << 16;

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
/// Burley, "Practical Hash-based Owen Scrambling", JCGT 10(1), 2020. The sequence holds 2¹⁶ points; past that a new
/// scramble begins.
#[inline]
pub fn sobol_4d(index: u32, seed: u64) -> [f32; 4] {
    let seed = if index < SEQUENCE { seed } else { mix(&[seed, (index / SEQUENCE) as u64]) };
    sobol_burley::sample_4d(index % SEQUENCE, 0, (seed ^ (seed >> 32)) as u32)
}

/// Uniform point of a triangle as barycentric coordinates, from a point of the unit square.
///
/// Heitz, "A Low-Distortion Map Between Triangle and Square", 2019: keeps strata compact.
#[inline]
pub fn square_to_triangle(x: f32, y: f32) -> [f32; 3] {
    let (b0, b1) = if y > x { (x * 0.5, y - x * 0.5) } else { (x - y * 0.5, y * 0.5) };
    [b0, b1, (1.0 - b0 - b1).max(0.0)]
}

/// Direction on the hemisphere round +z with density cos θ / π (Malley's method: a uniform disk, lifted), from a
/// point of the unit square.
///
/// Shirley and Chiu, "A Low Distortion Map Between Disk and Square", JGT 2(3), 1997.
#[inline]
pub fn square_to_cosine_hemisphere(x: f32, y: f32) -> Vec3A {
    use std::f32::consts::{FRAC_PI_2, FRAC_PI_4};
    let (a, b) = (2.0 * x - 1.0, 2.0 * y - 1.0);
    let (r, phi) = if a == 0.0 && b == 0.0 {
        (0.0, 0.0)
    } else if a.abs() > b.abs() {
        (a, FRAC_PI_4 * (b / a))
    } else {
        (b, FRAC_PI_2 - FRAC_PI_4 * (a / b))
    };
    let (sin, cos) = phi.sin_cos();
    let z = (1.0 - r * r).max(0.0).sqrt();
    Vec3A::new(r * cos, r * sin, z)
}

/// Turns a direction given round +z so that it is round the unit vector `normal`.
///
/// Duff et al., "Building an Orthonormal Basis, Revisited", JCGT 6(1), 2017.
#[inline]
pub fn around(normal: Vec3A, d: Vec3A) -> Vec3A {
    let sign = 1f32.copysign(normal.z);
    let a = -1.0 / (sign + normal.z);
    let b = normal.x * normal.y * a;
    let tangent = Vec3A::new(1.0 + sign * normal.x * normal.x * a, sign * b, -sign * normal.x);
    let bitangent = Vec3A::new(b, sign + normal.y * normal.y * a, -normal.y);
    tangent * d.x + bitangent * d.y + normal * d.z
}
