//! New texture coordinates, by [uvunwrap](https://docs.rs/uvunwrap): least squares conformal maps of charts that never run
//! across a crease, where light is not continuous, packed with room for bilinear filtering.
//!
//! A chart that is much longer than the rest sets the density of a page and leaves most of it empty, and one that is longer
//! than a page has no place at all. So where too few texels would hold surface, or a chart has no place, large charts are
//! split, in several ways, and the best is taken.

use std::collections::{BTreeMap, HashMap};

use glam::{DVec2, DVec3};
use uvunwrap::{Density, MeshInput, Options};

use super::{
    atlas::{Atlas, AtlasOptions, CREASE, LARGEST, Layout, NONE},
    cut::Cut,
};
use crate::{
    Error, Result, Setting,
    output::surfaces::smooth_edges,
    patch::DisjointSets,
    scene::{NEW_CORNER, Scene},
    trace::Tracer,
};

/// Charts end where normals turn by more than this many degrees from the mean of the chart: flat enough to keep areas.
const CHART_ANGLE: f32 = 45.0;
/// Empty texels round a chart: neighbours are twice as far apart, so that neither bilinear samples nor those of the first
/// mipmap mix charts.
const PADDING: u32 = 2;
/// A layout of which this share of the texels holds surface is good enough: packers rarely reach 80 %.
const ENOUGH: f64 = 0.6;
/// Charts are made at most this many times shorter than a page.
const SHARES: [f64; 5] = [1.0, 0.5, 0.25, 0.125, 0.0625];
/// Pages are made at most this many times smaller than allowed, so that the last of them is not left empty.
const PAGES: [usize; 3] = [1, 2, 4];
/// Pages are not made smaller than this to use them better.
const SMALL_PAGE: usize = 128;

/// Makes new coordinates.
///
/// # Errors
/// [`Error::Setting`] when the map would be too small for the charts or too large altogether.
pub(super) fn unwrap(scene: &Scene, tracer: &Tracer, options: &AtlasOptions) -> Result<Atlas> {
    let whole = Unwrapper::new(scene, tracer, options, None);
    match options.layout {
        Layout::Resolution(side) => match whole.best_page(side) {
            Some(atlas) => Ok(atlas),
            None => Err(whole.too_small(side)),
        },
        Layout::Texel(length, page) => whole.best_pages(length, page),
    }
}

/// A scene as uvunwrap wants it.
struct Unwrapper<'a> {
    scene: &'a Scene,
    tracer: &'a Tracer,
    options: &'a AtlasOptions,
    /// The facets, where triangles are cut or have second copies.
    cut: Option<Cut>,
    positions: Vec<[f32; 3]>,
    /// Facets by how dense their texels are, with the factor.
    groups: Vec<(f64, Vec<u32>)>,
    /// What may share a chart, of each facet.
    surfaces: Vec<u32>,
    /// The polygon of each facet, whose triangles stay on one chart.
    polygons: Vec<u32>,
}

impl<'a> Unwrapper<'a> {
    /// `longest` is how long charts may be, about, where they are to be split.
    fn new(scene: &'a Scene, tracer: &'a Tracer, options: &'a AtlasOptions, longest: Option<f64>) -> Self {
        let has_copies = options.two_sided.contains(&true);
        let long = longest.map(|longest| longer(scene, &surfaces(scene, options), longest));
        // Pieces reach beyond the cell that their middle is in, by up to two thirds of an edge on each side.
        let edge = longest.map_or(f64::INFINITY, |longest| 0.42 * longest);
        let cut = (long.is_some() || has_copies)
            .then(|| Cut::new(scene, edge, long.as_deref().unwrap_or_default(), &options.two_sided));
        let facets = cut.as_ref().map_or(scene, |cut| &cut.scene);
        let mut unwrapper = Unwrapper {
            scene,
            tracer,
            options,
            positions: facets.vertices.iter().map(|&v| tracer.to_unit(v).to_array()).collect(),
            groups: Vec::new(),
            surfaces: surfaces(facets, options),
            polygons: polygons(scene, cut.as_ref()),
            cut,
        };
        if let Some(long) = long {
            unwrapper.split(edge, &long);
        }
        let facets = unwrapper.facets();
        let mut groups: BTreeMap<u64, (f64, Vec<u32>)> = BTreeMap::new();
        for (f, triangle) in facets.triangles.iter().enumerate() {
            let factor = options.factor(triangle.material);
            groups.entry(factor.to_bits()).or_insert_with(|| (factor, Vec::new())).1.push(f as u32);
        }
        unwrapper.groups = groups.into_values().collect();
        unwrapper
    }

