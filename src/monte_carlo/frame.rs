//! A camera that frames any scene. Rays determine whether the scene is a room or an object.

use glam::Vec3A;

use super::Camera;
use crate::{
    Result,
    scene::{Scene, centre_and_extent},
    trace::{Tracer, sampling::mix},
};

/// Number of rays from each place.
const DIRECTIONS: usize = 192;
/// Number of places to try inside the bounding box of the scene.
const PLACES: u64 = 48;
/// Angle of view from outside and from inside a room, degrees.
const OUTSIDE: f64 = 40.0;
const INSIDE: f64 = 75.0;

/// Statistics of the rays from one place.
struct Surroundings {
    place: Vec3A,
    /// Fraction of the rays that hit a back. It is large inside an object.
    backs: f64,
    /// Shortest distance of a hit.
    clearance: f32,
    /// Fraction of the rays that escaped, by the axis nearest to their direction: +x −x +y −y +z −z.
    escaped: [f64; 6],
}

enum Kind {
    /// A room that light cannot leave, or only through windows.
    Closed,
    /// A room with one of its six sides missing, given by its index in [`AXES`].
    OpenTowards(usize),
    /// Objects in the open.
    Object,
}

impl Camera {
    /// A camera that shows the whole scene. It looks at a room with a missing side through the opening, at a closed
    /// room from one of its corners, and at anything else diagonally from outside.
    ///
    /// The up direction is +y, except for a room that is open along y.
    ///
    /// # Errors
    /// [`crate::Error::Setting`] for a picture that is empty or too large.
    pub fn frame(scene: &Scene, tracer: &Tracer, width: usize, height: usize) -> Result<Camera> {
        let (low, high) = bounds(scene, tracer);
        let centre = (low + high) * 0.5;
        // In double precision, as it is written to reports.
        let (middle, _) = centre_and_extent(scene.vertices.iter().copied());
        let inside: Vec<Surroundings> = (0..PLACES)
            .map(|i| low + (high - low) * (place(i) * 0.8 + 0.1))
            .map(|p| look_around(tracer, p))
            .filter(|s| s.backs < 0.1)
            .collect();
        let aspect = width.max(1) as f64 / height.max(1) as f64;
        let (eye, look_at, up, fov) = match kind(&inside) {
            Kind::Closed => {
                let (eye, look_at) = from_corner(tracer, low, high, &inside);
                (eye, tracer.to_file(look_at), Vec3A::Y, INSIDE)
            }
            Kind::OpenTowards(side) => {
                let axis = AXES[side];
                let up = if axis.y != 0.0 { Vec3A::Z } else { Vec3A::Y };
                let half = (high - low) * 0.5;
                let across = half * (Vec3A::ONE - axis.abs() - up);
                // The opening fills the picture, with a margin of 3 %.
                let distance = fit(half.dot(up).max(across.element_sum() / aspect as f32) * 1.03, OUTSIDE);
                (centre + axis * (half.dot(axis.abs()) + distance), middle, up, OUTSIDE)
            }
            Kind::Object => {
                let radius = (high - low).length() * 0.5;
                let half_angle = (OUTSIDE.to_radians() / 2.0).tan() * aspect.min(1.0);
                let distance = radius / (half_angle.atan().sin() as f32).max(1e-3);
                (centre + Vec3A::new(0.55, 0.45, 0.7).normalize() * distance, middle, Vec3A::Y, OUTSIDE)
            }
        };
        Camera::new(tracer.to_file(eye), look_at, up.as_dvec3(), fov, width, height)
    }
}

const AXES: [Vec3A; 6] = [Vec3A::X, Vec3A::NEG_X, Vec3A::Y, Vec3A::NEG_Y, Vec3A::Z, Vec3A::NEG_Z];

fn bounds(scene: &Scene, tracer: &Tracer) -> (Vec3A, Vec3A) {
    let corners = scene.vertices.iter().map(|&v| tracer.to_unit(v));
    let (low, high) =
        corners.fold((Vec3A::INFINITY, Vec3A::NEG_INFINITY), |(low, high), p| (low.min(p), high.max(p)));
    if low.cmpgt(high).any() { (Vec3A::NEG_ONE, Vec3A::ONE) } else { (low, high) }
}

/// Distance at which `half` fills half of the angle of view.
fn fit(half: f32, fov: f64) -> f32 {
    half / (fov.to_radians() / 2.0).tan() as f32
}

