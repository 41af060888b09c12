//! Pictures of a radiosity solution, with the camera and film of path and light tracing.

use glam::DVec3;

use super::{
    final_gather::{FinalGather, outgoing, positive},
    vertex_colors,
    vertices::{CREASE, PatchMesh},
};
use crate::{
    Progress, Result,
    monte_carlo::{Camera, Film, Receiver, RenderOptions},
    patch::Patches,
    scene::Scene,
    solve::{Light, Solution},
    trace::{Hit, Tracer},
};

/// A solution with smooth light: irradiance at the vertices, interpolated linearly over each patch.
///
/// It interpolates irradiance instead of radiosity, so that textures stay sharp. Without textures there is no
/// difference, because vertices are shared within one material only.
#[derive(Debug)]
pub struct SmoothSurface<'a> {
    scene: &'a Scene,
    patches: &'a Patches,
    mesh: PatchMesh,
    irradiance: Vec<[f64; 3]>,
}

impl<'a> SmoothSurface<'a> {
    /// Averages the irradiance of the patches at the vertices.
    ///
    /// # Panics
    /// If the light belongs to other patches.
    pub fn new<'l>(scene: &'a Scene, patches: &'a Patches, light: impl Into<Light<'l>>) -> Self {
        let mesh = PatchMesh::new(scene, patches, CREASE);
        let values = vertex_colors::irradiance(scene, patches, &mesh, light.into());
        SmoothSurface { scene, patches, mesh, irradiance: positive(&values, patches.channels()) }
    }

    /// Radiance that leaves a hit point, W/(m² sr). Zero on backs that no ray of the solution hit.
    pub fn radiance(&self, hit: &Hit) -> [f64; 3] {
        self.irradiance(hit).map_or([0.0; 3], |irradiance| outgoing(self.scene, hit, irradiance))
    }

    /// Irradiance of a hit point, W/m². `None` on backs that no ray of the solution hit.
    fn irradiance(&self, hit: &Hit) -> Option<DVec3> {
        let patch = self.patches.at(hit.triangle, hit.barycentric, hit.front)?;
        let corners = self.mesh.corners(patch as usize);
        let weights = self.patches.local(patch as usize, hit.barycentric);
        Some((0..3).map(|k| DVec3::from(self.irradiance[corners[k] as usize]) * weights[k]).sum())
    }
}

/// A picture of the irradiance of surfaces, W/m². Pixels without a surface are 0. The light is smoothed over each
/// patch, or gathered with `gather` rays per sample.
///
/// # Errors
/// [`Error::Stopped`](crate::Error::Stopped).
///
/// # Panics
/// If the solution belongs to other patches.
pub fn irradiance(
    scene: &Scene,
    tracer: &Tracer,
    (patches, solution): (&Patches, &Solution),
    camera: &Camera,
    gather: Option<u32>,
    options: &RenderOptions,
    progress: &Progress,
) -> Result<Film> {
    let lens = camera.lens(tracer);
    let surface = SmoothSurface::new(scene, patches, solution);
    let gather = gather.map(|rays| FinalGather::new(scene, tracer, patches, solution, rays));
    Film::sample(&lens, options, progress, |direction, samples| {
        let Some(hit) = tracer.closest(lens.eye(), direction) else { return [0.0; 3] };
        match &gather {
            Some(gather) => gather.irradiance(Receiver::of_hit(tracer, &hit), samples),
            None => surface.irradiance(&hit).unwrap_or_default().to_array(),
        }
    })
}

/// A picture of a solution. The light is smoothed over each patch, or gathered with `gather` rays per sample.
///
/// # Errors
/// [`Error::Stopped`](crate::Error::Stopped).
///
/// # Panics
/// If the solution belongs to other patches.
pub fn render(
    scene: &Scene,
    tracer: &Tracer,
    (patches, solution): (&Patches, &Solution),
    camera: &Camera,
    gather: Option<u32>,
    options: &RenderOptions,
    progress: &Progress,
) -> Result<Film> {
    match gather {
        Some(rays) => {
            let lens = camera.lens(tracer);
            let gather = FinalGather::new(scene, tracer, patches, solution, rays);
            Film::sample(&lens, options, progress, |direction, samples| {
                gather.radiance(lens.eye(), direction, samples)
            })
        }
        None => smooth(scene, tracer, (patches, solution.into()), camera, options, progress),
    }
}

