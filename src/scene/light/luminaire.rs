//! Luminaires of photometric files, and their mounting.

use std::sync::Arc;

use glam::{DQuat, DVec3};

use super::{Distribution, Photometry, PointLight, Up, Web, point::Area};

/// The mounting of a luminaire.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Mounting {
    /// The position, in the unit of the scene.
    pub position: DVec3,
    /// The direction in the scene that is straight down in the file; `None` for down in the scene too.
    pub aim: Option<DVec3>,
    /// Rotation about the vertical in radians, counter-clockwise as seen from above. It comes before the aim.
    pub rotation: f64,
    /// A factor of the intensity.
    pub dimming: f64,
}

/// The light of a photometric file. Before its rotation, C0 points along +x. C90 points along −z if y is up, and along
/// +y if z is up. A candela counts as 1 / `efficacy` W/sr.
pub fn luminaire(photometry: Photometry, up: Up, mounting: &Mounting, efficacy: f64) -> PointLight {
    let axes = [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]].map(|axis| up.to_scene(axis));
    let turn = DQuat::from_axis_angle(axes[2], mounting.rotation);
    let tip = mounting
        .aim
        .and_then(crate::scene::direction)
        .map_or(DQuat::IDENTITY, |aim| DQuat::from_rotation_arc(-axes[2], aim));
    let [c0, c90, upwards] = axes.map(|axis| tip * (turn * axis));
    let area = photometry.opening.map(|opening| Area {
        first: 0.5 * opening.length * c0,
        second: 0.5 * opening.width * c90,
        round: opening.round,
    });
    let peak = photometry.peak();
    let web = Web::new(photometry, [c0, c90, upwards]);
    let intensity = peak * mounting.dimming / efficacy;
    let distribution = Distribution::Web(Arc::new(web));
    PointLight { area, ..PointLight::new(mounting.position, [intensity; 3], distribution) }
}

#[cfg(test)]
mod tests {
    use super::super::measured::{Goniometer, Measured};
    use super::*;

    /// Intensities: 1, 2, 3 and 4 cd sideways in C0, C90, C180 and C270, and 10 cd down.
    fn four() -> Photometry {
        Photometry::new(Measured {
            goniometer: Goniometer::C,
            horizontal: vec![0.0, 90.0, 180.0, 270.0],
            vertical: vec![0.0, 90.0],
            candela: vec![10.0, 1.0, 10.0, 2.0, 10.0, 3.0, 10.0, 4.0],
            stated_flux: None,
            opening: None,
            warnings: Vec::new(),
        })
    }

    /// 0 degrees points down, and C0 along +x. C90 points along -z if y is up, and along +y if z is up.
    #[test]
    fn luminaires_hang_as_in_the_file() {
        let at = |up: Up, rotation: f64, aim: Option<DVec3>| {
            let mounting = Mounting { position: DVec3::ZERO, aim, rotation, dimming: 2.0 };
            let light = luminaire(four(), up, &mounting, 100.0);
            move |direction: DVec3| light.intensity[0] * light.distribution.towards(direction)
        };
        let close =
            |found: f64, cd: f64| assert!((found - cd * 2.0 / 100.0).abs() < 1e-9, "{found} for {cd}");
        for (up, c90, down) in [(Up::Y, -DVec3::Z, -DVec3::Y), (Up::Z, DVec3::Y, -DVec3::Z)] {
            let light = at(up, 0.0, None);
            close(light(down), 10.0);
            close(light(DVec3::X), 1.0);
            close(light(c90), 2.0);
            close(light(-DVec3::X), 3.0);
            close(light(-c90), 4.0);
            close(light(-down), 0.0);
            // A quarter turn counter-clockwise moves C0 to the former direction of C90.
            let turned = at(up, std::f64::consts::FRAC_PI_2, None);
            close(turned(c90), 1.0);
            close(turned(-DVec3::X), 2.0);
            // The luminaire is aimed along +x.
            close(at(up, 0.0, Some(3.0 * DVec3::X))(DVec3::X), 10.0);
        }
    }
}