/// Pseudo-random point `i` of the unit cube.
fn place(i: u64) -> Vec3A {
    let number = |axis: u64| (mix(&[i, axis]) >> 40) as f32 * 2f32.powi(-24);
    Vec3A::new(number(0), number(1), number(2))
}

/// Direction `i` of a Fibonacci lattice on the sphere.
fn direction(i: usize) -> Vec3A {
    let z = 1.0 - (2 * i + 1) as f32 / DIRECTIONS as f32;
    let (sin, cos) = (i as f32 * 2.399_963_2).sin_cos();
    let r = (1.0 - z * z).sqrt();
    Vec3A::new(r * cos, r * sin, z)
}

fn look_around(tracer: &Tracer, place: Vec3A) -> Surroundings {
    let (mut backs, mut clearance) = (0, f32::INFINITY);
    let (mut escaped, mut cast) = ([0.0; 6], [0.0; 6]);
    for d in (0..DIRECTIONS).map(direction) {
        let side = (0..6).max_by(|&a, &b| AXES[a].dot(d).total_cmp(&AXES[b].dot(d))).unwrap_or(0);
        cast[side] += 1.0;
        match tracer.closest(place, d) {
            None => escaped[side] += 1.0,
            Some(hit) => {
                backs += usize::from(!hit.front);
                clearance = clearance.min(hit.t);
            }
        }
    }
    let escaped = std::array::from_fn(|k| escaped[k] / f64::max(cast[k], 1.0));
    Surroundings { place, backs: backs as f64 / DIRECTIONS as f64, clearance, escaped }
}

fn kind(inside: &[Surroundings]) -> Kind {
    // Inside a solid nearly every place sees backs.
    if inside.len() < PLACES as usize / 8 {
        return Kind::Object;
    }
    let mean = |side: usize| inside.iter().map(|s| s.escaped[side]).sum::<f64>() / inside.len() as f64;
    let mut sides: Vec<(f64, usize)> = (0..6).map(|side| (mean(side), side)).collect();
    sides.sort_by(|a, b| b.0.total_cmp(&a.0));
    match (sides[0], sides[1]) {
        ((most, side), (second, _)) if most > 0.5 && second < 0.35 => Kind::OpenTowards(side),
        ((most, _), _) if most <= 0.5 => Kind::Closed,
        _ => Kind::Object,
    }
}

/// Eye and target inside a room. The eye is the place with the longest view among places near the corners, a little
/// above the middle. Places that are too close to surfaces are left out.
fn from_corner(tracer: &Tracer, low: Vec3A, high: Vec3A, inside: &[Surroundings]) -> (Vec3A, Vec3A) {
    let (centre, half) = ((low + high) * 0.5, (high - low) * 0.5);
    let needed = 0.1 * half.min_element();
    let corners = [0.8, 0.65, 0.5].into_iter().flat_map(|out| {
        [(1.0, 1.0), (-1.0, 1.0), (1.0, -1.0), (-1.0, -1.0)]
            .map(|(x, z)| centre + half * Vec3A::new(x * out, 0.25, z * out))
    });
    let target = centre - half * Vec3A::Y * 0.1;
    corners
        .map(|p| look_around(tracer, p))
        .filter(|s| s.backs == 0.0 && s.clearance >= needed)
        .map(|s| (depth(tracer, s.place, target), s.place))
        .max_by(|a, b| a.0.total_cmp(&b.0))
        .map(|(_, eye)| (eye, target))
        .unwrap_or_else(|| {
            let roomy = inside.iter().max_by(|a, b| a.clearance.total_cmp(&b.clearance));
            let eye = roomy.map_or(centre, |s| s.place);
            (eye, furthest(tracer, eye))
        })
}

/// Mean length of the rays within about 37 degrees of the direction to the target, each at most 2.
fn depth(tracer: &Tracer, eye: Vec3A, target: Vec3A) -> f32 {
    let way = (target - eye).normalize_or_zero();
    let seen: Vec<f32> = (0..DIRECTIONS)
        .map(direction)
        .filter(|d| d.dot(way) > 0.8)
        .map(|d| tracer.closest(eye, d).map_or(2.0, |hit| hit.t.min(2.0)))
        .collect();
    seen.iter().sum::<f32>() / seen.len().max(1) as f32
}

