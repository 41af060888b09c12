//! The pinhole camera.

use glam::{DVec3, Vec3A};

use super::{PathTracer, Samples};
use crate::{Error, Result, Setting, scene::direction, trace::Tracer};

/// A pinhole camera in scene coordinates.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Camera {
    eye: DVec3,
    look_at: DVec3,
    up: DVec3,
    fov: f64,
    width: usize,
    height: usize,
}

/// A [`Camera`] in unit space, ready for rays. Pixels are numbered from the top left, row by row.
#[derive(Debug, Clone, Copy)]
pub struct Lens {
    eye: Vec3A,
    /// Orthonormal vectors: to the right, upwards, and forward along the optical axis.
    right: DVec3,
    up: DVec3,
    forward: DVec3,
    /// Half the picture's extent on the image plane at distance 1.
    half: [f64; 2],
    width: usize,
    height: usize,
}

/// Largest number of pixels of a picture.
const MOST_PIXELS: usize = 1 << 28;

/// The settings that are positions or directions.
const PLACES: &[Setting] = &[Setting::Eye, Setting::LookAt, Setting::Up];

impl Camera {
    /// A camera at `eye` that looks at `look_at`; `fov` is the vertical angle of view in degrees.
    ///
    /// # Errors
    /// [`Error::Setting`] for values from which no picture can be made.
    pub fn new(
        eye: DVec3,
        look_at: DVec3,
        up: DVec3,
        fov: f64,
        width: usize,
        height: usize,
    ) -> Result<Camera> {
        if width == 0 || height == 0 {
            return Err(Error::setting(
                &[Setting::PictureSize],
                format!("a picture of {width} x {height} pixels is empty"),
                "width and height are at least 1",
            ));
        }
        if width.checked_mul(height).is_none_or(|n| n > MOST_PIXELS) {
            return Err(Error::setting(
                &[Setting::PictureSize],
                format!("a picture of {width} x {height} pixels is too large"),
                format!("a picture has at most {MOST_PIXELS} pixels"),
            ));
        }
        if ![eye, look_at, up].iter().all(|v| v.is_finite()) {
            return Err(Error::setting(
                PLACES,
                "the camera has coordinates that are not finite",
                "give finite numbers",
            ));
        }
        if !(fov > 0.0 && fov < 180.0) {
            return Err(Error::setting(
                &[Setting::FieldOfView],
                format!("an angle of view of {fov} degrees is impossible"),
                "an angle of view lies between 0 and 180 degrees",
            ));
        }
        let Some(forward) = direction(look_at - eye) else {
            return Err(Error::setting(
                &[Setting::Eye, Setting::LookAt],
                "the camera's eye and the point it looks at are the same",
                "move the camera, or look at another point",
            ));
        };
        // Below an angle of 10⁻⁶, rounding determines the rotation of the picture.
        if direction(up).is_none_or(|up| up.cross(forward).length() < 1e-6) {
            return Err(Error::setting(
                &[Setting::Up],
                "the camera's up direction is parallel to its view",
                "choose another direction, for instance 0,1,0 or 0,0,1",
            ));
        }
        Ok(Camera { eye, look_at, up, fov, width, height })
    }

    /// Position of the camera.
    pub fn eye(&self) -> DVec3 {
        self.eye
    }

    /// The point in the middle of the picture.
    pub fn look_at(&self) -> DVec3 {
        self.look_at
    }

    /// The direction that is upwards in the picture.
    pub fn up(&self) -> DVec3 {
        self.up
    }

    /// Vertical angle of view, degrees.
    pub fn fov(&self) -> f64 {
        self.fov
    }

    /// Pixels in a row.
    pub fn width(&self) -> usize {
        self.width
    }

    /// Rows of pixels.
    pub fn height(&self) -> usize {
        self.height
    }

    /// The camera in unit space.
    pub fn lens(&self, tracer: &Tracer) -> Lens {
        let [forward, up] =
            [self.look_at - self.eye, self.up].map(|v| direction(v).expect("a camera has directions"));
        let right = forward.cross(up).normalize();
        let vertical = (self.fov.to_radians() / 2.0).tan();
        Lens {
            eye: tracer.to_unit(self.eye),
            right,
            up: right.cross(forward),
            forward,
            half: [vertical * self.width as f64 / self.height as f64, vertical],
            width: self.width,
            height: self.height,
        }
    }

    /// Whether a coarse grid of a few paths over the picture finds any light.
    pub fn sees_light(&self, paths: &PathTracer) -> bool {
        let lens = self.lens(paths.tracer());
        (0..GRID * GRID).any(|i| {
            let mut samples = Samples::new(i as u32, 0);
            paths.radiance(lens.eye(), lens.grid_direction(i), &mut samples) != [0.0; 3]
        })
    }