    fn facets(&self) -> &Scene {
        self.cut.as_ref().map_or(self.scene, |cut| &cut.scene)
    }

    /// Lets no chart of the triangles that `long` marks run from one cell of a grid to another. A polygon is where its first
    /// triangle is.
    fn split(&mut self, cell: f64, long: &[bool]) {
        let facets = self.facets();
        let is_long = |f: usize| long[self.cut.as_ref().map_or(f, |cut| cut.facets[f].triangle as usize)];
        let place = |f: usize| {
            if !is_long(f) {
                return [0; 3];
            }
            let [a, b, c] = facets.corners(f);
            (((a + b + c) / 3.0) / cell).floor().to_array().map(|x| x as i64)
        };
        let (mut numbers, mut of_polygon) = (HashMap::new(), HashMap::new());
        let surfaces = (0..self.surfaces.len())
            .map(|f| {
                let cell = *of_polygon.entry(self.polygons[f]).or_insert_with(|| place(f));
                let next = numbers.len() as u32;
                *numbers.entry((self.surfaces[f], cell)).or_insert(next)
            })
            .collect();
        self.surfaces = surfaces;
    }

    fn generate(&self, density: Density) -> std::result::Result<uvunwrap::Atlas, uvunwrap::Error> {
        let facets = &self.facets().triangles;
        // A bent polygon may be on two surfaces; uvunwrap wants a polygon to be on one.
        let polygon = |f: u32| {
            let (polygon, surface) = (self.polygons[f as usize], self.surfaces[f as usize]);
            (polygon, surface)
        };
        let mut numbers = HashMap::new();
        let groups: Vec<(f64, [Vec<u32>; 3])> = self
            .groups
            .iter()
            .map(|(factor, members)| {
                let indices = members.iter().flat_map(|&f| facets[f as usize].vertices).collect();
                let surfaces = members.iter().map(|&f| self.surfaces[f as usize]).collect();
                let polygons = members.iter().map(|&f| {
                    let next = numbers.len() as u32;
                    *numbers.entry(polygon(f)).or_insert(next)
                });
                (*factor, [indices, surfaces, polygons.collect()])
            })
            .collect();
        let meshes: Vec<MeshInput> = groups
            .iter()
            .map(|(factor, [indices, surfaces, polygons])| MeshInput {
                face_materials: Some(surfaces),
                polygons: Some(polygons),
                scale: *factor as f32,
                ..MeshInput::new(&self.positions, indices)
            })
            .collect();
        let options =
            Options { max_chart_angle: CHART_ANGLE, density, padding: PADDING, ..Options::default() };
        uvunwrap::generate(&meshes, &options)
    }

    /// Area of all facets in texels of unit length, with their densities.
    fn weighted_area(&self) -> f64 {
        let facets = self.facets();
        let area = |f: usize| facets.area(f) * self.options.factor(facets.triangles[f].material).powi(2);
        (0..facets.triangles.len()).map(area).sum()
    }

    /// One square page, with charts as short as it takes to use it well.
    fn best_page(&self, side: usize) -> Option<Atlas> {
        let mut best = self.page(side);
        let texel = (self.weighted_area() / ENOUGH).sqrt() / side as f64;
        for share in SHARES {
            if best.as_ref().is_some_and(|(used, atlas)| is_good(*used, atlas, share * side as f64)) {
                continue;
            }
            let longest = share * side as f64 * texel;
            let split = Unwrapper::new(self.scene, self.tracer, self.options, Some(longest));
            better(&mut best, split.page(side));
        }
        best.map(|(_, atlas)| atlas)
    }

