//! The exchange area of two polygons by Stokes' theorem: A1 F12 = 1/(2 pi) times the double integral of ln r ds1.ds2
//! over both contours (P. Moon, *The Scientific Basis of Illuminating Engineering*, 1936; C. M. Goral et al.,
//! "Modeling the Interaction of Light Between Diffuse Surfaces", SIGGRAPH 84).
//!
//! P. Schröder and P. Hanrahan ("On the Form Factor between Two Polygons", SIGGRAPH 93) give the integral over a pair
//! of edges in closed form with dilogarithms of complex argument. Here only the inner integral is in closed form. The
//! outer one is numerical, with the same accuracy and without the branch cuts of the closed form: the singularities of
//! the inner integral as a function of the outer parameter are known, and panels are halved until each is far from all
//! of them.

use std::f64::consts::PI;

use glam::DVec3;

use super::cubature::gauss_legendre;

/// Points per panel. With [`CLEAR`] the error of a panel is below 3.7^-32 = 4e-19 of the integrand.
const POINTS: usize = 16;

/// The least sum of the distances from a singularity to the two ends of a panel, in half-lengths of the panel. It is
/// twice the major half-axis of the Bernstein ellipse, hence rho = 2 + sqrt(3) = 3.7.
const CLEAR: f64 = 4.0;

/// Panels of at most this half-width are not halved further, even if they touch a singularity. The singularities are no
/// worse than x ln x, so the error there is about the square of this.
const SMALLEST: f64 = 1e-9;

/// The exchange area of two polygons wholly in front of each other, counterclockwise as seen from their fronts.
///
/// The absolute error is a few units in the last place of the product of the perimeters, so lengths should be in units
/// of the smaller polygon's size.
pub(super) fn exchange(p: &[DVec3], q: &[DVec3]) -> f64 {
    let sum: f64 = edges(p).flat_map(|e| edges(q).map(move |f| (e, f))).map(|(e, f)| pair(e, f)).sum();
    sum / (2.0 * PI)
}

/// A segment: its start, unit direction and length.
#[derive(Clone, Copy)]
struct Edge {
    start: DVec3,
    direction: DVec3,
    length: f64,
}

fn edges(polygon: &[DVec3]) -> impl Iterator<Item = Edge> {
    (0..polygon.len()).filter_map(|k| {
        let start = polygon[k];
        let along = polygon[(k + 1) % polygon.len()] - start;
        let length = along.length();
        (length > 0.0).then(|| Edge { start, direction: along / length, length })
    })
}

/// A singularity of the inner integral at the outer parameter `at` ± i `off`.
#[derive(Clone, Copy)]
struct Singularity {
    at: f64,
    off: f64,
}

/// The double integral of ln r ds1.ds2 over a pair of edges.
fn pair(e: Edge, f: Edge) -> f64 {
    let cosine = e.direction.dot(f.direction);
    if cosine == 0.0 {
        return 0.0;
    }
    let (singularities, count) = singularities(e, f);
    let singularities = &singularities[..count];
    let mut breaks = [0.0, e.length, e.length, e.length, e.length];
    for (k, s) in singularities.iter().enumerate() {
        breaks[k + 2] = s.at.clamp(0.0, e.length);
    }
    breaks.sort_unstable_by(f64::total_cmp);
    let integral: f64 = breaks.windows(2).map(|b| panel(e, f, b[0], b[1], singularities)).sum();
    cosine * integral
}

/// The values of the complex outer parameter at which the distance to an end of `f` vanishes, or the distance to the
/// line through `f` at a foot between its ends. At other feet the branches of the two arc tangents cancel.
fn singularities(e: Edge, f: Edge) -> ([Singularity; 3], usize) {
    let to_point = |p: DVec3| {
        let d = p - e.start;
        Singularity { at: d.dot(e.direction), off: d.cross(e.direction).length() }
    };
    let mut out =
        [to_point(f.start), to_point(f.start + f.direction * f.length), Singularity { at: 0.0, off: 0.0 }];
    let across = e.direction.cross(f.direction);
    let sine2 = across.length_squared();
    if sine2 > 0.0 {
        let d = f.start - e.start;
        let at = d.cross(f.direction).dot(across) / sine2;
        let foot = d.cross(e.direction).dot(across) / sine2;
        if (0.0..=f.length).contains(&foot) {
            // h² is sine² (t - at)² + gap², where gap is the distance of the two lines.
            out[2] = Singularity { at, off: d.dot(across).abs() / sine2 };
            return (out, 3);
        }
    }
    (out, 2)
}

