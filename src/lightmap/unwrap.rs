//! New texture coordinates, by [uvunwrap](https://docs.rs/uvunwrap): least squares conformal maps of charts that never run
//! across a crease, where light is not continuous, packed with room for bilinear filtering.

use glam::DVec2;
use uvunwrap::{Density, MeshInput, Options};

use super::atlas::{Atlas, CREASE, LARGEST, Layout, NONE};
use crate::{
    Error, Result, Setting,
    output::surfaces::{DisjointSets, smooth_edges},
    scene::Scene,
    trace::Tracer,
};

/// Charts end where normals turn by more than this many degrees from the mean of the chart: flat enough to keep areas.
const CHART_ANGLE: f32 = 45.0;
/// Empty texels round a chart: neighbours are twice as far apart, so that neither bilinear samples nor those of the first
/// mipmap mix charts.
const PADDING: u32 = 2;

/// Makes new coordinates.
///
/// # Errors
/// [`Error::Usage`] when the map would be too small for the charts or too large altogether.
pub(super) fn unwrap(scene: &Scene, tracer: &Tracer, layout: Layout) -> Result<Atlas> {
    let unwrapper = Unwrapper::new(scene, tracer);
    match layout {
        Layout::Resolution(side) => match unwrapper.page(side) {
            Some(atlas) => Ok(atlas),
            None => Err(unwrapper.too_small(side)),
        },
        Layout::Texel(length, page) => unwrapper.pages(length, page),
    }
}

/// A scene as uvunwrap wants it.
struct Unwrapper<'a> {
    scene: &'a Scene,
    scale: f64,
    positions: Vec<[f32; 3]>,
    indices: Vec<u32>,
    /// Smooth surface of each triangle.
    surfaces: Vec<u32>,
}

impl<'a> Unwrapper<'a> {
    fn new(scene: &'a Scene, tracer: &Tracer) -> Self {
        let mut sets = DisjointSets::new(scene.triangles.len());
        for [e, f] in smooth_edges(scene, CREASE) {
            let (t, u) = (e as usize / 3, f as usize / 3);
            // Where a lamp is flush with a wall, what leaves is not continuous though what arrives is: viewers that
            // show the map would blur the lamp's edge.
            if scene.emits(t) == scene.emits(u) {
                sets.unite(t, u);
            }
        }
        Unwrapper {
            scene,
            scale: tracer.scale(),
            positions: scene.vertices.iter().map(|&v| tracer.to_unit(v).to_array()).collect(),
            indices: scene.triangles.iter().flat_map(|t| t.vertices).collect(),
            surfaces: sets.numbers().0,
        }
    }

    fn generate(&self, density: Density) -> std::result::Result<uvunwrap::Atlas, uvunwrap::Error> {
        let mesh = MeshInput {
            face_materials: Some(&self.surfaces),
            ..MeshInput::new(&self.positions, &self.indices)
        };
        let options =
            Options { max_chart_angle: CHART_ANGLE, density, padding: PADDING, ..Options::default() };
        uvunwrap::generate(&[mesh], &options)
    }

    /// One square page, where most of the surface is in charts that are wide enough.
    fn page(&self, side: usize) -> Option<Atlas> {
        let made = self.generate(Density::Auto { page_size: side as u32 }).ok()?;
        let atlas = self.atlas(made, Some(side));
        (atlas.pages == 1 && atlas.thin_charts(self.scene).1 < 0.5).then_some(atlas)
    }

    fn too_small(&self, side: usize) -> Error {
        let message = format!("a map of {side} x {side} texels is too small for the charts of this scene");
        let (mut low, mut high) = (side, 2 * side);
        while high <= LARGEST && self.page(high).is_none() {
            (low, high) = (high, 2 * high);
        }
        if high > LARGEST {
            let hint = "choose a length of texels instead: it takes as many pages as needed";
            return Error::setting(&[Setting::TexelLength], message, hint);
        }
        while high - low > 1 {
            let middle = low.midpoint(high);
            if self.page(middle).is_some() { high = middle } else { low = middle }
        }
        Error::setting(
            &[Setting::Resolution],
            message,
            format!("the smallest resolution that works is {high}"),
        )
    }

    /// Texels of a length on one page if it is not too large, else on several.
    fn pages(&self, length: f64, page: usize) -> Result<Atlas> {
        let texels_per_unit = (self.scale / length) as f32;
        let too_many = |side: f64| {
            Error::setting(
                &[Setting::TexelLength],
                format!("texels of length {length} are too small: a chart would be {side:.0} of them long"),
                format!("a map has at most {LARGEST} texels a side: choose longer texels"),
            )
        };
        let longest = 2.0 * self.scale / length;
        if !(longest < 4.0 * LARGEST as f64) {
            return Err(too_many(longest));
        }
        let density = |page_size| Density::Fixed { texels_per_unit, page_size };
        let surface: f64 = (0..self.scene.triangles.len()).map(|t| self.scene.area(t)).sum();
        let fits_one = surface / (length * length) <= (page * page) as f64;
        let fits = |made: &uvunwrap::Atlas| made.width.max(made.height) as usize <= page;
        if fits_one
            && let Ok(one) = self.generate(density(None))
            && fits(&one)
        {
            return Ok(self.atlas(one, None));
        }
        match self.generate(density(Some(page as u32))) {
            Ok(several) => Ok(self.atlas(several, None)),
            Err(uvunwrap::Error::ChartTooLarge { width, height, .. }) => {
                let side = width.max(height) as usize;
                if side > LARGEST {
                    return Err(too_many(side as f64));
                }
                Err(Error::setting(
                    &[Setting::Resolution],
                    format!("a chart of {width} x {height} texels does not fit a page of {page} x {page}"),
                    format!("the smallest page that works has a resolution of {side}"),
                ))
            }
            Err(other) => Err(Error::setting(
                &[Setting::TexelLength],
                format!("the surface cannot be unfolded with texels of length {length}: {other}"),
                "choose longer texels",
            )),
        }
    }

    /// What uvunwrap made, on pages of `side` texels a side where that is given: it crops a single page.
    fn atlas(&self, made: uvunwrap::Atlas, side: Option<usize>) -> Atlas {
        let (width, height) = (made.width as usize, made.height as usize);
        let (page_width, page_height) = side.map_or((width, height), |s| (s.max(width), s.max(height)));
        let scale = DVec2::new(width as f64 / page_width as f64, height as f64 / page_height as f64);
        let mesh = &made.meshes[0];
        let corners: Vec<[u32; 3]> = mesh.indices.as_chunks().0.to_vec();
        let vertex = |t: usize| mesh.vertices[corners[t][0] as usize];
        let coordinates: Vec<DVec2> =
            mesh.vertices.iter().map(|v| DVec2::from(v.uv.map(f64::from)) * scale).collect();
        let has_area = |t: usize| {
            let [a, b, c] = corners[t].map(|i| coordinates[i as usize]);
            (b - a).perp_dot(c - a) != 0.0
        };
        let chart =
            (0..corners.len()).map(|t| vertex(t).chart.filter(|_| has_area(t)).unwrap_or(NONE)).collect();
        let page = (0..corners.len()).map(|t| vertex(t).page.unwrap_or(0)).collect();
        Atlas {
            width: page_width,
            height: page_height,
            pages: made.page_count.max(1) as usize,
            coordinates,
            corners,
            chart,
            page,
            charts: made.chart_count as usize,
            refused: None,
        }
    }
}