/// A point in the roughly horizontal direction with the longest view.
fn furthest(tracer: &Tracer, eye: Vec3A) -> Vec3A {
    (0..DIRECTIONS)
        .map(direction)
        .filter(|d| d.y.abs() < 0.3)
        .map(|d| eye + d)
        .max_by(|&a, &b| depth(tracer, eye, a).total_cmp(&depth(tracer, eye, b)))
        .unwrap_or(eye + Vec3A::X)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::monte_carlo::tests::{box_walls, grey};
    use glam::{DVec3, dvec3};

    /// The camera, and the share of the picture that shows fronts.
    fn framed(scene: &Scene) -> (Camera, f64) {
        let tracer = Tracer::new(scene);
        let camera = Camera::frame(scene, &tracer, 64, 48).unwrap();
        assert_eq!(camera.check(&tracer).unwrap(), None);
        let lens = camera.lens(&tracer);
        let fronts = (0..64 * 48)
            .filter_map(|i| {
                tracer.closest(lens.eye(), lens.direction((i % 64) as f64 + 0.5, (i / 64) as f64 + 0.5))
            })
            .filter(|hit| hit.front)
            .count();
        (camera, fronts as f64 / (64.0 * 48.0))
    }

    fn inside(camera: &Camera, size: DVec3) -> bool {
        let e = camera.eye();
        e.cmpgt(DVec3::ZERO).all() && e.cmplt(size).all()
    }

    #[test]
    fn a_closed_room_is_seen_from_inside() {
        let size = dvec3(6000.0, 2500.0, 4000.0);
        let mut walls = box_walls(DVec3::ZERO, size, true);
        let (camera, fronts) = framed(&Scene::new(&walls, grey(0.5, 0.0)));
        assert!(inside(&camera, size) && fronts == 1.0, "{camera:?} {fronts}");
        // A pillar in each corner region: the camera must not stand in one.
        for (x, z) in [(200.0, 200.0), (4800.0, 200.0), (200.0, 2800.0), (4800.0, 2800.0)] {
            walls.extend(box_walls(dvec3(x, 0.0, z), dvec3(x + 1000.0, 2500.0, z + 1000.0), false));
        }
        let (camera, fronts) = framed(&Scene::new(&walls, grey(0.5, 0.0)));
        assert!(inside(&camera, size) && fronts == 1.0, "{camera:?} {fronts}");
    }

    #[test]
    fn a_room_without_a_wall_is_seen_through_it() {
        for (side, axis) in AXES.map(|a| a.as_dvec3()).into_iter().enumerate() {
            let size = DVec3::splat(550.0);
            let mut walls = box_walls(DVec3::ZERO, size, true);
            walls.retain(|(corners, _)| {
                let middle = size * (axis + 1.0) / 2.0;
                !corners.iter().all(|c| ((*c - middle) * axis).abs().element_sum() < 1e-9)
            });
            assert_eq!(walls.len(), 10);
            walls.extend(box_walls(dvec3(100., 0., 200.), dvec3(250., 300., 400.), false));
            let (camera, fronts) = framed(&Scene::new(&walls, grey(0.5, 0.0)));
            let out = (camera.eye() - size / 2.0).normalize().dot(axis);
            assert!(out > 0.999 && fronts > 0.6, "side {side}: {camera:?} {fronts}");
        }
    }

    #[test]
    fn an_object_is_seen_from_outside_and_fits() {
        let scene = Scene::new(&box_walls(DVec3::ONE, dvec3(2.0, 3.0, 2.5), false), grey(0.5, 0.0));
        let (camera, fronts) = framed(&scene);
        assert!(fronts > 0.1 && fronts < 0.9, "{fronts}");
        let tracer = Tracer::new(&scene);
        let lens = camera.lens(&tracer);
        assert!(scene.vertices.iter().all(|&v| lens.pixel_of(tracer.to_unit(v)).is_some()));
        assert!(camera.eye().y > 3.0);
        // The same object on a floor.
        let mut shapes = box_walls(DVec3::ONE, dvec3(2.0, 3.0, 2.5), false);
        let floor = [dvec3(-5., 1., -5.), dvec3(-5., 1., 5.), dvec3(5., 1., 5.), dvec3(5., 1., -5.)];
        shapes.push(([floor[0], floor[1], floor[2]], 0));
        shapes.push(([floor[0], floor[2], floor[3]], 0));
        let (camera, fronts) = framed(&Scene::new(&shapes, grey(0.5, 0.0)));
        assert!(camera.eye().y > 3.0 && fronts > 0.1, "{camera:?} {fronts}");
    }

    #[test]
    fn an_empty_scene_gives_a_camera_but_no_view() {
        let scene = Scene::new(&[], grey(0.5, 0.0));
        let tracer = Tracer::new(&scene);
        let camera = Camera::frame(&scene, &tracer, 4, 4).unwrap();
        assert!(camera.check(&tracer).is_err());
    }
}
