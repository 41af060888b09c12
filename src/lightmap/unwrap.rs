//! New texture coordinates, by [uvunwrap](https://docs.rs/uvunwrap): least-squares conformal maps of charts, packed
//! with room for bilinear filtering. Charts never run across a crease, because light is not continuous there.
//!
//! A chart that is much longer than the rest determines the texel density of a page and leaves most of the page empty.
//! A chart that is longer than a page does not fit at all. So if too few texels would hold surface, or a chart does not
//! fit, large charts are split in several ways, and the best layout is used.

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
    patch::{DisjointSets, within_solids},
    scene::{NEW_CORNER, Scene},
    trace::Tracer,
};

/// Charts end where the normal deviates by more than this many degrees from the chart's mean normal. Such charts are
/// flat enough for the map to keep areas.
const CHART_ANGLE: f32 = 45.0;
/// Empty texels around a chart. Neighbouring charts are twice as far apart, so bilinear samples of the map and of its
/// first mipmap do not mix charts.
const PADDING: u32 = 2;
/// A layout is good enough if this share of its texels holds surface. Packers rarely reach 80 %.
const ENOUGH: f64 = 0.6;
/// Longest charts to try, as shares of the side of a page.
const SHARES: [f64; 5] = [1.0, 0.5, 0.25, 0.125, 0.0625];
/// Divisors of the largest page side to try. Smaller pages leave less of the last page empty.
const PAGES: [usize; 3] = [1, 2, 4];
/// Pages smaller than this are not tried.
const SMALL_PAGE: usize = 128;

/// Makes new texture coordinates for a scene.
///
/// # Errors
/// [`Error::Setting`] when the map would be too small for the charts or too large altogether.
pub(super) fn unwrap(scene: &Scene, tracer: &Tracer, options: &AtlasOptions) -> Result<Atlas> {
    let within = within_solids(scene);
    let whole = Unwrapper::new((scene, &within), tracer, options, None);
    match options.layout {
        Layout::Resolution(side) => match whole.best_page(side) {
            Some(atlas) => Ok(atlas),
            None => Err(whole.too_small(side)),
        },
        Layout::Texel(length, page) => whole.best_pages(length, page),
    }
}

/// A scene prepared for uvunwrap.
struct Unwrapper<'a> {
    scene: &'a Scene,
    /// For each triangle of the scene, whether it is within solids. Nobody sees it, and no light is there.
    within: &'a [bool],
    tracer: &'a Tracer,
    options: &'a AtlasOptions,
    /// The facets, if triangles are cut or have second copies.
    cut: Option<Cut>,
    positions: Vec<[f32; 3]>,
    /// Facets grouped by their density factor.
    groups: Vec<(f64, Vec<u32>)>,
    /// The surface of each facet. Only facets of the same surface may share a chart.
    surfaces: Vec<u32>,
    /// The polygon of each facet. Facets of the same polygon stay on one chart.
    polygons: Vec<u32>,
}

impl<'a> Unwrapper<'a> {
    /// `longest` is the approximate largest length of a chart; `None` if charts are not to be split.
    fn new(
        (scene, within): (&'a Scene, &'a [bool]),
        tracer: &'a Tracer,
        options: &'a AtlasOptions,
        longest: Option<f64>,
    ) -> Self {
        let has_copies = options.two_sided.contains(&true);
        let long = longest.map(|longest| longer(scene, &surfaces(scene, options), longest));
        // A piece belongs to the cell that contains its middle. It reaches beyond the cell by up to two thirds of an
        // edge on each side.
        let edge = longest.map_or(f64::INFINITY, |longest| 0.42 * longest);
        let cut = (long.is_some() || has_copies)
            .then(|| Cut::new(scene, edge, long.as_deref().unwrap_or_default(), &options.two_sided));
        let facets = cut.as_ref().map_or(scene, |cut| &cut.scene);
        let mut unwrapper = Unwrapper {
            scene,
            within,
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
        let is_within =
            |f: usize| within[unwrapper.cut.as_ref().map_or(f, |cut| cut.facets[f].triangle as usize)];
        for (f, triangle) in facets.triangles.iter().enumerate().filter(|&(f, _)| !is_within(f)) {
            let factor = options.factor(triangle.material);
            groups.entry(factor.to_bits()).or_insert_with(|| (factor, Vec::new())).1.push(f as u32);
        }
        unwrapper.groups = groups.into_values().collect();
        unwrapper
    }

    /// The same scene with charts that are split to about this length.
    fn with_longest(&self, longest: f64) -> Unwrapper<'a> {
        Unwrapper::new((self.scene, self.within), self.tracer, self.options, Some(longest))
    }

    fn facets(&self) -> &Scene {
        self.cut.as_ref().map_or(self.scene, |cut| &cut.scene)
    }

    /// Splits the surfaces of the triangles marked in `long` at the cells of a grid, so that no chart spans several
    /// cells. A polygon belongs to the cell of its first triangle.
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
        // A bent polygon may lie on two surfaces, but uvunwrap requires each polygon to lie on one.
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

    /// Sum over all facets with a place in the map of area times squared density factor: the number of texels of unit
    /// length.
    fn weighted_area(&self) -> f64 {
        let facets = self.facets();
        let area = |members: &[u32]| members.iter().map(|&f| facets.area(f as usize)).sum::<f64>();
        self.groups.iter().map(|(factor, members)| factor * factor * area(members)).sum()
    }