    /// Checks whether the picture can show anything. The sentence is a warning for the user.
    ///
    /// # Errors
    /// [`Error::Setting`] if no ray of a grid over the picture hits the scene.
    pub fn check(&self, tracer: &Tracer) -> Result<Option<String>> {
        let lens = self.lens(tracer);
        let (mut met, mut backs, mut near) = (0, 0, 0);
        for i in 0..GRID * GRID {
            let direction = lens.grid_direction(i);
            if let Some(hit) = tracer.closest(lens.eye, direction) {
                met += 1;
                backs += usize::from(!hit.front);
                near += usize::from(hit.t * direction.length() < 1e-4);
            }
        }
        if met == 0 {
            return Err(Error::setting(
                &[Setting::Eye, Setting::LookAt],
                "the camera sees nothing of the scene",
                "move the camera, or look at another point",
            ));
        }
        let warning = if 10 * near > 9 * met {
            Some("the camera touches a surface")
        } else if 10 * backs > 9 * met {
            Some(
                "the camera sees only backs of surfaces; it may stand inside an object, or faces may be flipped",
            )
        } else {
            None
        };
        Ok(warning.map(String::from))
    }
}

/// Directions along a side of the grid that checks whether a camera sees anything.
const GRID: usize = 32;

impl Lens {
    /// Direction `i` of a grid over the picture.
    fn grid_direction(&self, i: usize) -> Vec3A {
        let place = |k: usize, size: usize| (k as f64 + 0.5) / GRID as f64 * size as f64;
        self.direction(place(i % GRID, self.width), place(i / GRID, self.height))
    }

    /// Pixels in a row.
    pub fn width(&self) -> usize {
        self.width
    }

    /// Rows of pixels.
    pub fn height(&self) -> usize {
        self.height
    }

    /// The origin of all rays.
    #[inline]
    pub fn eye(&self) -> Vec3A {
        self.eye
    }

    /// Direction, not of unit length, to a position in the picture in pixels. (0, 0) is the upper left corner of the
    /// upper left pixel.
    #[inline]
    pub fn direction(&self, x: f64, y: f64) -> Vec3A {
        let h = (2.0 * x / self.width as f64 - 1.0) * self.half[0];
        let v = (1.0 - 2.0 * y / self.height as f64) * self.half[1];
        (self.forward + self.right * h + self.up * v).as_vec3a()
    }

    /// The position in the picture, in pixels, at which a point is seen, and the cosine of the angle to the optical
    /// axis. `None` for a point behind the camera. The position may lie outside of the picture.
    #[inline]
    pub fn project(&self, point: Vec3A) -> Option<(f64, f64, f64)> {
        let to = (point - self.eye).as_dvec3();
        let depth = to.dot(self.forward);
        if depth <= 0.0 {
            return None;
        }
        let (h, v) = (to.dot(self.right) / depth, to.dot(self.up) / depth);
        let x = (h / self.half[0] + 1.0) / 2.0 * self.width as f64;
        let y = (1.0 - v / self.half[1]) / 2.0 * self.height as f64;
        Some((x, y, 1.0 / (1.0 + h * h + v * v).sqrt()))
    }

    /// The pixel in which a point is seen, and the cosine of the angle to the optical axis.
    #[inline]
    pub fn pixel_of(&self, point: Vec3A) -> Option<(usize, f64)> {
        let (x, y, cos) = self.project(point)?;
        let inside = x >= 0.0 && y >= 0.0 && x < self.width as f64 && y < self.height as f64;
        inside.then(|| (y as usize * self.width + x as usize, cos))
    }