/// A picture of the light on patches, smoothed over each patch ([`SmoothSurface`]).
///
/// # Errors
/// [`Error::Stopped`](crate::Error::Stopped).
///
/// # Panics
/// If the light belongs to other patches.
pub fn smooth(
    scene: &Scene,
    tracer: &Tracer,
    (patches, light): (&Patches, Light),
    camera: &Camera,
    options: &RenderOptions,
    progress: &Progress,
) -> Result<Film> {
    let lens = camera.lens(tracer);
    let surface = SmoothSurface::new(scene, patches, light);
    Film::sample(&lens, options, progress, |direction, _| match tracer.closest(lens.eye(), direction) {
        Some(hit) => surface.radiance(&hit),
        None => scene.lights.seen(direction.as_dvec3()),
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{
        form_factor::{CastOptions, FormFactors},
        patch::Subdivision,
        scene::Material,
        solve::{SolveOptions, Solver, solve},
    };
    use glam::dvec3;

    /// A unit square at z = 0. One of its two triangles is brighter than the other.
    fn square() -> (Scene, Patches, Solution) {
        let [a, b, c, d] = [dvec3(0., 0., 0.), dvec3(1., 0., 0.), dvec3(1., 1., 0.), dvec3(0., 1., 0.)];
        let material = Material::new("m", [0.5, 0.25, 1.0], [1.0, 0.0, 0.0]);
        let scene = Scene::new(&[([a, b, c], 0), ([a, c, d], 0)], vec![material]);
        let patches = Patches::subdivide(&scene, &Subdivision::Edge(f64::INFINITY));
        let irradiance = vec![3.0, 6.0, 9.0, 1.0, 2.0, 3.0];
        let solution = Solution {
            channels: 3,
            radiosity: vec![0.0; 6],
            irradiance,
            reflected: vec![0.0; 6],
            solver: Solver::Direct,
            iterations: 0,
            residual: 0.0,
            error_bound: 0.0,
            linear: None,
        };
        (scene, patches, solution)
    }

    #[test]
    fn irradiance_is_linear_between_vertices_and_emission_comes_on_top() {
        let (scene, patches, solution) = square();
        let surface = SmoothSurface::new(&scene, &patches, &solution);
        let pi = std::f64::consts::PI;
        let seen = |barycentric, front| surface.radiance(&Hit { triangle: 0, front, t: 1.0, barycentric });
        // Corners a and c belong to both triangles with equal angles, so their red irradiance is 2. Corner b belongs to
        // the first triangle only, so it has 3.
        for (barycentric, red) in [([1., 0., 0.], 2.0), ([0., 1., 0.], 3.0), ([0.25, 0.5, 0.25], 2.5)] {
            let got = seen(barycentric, true);
            let want = [1.0 + 0.5 * red / pi, 0.25 * 2.0 * red / pi, 3.0 * red / pi];
            assert!((0..3).all(|c| (got[c] - want[c]).abs() < 1e-6), "{got:?} {want:?}");
        }
        assert_eq!(seen([0.2, 0.3, 0.5], false), [0.0; 3]);
    }

    #[test]
    fn the_emission_is_not_counted_twice() {
        // Under a lamp that reflects nothing, the final gather has direct light only: π L F.
        let lamp = [dvec3(0., 1., 0.), dvec3(1., 1., 0.), dvec3(0., 1., 1.)];
        let floor = [dvec3(0., 0., 0.), dvec3(0., 0., 1.), dvec3(1., 0., 0.)];
        let materials =
            vec![Material::new("floor", [0.5; 3], [0.0; 3]), Material::new("lamp", [0.0; 3], [2.0; 3])];
        let scene = Scene::new(&[(floor, 0), (lamp, 1)], materials);
        let tracer = Tracer::new(&scene);
        let mut patches = Patches::subdivide(&scene, &Subdivision::Count(8));
        let progress = Progress::new();
        let factors = FormFactors::cast(&scene, &tracer, &mut patches, &CastOptions::default(), &progress);
        let solution = solve(&factors.unwrap(), &patches, &SolveOptions::default(), &progress).unwrap();
        let gather = FinalGather::new(&scene, &tracer, &patches, &solution, 4);
        let point = dvec3(0.25, 0.0, 0.25);
        let at = crate::monte_carlo::Receiver::free(&tracer, point, DVec3::Y);
        let effort = crate::monte_carlo::Effort::default();
        let found = gather.irradiances(&[at], &effort, &progress).unwrap()[0];
        let want =
            2.0 * std::f64::consts::PI * crate::form_factor::exact::point_to_polygon(point, DVec3::Y, &lamp);
        assert!(
            (found.mean[0] - want).abs() < 4.0 * found.standard_error[0]
                && found.standard_error[0] < 0.01 * want
        );
    }
}