/// The integral over part of `e`, which is halved until Gauss-Legendre quadrature resolves it.
fn panel(e: Edge, f: Edge, from: f64, to: f64, singularities: &[Singularity]) -> f64 {
    let half = 0.5 * (to - from);
    if half <= 0.0 {
        return 0.0;
    }
    let is_clear = |s: &Singularity| (s.at - from).hypot(s.off) + (s.at - to).hypot(s.off) >= CLEAR * half;
    if half > SMALLEST.max(4.0 * f64::EPSILON * e.length) && !singularities.iter().all(is_clear) {
        let middle = from + half;
        return panel(e, f, from, middle, singularities) + panel(e, f, middle, to, singularities);
    }
    let at = |t: f64| log_integral(e.start + e.direction * (from + (to - from) * t), f);
    (to - from) * gauss_legendre(POINTS).iter().map(|&(t, w)| w * at(t)).sum::<f64>()
}

/// The integral of ln r along an edge, where r is the distance from `p`. With s measured from the foot of `p` on the
/// line and h the distance to the line, the antiderivative is s ln sqrt(s² + h²) - s + h atan(s/h).
fn log_integral(p: DVec3, f: Edge) -> f64 {
    let d = p - f.start;
    let foot = d.dot(f.direction);
    let h = d.cross(f.direction).length();
    let antiderivative = |s: f64| {
        let r2 = s * s + h * h;
        if r2 > 0.0 { 0.5 * s * r2.ln() + h * s.atan2(h) } else { 0.0 }
    };
    antiderivative(f.length - foot) - antiderivative(-foot) - f.length
}

#[cfg(test)]
mod tests {
    use glam::dvec3;

    use super::*;
    use crate::exact::cubature;

    /// Contour integrals and cubature share only the quadrature rule. They agree where both are accurate, 3 to 8 radii
    /// apart.
    #[test]
    fn contours_agree_with_cubature() {
        let p = [dvec3(0.0, 0.0, 0.0), dvec3(1.0, 0.1, 0.0), dvec3(0.9, 1.2, 0.0), dvec3(0.1, 0.8, 0.0)];
        for (height, lean) in [(2.6, 0.0), (4.0, 0.3), (7.0, -0.2)] {
            let q = [dvec3(0.2, 0.0, height), dvec3(0.3, 1.1, height + lean), dvec3(1.2, 0.1, height - 0.1)];
            let m = (q[1] - q[0]).cross(q[2] - q[0]).normalize();
            let by_points =
                cubature::exchange_if_far((&p, DVec3::Z), (&q, m), 3.0, f64::EPSILON).expect("far enough");
            let by_contours = exchange(&p, &q);
            // The terms of the contour integral cancel by the fourth power of the distance in perimeters, about 1e3.
            assert!((by_contours / by_points - 1.0).abs() < 1e-12, "{by_contours} and {by_points}");
        }
    }

    /// Coincident and collinear edges have elementary integrals: L² (ln L - 3/2) for coincident edges, and for edges on
    /// one line the second difference of x² (ln x - 3/2) / 2.
    #[test]
    fn edges_on_one_line() {
        let edge =
            |from: f64, to: f64| Edge { start: DVec3::X * from, direction: DVec3::X, length: to - from };
        let g = |x: f64| if x == 0.0 { 0.0 } else { 0.5 * x * x * (x.abs().ln() - 1.5) };
        for (a, b, c, d) in
            [(0.0, 2.0, 0.0, 2.0), (0.0, 1.0, 1.0, 3.0), (0.0, 1.0, 0.25, 0.5), (0.0, 1.0, 1.5, 2.0)]
        {
            let want = g(d - a) - g(d - b) - g(c - a) + g(c - b);
            let got = pair(edge(a, b), edge(c, d));
            assert!((got - want).abs() < 4e-15, "{got} instead of {want}");
        }
    }
}