    /// One square page, where most of the surface is in charts that are wide enough; and the share of it that is used.
    fn page(&self, side: usize) -> Option<(f64, Atlas)> {
        let made = self.generate(Density::Auto { page_size: side as u32 }).ok()?;
        let used = used(&made) / (side * side) as f64;
        let atlas = self.atlas(made, Some(side));
        (atlas.pages == 1 && atlas.thin_charts(self.scene).1 < 0.5).then_some((used, atlas))
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

    /// Texels of a length on one page if it is not too large, else on several, used well.
    fn best_pages(&self, length: f64, page: usize) -> Result<Atlas> {
        let texels = self.weighted_area() / (length * length);
        let most = (1u64 << 30) as f64;
        if !(texels < most) {
            let least = (self.weighted_area() / most).sqrt();
            return Err(Error::setting(
                &[Setting::TexelLength],
                format!("texels of length {length} are too small: the surface has {texels:.1e} of them"),
                format!("a length of {least:.2e} would do: choose longer texels"),
            ));
        }
        let fits_one = texels <= (page * page) as f64;
        let mut best = None;
        for side in PAGES.map(|n| page / n).into_iter().filter(|&side| side >= page.min(SMALL_PAGE)) {
            // One page grows to what it takes; pages of one size may leave the last one empty.
            let mut attempt = |layout: &Unwrapper| {
                if fits_one && side == page {
                    better(&mut best, layout.pages(length, None, page).ok());
                }
                if best.as_ref().is_none_or(|(used, _)| *used < ENOUGH) {
                    better(&mut best, layout.pages(length, Some(side), side).ok());
                }
                best.as_ref().map(|(used, atlas)| (*used, atlas.longest_chart()))
            };
            let mut reached = attempt(self);
            for share in &SHARES[..3] {
                let is_good = |(used, longest)| used >= ENOUGH || longest <= share * side as f64;
                if !reached.is_some_and(is_good) {
                    let longest = share * side.saturating_sub(2 * PADDING as usize) as f64 * length;
                    reached = attempt(&Unwrapper::new(self.scene, self.tracer, self.options, Some(longest)));
                }
            }
            if reached.is_some_and(|(used, _)| used >= ENOUGH) {
                break;
            }
        }
        match best {
            Some((_, atlas)) => Ok(atlas),
            None => Err(self
                .pages(length, Some(page), page)
                .map_or_else(|error| error, |_| unreachable!("what was made is the best"))),
        }
    }

    /// Texels of a length on pages of a size, or on one page of up to `most` texels a side; and the share of them that is used.
    fn pages(&self, length: f64, page: Option<usize>, most: usize) -> Result<(f64, Atlas)> {
        let texels_per_unit = (self.tracer.scale() / length) as f32;
        let density = Density::Fixed { texels_per_unit, page_size: page.map(|page| page as u32) };
        let too_large = |width: u32, height: u32| {
            Error::setting(
                &[Setting::Resolution, Setting::TexelLength],
                format!("a chart of {width} x {height} texels does not fit a page of {most} x {most}"),
                "choose larger pages or longer texels",
            )
        };
        match self.generate(density) {
            Ok(made) if made.width.max(made.height) as usize > most => {
                Err(too_large(made.width, made.height))
            }
            Ok(made) => {
                let whole = made.width as f64 * made.height as f64 * f64::from(made.page_count.max(1));
                Ok((used(&made) / whole, self.atlas(made, None)))
            }
            Err(uvunwrap::Error::ChartTooLarge { width, height, .. }) => Err(too_large(width, height)),
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
        let facets = self.facets().triangles.len();
        let (mut coordinates, mut corners) = (Vec::new(), vec![[0; 3]; facets]);
        let (mut chart, mut page) = (vec![NONE; facets], vec![0; facets]);
        for (mesh, (_, members)) in made.meshes.iter().zip(&self.groups) {
            let first = coordinates.len() as u32;
            coordinates.extend(mesh.vertices.iter().map(|v| DVec2::from(v.uv.map(f64::from)) * scale));
            for (&f, indices) in members.iter().zip(mesh.indices.as_chunks::<3>().0) {
                let f = f as usize;
                corners[f] = indices.map(|i| first + i);
                let [a, b, c] = corners[f].map(|i| coordinates[i as usize]);
                let vertex = &mesh.vertices[indices[0] as usize];
                chart[f] = vertex.chart.filter(|_| (b - a).perp_dot(c - a) != 0.0).unwrap_or(NONE);
                page[f] = vertex.page.unwrap_or(0);
            }
        }
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
            cut: self.cut.clone(),
        }
    }
}

/// The surface of each triangle: what may be one chart.
fn surfaces(facets: &Scene, options: &AtlasOptions) -> Vec<u32> {
    let mut sets = DisjointSets::new(facets.triangles.len());
    for [e, f] in smooth_edges(facets, CREASE) {
        let (t, u) = (e as usize / 3, f as usize / 3);
        // Where a lamp is flush with a wall, what leaves is not continuous though what arrives is: viewers that
        // show the map would blur the lamp's edge. Where densities differ there is no common chart.
        let factor = |t: usize| options.factor(facets.triangles[t].material);
        if facets.emits(t) == facets.emits(u) && factor(t) == factor(u) {
            sets.unite(t, u);
        }
    }
    sets.numbers().0
}

/// Which triangles are of a surface that is longer than this.
fn longer(scene: &Scene, surfaces: &[u32], longest: f64) -> Vec<bool> {
    let count = surfaces.iter().max().map_or(0, |most| *most as usize + 1);
    let mut boxes = vec![[DVec3::INFINITY, DVec3::NEG_INFINITY]; count];
    for (t, &surface) in surfaces.iter().enumerate() {
        for corner in scene.corners(t) {
            let [low, high] = &mut boxes[surface as usize];
            (*low, *high) = (low.min(corner), high.max(corner));
        }
    }
    let is_long = |surface: &u32| {
        let [low, high] = boxes[*surface as usize];
        (high - low).max_element() > longest
    };
    surfaces.iter().map(is_long).collect()
}

/// Texels that hold surface, about.
fn used(made: &uvunwrap::Atlas) -> f64 {
    f64::from(made.utilization)
        * f64::from(made.width)
        * f64::from(made.height)
        * f64::from(made.page_count.max(1))
}

/// Whether a layout is used well, or has no chart longer than a side, in texels, so that shorter charts would not help.
fn is_good(used: f64, atlas: &Atlas, side: f64) -> bool {
    used >= ENOUGH || atlas.longest_chart() <= side
}

fn better(best: &mut Option<(f64, Atlas)>, other: Option<(f64, Atlas)>) {
    if let Some(other) = other
        && best.as_ref().is_none_or(|best| other.0 > best.0)
    {
        *best = Some(other);
    }
}

/// The polygon of each facet: a face none of whose triangles is cut, or a facet alone.
fn polygons(scene: &Scene, cut: Option<&Cut>) -> Vec<u32> {
    let mut face = 0;
    let face_of: Vec<usize> = (0..scene.triangles.len())
        .map(|t| {
            let source = scene.triangles[t].source;
            while scene.faces.get(face + 1).is_some_and(|next| next.first <= source) {
                face += 1;
            }
            face
        })
        .collect();
    let triangles = scene.triangles.len();
    // What is left of a face after holes and hidden parts were cut away may be in several pieces.
    let faces = if scene.face_corners.len() == triangles { scene.faces.len() } else { 0 };
    if faces == 0 {
        return (0..cut.map_or(triangles, |cut| cut.facets.len()) as u32).collect();
    }
    let mut is_whole = vec![true; faces];
    for t in 0..triangles {
        is_whole[face_of[t]] &= scene.face_corners[t].iter().all(|corner| corner & NEW_CORNER == 0);
        is_whole[face_of[t]] &= cut.is_none_or(|cut| cut.facets_of(t, false).len() == 1);
    }
    let Some(cut) = cut else {
        let number = |(t, face): (usize, usize)| if is_whole[face] { face } else { faces + t } as u32;
        return face_of.into_iter().enumerate().map(number).collect();
    };
    let number = |(f, facet): (usize, &super::cut::Facet)| {
        let face = face_of[facet.triangle as usize];
        // Those of second copies come after those of first ones, and facets alone after all.
        let polygon = if is_whole[face] { face + faces * usize::from(facet.turned) } else { 2 * faces + f };
        polygon as u32
    };
    cut.facets.iter().enumerate().map(number).collect()
}