    /// Area of a pixel on the image plane at distance 1.
    #[inline]
    pub fn pixel_area(&self) -> f64 {
        4.0 * self.half[0] * self.half[1] / (self.width * self.height) as f64
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::scene::{Material, Scene};
    use glam::dvec3;

    fn square(corners: [DVec3; 4]) -> Scene {
        let [a, b, c, d] = corners;
        Scene::new(&[([a, b, c], 0), ([a, c, d], 0)], vec![Material::new("m", [0.5; 3], [0.0; 3])])
    }

    /// A wall of 2 × 2 at z = 0 that faces +z.
    fn wall() -> Scene {
        square([dvec3(-1., -1., 0.), dvec3(1., -1., 0.), dvec3(1., 1., 0.), dvec3(-1., 1., 0.)])
    }

    #[test]
    fn projection_inverts_primary_rays() {
        let tracer = Tracer::new(&wall());
        let camera =
            Camera::new(dvec3(0.3, -0.2, 4.0), dvec3(0.1, 0.4, -0.5), dvec3(0.1, 1.0, 0.3), 37.0, 640, 360);
        let lens = camera.unwrap().lens(&tracer);
        for i in 0..1000 {
            let (x, y) = ((i as f64 * 0.618).fract() * 640.0, (i as f64 * 0.755).fract() * 360.0);
            let direction = lens.direction(x, y);
            let point = lens.eye() + direction * (0.5 + 0.01 * i as f32);
            let (px, py, cos) = lens.project(point).unwrap();
            assert!((px - x).abs() < 2e-3 && (py - y).abs() < 2e-3, "({x} {y}) came back as ({px} {py})");
            assert!((cos - 1.0 / f64::from(direction.length())).abs() < 1e-6);
        }
        assert!(lens.project(lens.eye() - lens.direction(320.0, 180.0)).is_none());
    }

    #[test]
    fn the_picture_is_upright_and_not_mirrored() {
        // 90 degrees at distance 2: the picture's half height is 2.
        let tracer = Tracer::new(&wall());
        let lens = Camera::new(dvec3(0., 0., 2.), DVec3::ZERO, DVec3::Y, 90.0, 80, 40).unwrap().lens(&tracer);
        let (x, y, _) = lens.project(tracer.to_unit(dvec3(1.0, 1.0, 0.0))).unwrap();
        assert!((x - 50.0).abs() < 1e-4 && (y - 10.0).abs() < 1e-4, "{x} {y}");
        let (pixel, cos) = lens.pixel_of(tracer.to_unit(dvec3(-0.95, 0.95, 0.0))).unwrap();
        assert_eq!(pixel, 10 * 80 + 30);
        assert!((cos - 2.0 / (4.0f64 + 2.0 * 0.95 * 0.95).sqrt()).abs() < 1e-6);
        // 4 × 8 on the plane at distance 1 is 2 × 4, over 3200 pixels.
        assert!((lens.pixel_area() - 8.0 / 3200.0).abs() < 1e-12);
        assert!(lens.pixel_of(tracer.to_unit(dvec3(0.0, 2.1, 0.0))).is_none());
    }

    #[test]
    fn impossible_cameras_are_refused_with_a_hint() {
        let good = (dvec3(0., 0., 2.), DVec3::ZERO, DVec3::Y, 45.0, 8, 8);
        let make = |c: (DVec3, DVec3, DVec3, f64, usize, usize)| Camera::new(c.0, c.1, c.2, c.3, c.4, c.5);
        assert!(make(good).is_ok());
        // The up vector may have any length.
        let tracer = Tracer::new(&wall());
        for length in [1e-300, 1e300] {
            let lens = make((good.0, good.1, DVec3::Y * length, 45.0, 8, 8)).unwrap().lens(&tracer);
            assert_eq!((lens.up, lens.right), (DVec3::Y, DVec3::X));
        }
        let bad = [
            ((good.0, good.1, good.2, good.3, 0, 8), "empty"),
            ((good.0, good.1, good.2, good.3, 8, 0), "empty"),
            ((good.0, good.1, good.2, good.3, usize::MAX, 8), "too large"),
            ((good.0, good.0, good.2, good.3, 8, 8), "are the same"),
            ((good.0, good.1, DVec3::Z, good.3, 8, 8), "parallel"),
            ((good.0, good.1, DVec3::ZERO, good.3, 8, 8), "parallel"),
            ((DVec3::NAN, good.1, good.2, good.3, 8, 8), "not finite"),
            ((good.0, DVec3::INFINITY, good.2, good.3, 8, 8), "not finite"),
            ((good.0, good.1, good.2, 180.0, 8, 8), "180"),
            ((good.0, good.1, good.2, f64::NAN, 8, 8), "NaN"),
        ];
        for (camera, word) in bad {
            let error = make(camera).unwrap_err();
            assert!(matches!(error, Error::Setting { .. }) && error.hint().is_some());
            assert!(error.to_string().contains(word), "{error} lacks {word}");
        }
    }

    #[test]
    fn a_camera_that_shows_nothing_is_told_so() {
        let tracer = Tracer::new(&wall());
        let at = |eye: DVec3, look_at: DVec3| {
            Camera::new(eye, look_at, DVec3::Y, 45.0, 8, 8).unwrap().check(&tracer)
        };
        assert!(at(dvec3(0., 0., 3.), DVec3::ZERO).unwrap().is_none());
        assert!(at(dvec3(0., 0., -3.), DVec3::ZERO).unwrap().unwrap().contains("backs"));
        assert!(at(dvec3(0., 0., 1e-6), DVec3::ZERO).unwrap().unwrap().contains("touches"));
        assert!(matches!(at(dvec3(0., 0., 3.), dvec3(0., 0., 9.)), Err(Error::Setting { .. })));
    }
}