    /// The best layout on one square page. Charts are split until the page is used well.
    fn best_page(&self, side: usize) -> Option<Atlas> {
        let mut best = self.page(side);
        for share in SHARES {
            if best.as_ref().is_some_and(|(used, atlas)| is_good(*used, atlas, share * side as f64)) {
                continue;
            }
            better(&mut best, self.split_into(share).page(side));
        }
        best.map(|(_, atlas)| atlas)
    }

    /// The scene with charts up to a share of the side of a single page that is used well.
    fn split_into(&self, share: f64) -> Unwrapper<'a> {
        let side = (self.weighted_area() / ENOUGH).sqrt();
        self.with_longest(share * side)
    }

    /// A layout on one square page, and the share of the page that holds surface. `None` if the charts do not fit, or
    /// if less than half of the surface is in charts that are wide enough.
    fn page(&self, side: usize) -> Option<(f64, Atlas)> {
        let made = self.generate(Density::Auto { page_size: side as u32 }).ok()?;
        let used = used(&made) / (side * side) as f64;
        let atlas = self.atlas(made, Some(side));
        (atlas.pages == 1 && atlas.thin_charts(self.scene).1 < 0.5).then_some((used, atlas))
    }

    fn too_small(&self, side: usize) -> Error {
        let message = format!("a map of {side} x {side} texels is too small for the charts of this scene");
        // Split charts may fit where whole ones do not.
        let split = SHARES.map(|share| self.split_into(share));
        let fits = |side| self.page(side).is_some() || split.iter().any(|split| split.page(side).is_some());
        let (mut low, mut high) = (side, 2 * side);
        while high <= LARGEST && !fits(high) {
            (low, high) = (high, 2 * high);
        }
        if high > LARGEST {
            let hint = "choose a length of texels instead: it takes as many pages as needed";
            return Error::setting(&[Setting::TexelLength], message, hint);
        }
        while high - low > 1 {
            let middle = low.midpoint(high);
            if fits(middle) { high = middle } else { low = middle }
        }
        Error::setting(
            &[Setting::Resolution],
            message,
            format!("the smallest resolution that works is {high}"),
        )
    }

    /// The best layout with texels of a given length, on one page if that is not too large, otherwise on several.
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
            // A single page grows as needed. Several pages have one size, so the last one may stay almost empty.
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
                    reached = attempt(&self.with_longest(longest));
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
                .map_or_else(|error| error, |_| unreachable!("a layout that was made is the best one"))),
        }
    }

    /// A layout with texels of a given length, and the share of its texels that holds surface. The pages have a side of
    /// `page` texels. Without `page` there is a single page with a side of up to `most` texels.
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

    /// Converts the result of uvunwrap. uvunwrap crops a single page; `side` restores the side of the page.
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

/// The surface of each triangle. Triangles belong to the same surface if one chart may hold both.
fn surfaces(facets: &Scene, options: &AtlasOptions) -> Vec<u32> {
    let mut sets = DisjointSets::new(facets.triangles.len());
    for [e, f] in smooth_edges(facets, CREASE) {
        let (t, u) = (e as usize / 3, f as usize / 3);
        // If a lamp is flush with a wall, irradiance is continuous across its edge but radiosity is not: viewers that
        // show the map would blur the lamp's edge. Triangles with different density factors cannot share a chart.
        let factor = |t: usize| options.factor(facets.triangles[t].material);
        if facets.emits(t) == facets.emits(u) && factor(t) == factor(u) {
            sets.unite(t, u);
        }
    }
    sets.numbers().0
}

/// For each triangle, whether its surface's bounding box has a side longer than `longest`.
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

/// Approximate number of texels that hold surface.
fn used(made: &uvunwrap::Atlas) -> f64 {
    f64::from(made.utilization)
        * f64::from(made.width)
        * f64::from(made.height)
        * f64::from(made.page_count.max(1))
}

/// Whether a layout is used well, or has no chart longer than `side` texels, so that splitting charts would not help.
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

/// The polygon of each facet. A face is a polygon if none of its triangles is cut; otherwise each of its facets is a
/// polygon of its own.
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
    // After holes and hidden parts were cut away, the rest of a face may be in several pieces.
    let faces = if scene.face_corners.len() == triangles { scene.faces.len() } else { 0 };
    if faces == 0 {
        return (0..cut.map_or(triangles, |cut| cut.facets.len()) as u32).collect();
    }
    let mut count: Vec<usize> = (0..faces).map(|face| scene.degenerates_of(face)).collect();
    face_of.iter().for_each(|&face| count[face] += 1);
    // A face lacks triangles if parts of it are hidden or holes.
    let has_all = |face: usize| match scene.faces.get(face + 1) {
        Some(next) => count[face] >= (next.first - scene.faces[face].first) as usize,
        None => scene.hidden.is_empty(),
    };
    let mut is_whole: Vec<bool> = (0..faces).map(has_all).collect();
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
        // Polygons of first copies are numbered first, then those of second copies, then single facets.
        let polygon = if is_whole[face] { face + faces * usize::from(facet.turned) } else { 2 * faces + f };
        polygon as u32
    };
    cut.facets.iter().enumerate().map(number).collect()
}
