//! Luminaires of photometric files: how they hang.

use std::sync::Arc;

use glam::{DQuat, DVec3};

use super::{Distribution, Photometry, PointLight, Up, Web, point::Area};

/// How a luminaire hangs.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Mounting {
    /// Where, in the unit of the scene.
    pub position: DVec3,
    /// Where straight down of the file points; `None` is down.
    pub aim: Option<DVec3>,
    /// Turned by this about the vertical, in radians, counter-clockwise as seen from above.
    pub rotation: f64,
    /// A factor of its intensity.
    pub dimming: f64,
}

/// The light of a photometric file: C0 along +x, C90 along −z where y is up and along +y where z is up, before it is turned. A candela
/// counts as 1 / `efficacy` W/sr.
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

    /// Candela by plane: sideways 1, 2, 3, 4 in C0, C90, C180 and C270; down 10.
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

    /// As the contract has it: 0 degrees looks down, C0 along +x, C90 along -z where y is up and +y where z is up.
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
            // A quarter turn counter-clockwise brings C0 to where C90 was.
            let turned = at(up, std::f64::consts::FRAC_PI_2, None);
            close(turned(c90), 1.0);
            close(turned(-DVec3::X), 2.0);
            // Aimed along +x.
            close(at(up, 0.0, Some(3.0 * DVec3::X))(DVec3::X), 10.0);
        }
    }
}
