//! The layout of a map: the place of each triangle in it.
//!
//! The texture coordinates of the file are used if they suit a lightmap: they lie inside the unit square, do not
//! overlap, leave room between charts and use half of the texels. Otherwise new coordinates are made.

use std::collections::HashMap;

use glam::DVec2;

use super::{cut::Cut, overlap, raster, unwrap::unwrap};
use crate::{
    Error, Result, Setting,
    patch::DisjointSets,
    scene::{Scene, in_triangle},
    trace::Tracer,
};

/// The chart number of facets without a place in the map.
pub const NONE: u32 = u32::MAX;
/// Charts end at edges where normals turn by more than this many degrees.
pub(super) const CREASE: f64 = 30.0;
/// Largest width and height of a page, in texels.
pub const LARGEST: usize = 16_384;
/// Default of the largest side of a page in texels, for [`Layout::Texel`].
pub const PAGE: usize = 4096;
/// The file's coordinates suit a lightmap if at least this share of the texels holds surface.
const USED: f64 = 0.5;
/// Charts should be at least this many texels wide.
const THIN: f64 = 2.0;

/// How large a map is.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Layout {
    /// One square page. The value is its side in texels.
    Resolution(usize),
    /// Texels of a given length in scene units, on as many pages as needed. The second value is the largest side of a
    /// page in texels.
    Texel(f64, usize),
}

/// Whose texture coordinates to use.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum Coordinates {
    /// The file's coordinates if they suit a lightmap, otherwise new ones.
    #[default]
    Auto,
    /// The file's coordinates. It is an error if they do not suit a lightmap.
    File,
    /// New coordinates.
    New,
}

/// Options of [`Atlas::with`].
#[derive(Debug, Clone, PartialEq)]
#[non_exhaustive]
pub struct AtlasOptions {
    /// The size of the map.
    pub layout: Layout,
    /// Whether the map uses the file's texture coordinates or new ones.
    pub coordinates: Coordinates,
    /// Pairs of a material index and the factor by which that material's texels are shorter than the others.
    pub density: Vec<(u32, f64)>,
    /// For each triangle, whether both of its sides get texels. Empty if no triangle is two-sided.
    pub two_sided: Vec<bool>,
}

setters!(AtlasOptions {
    with_density(density: Vec<(u32, f64)>),
    with_two_sided(two_sided: Vec<bool>),
});

impl AtlasOptions {
    /// Options with the same texel density for all materials, for one side of each triangle.
    pub fn new(layout: Layout, coordinates: Coordinates) -> AtlasOptions {
        AtlasOptions { layout, coordinates, density: Vec::new(), two_sided: Vec::new() }
    }

    /// The factor by which the texels of a material are shorter.
    pub(super) fn factor(&self, material: u32) -> f64 {
        self.density.iter().rev().find(|(m, _)| *m == material).map_or(1.0, |(_, factor)| *factor)
    }

    /// The reason why these options rule out the file's coordinates; `None` if they do not.
    fn wants_new(&self) -> Option<&'static str> {
        match self {
            AtlasOptions { density, .. } if !density.is_empty() => Some("they have a density of their own"),
            AtlasOptions { two_sided, .. } if two_sided.contains(&true) => {
                Some("they have one place for both sides of a face")
            }
            _ => None,
        }
    }
}

/// Texture coordinates that address a lightmap.
///
/// They belong to *facets*. A facet is a triangle of the scene, a part of a triangle that was cut because its chart
/// would be too large, or the second copy of a triangle whose two sides both have texels.
#[derive(Debug, Clone)]
pub struct Atlas {
    /// Texels in a row.
    pub width: usize,
    /// Rows of a page.
    pub height: usize,
    /// Number of pages. All have the same size.
    pub pages: usize,
    /// Texture coordinates in \[0, 1\], v upwards.
    pub coordinates: Vec<DVec2>,
    /// Indices into `coordinates` of each facet's corners.
    pub corners: Vec<[u32; 3]>,
    /// Chart of each facet; [`NONE`] for facets without a place in the map.
    pub chart: Vec<u32>,
    /// Page of each facet.
    pub page: Vec<u32>,
    /// Number of charts.
    pub charts: usize,
    /// The reason why the file's coordinates were not used; `None` if they were used.
    pub refused: Option<String>,
    /// The facets; `None` if they are the triangles of the scene.
    pub(super) cut: Option<Cut>,
}

impl Atlas {
    /// Lays a scene out with the same texel density everywhere, for one side of each triangle.
    ///
    /// # Errors
    /// See [`Atlas::with`].
    pub fn new(scene: &Scene, tracer: &Tracer, layout: Layout, coordinates: Coordinates) -> Result<Atlas> {
        Atlas::with(scene, tracer, &AtlasOptions::new(layout, coordinates))
    }

    /// Lays a scene out.
    ///
    /// # Errors
    /// [`Error::Setting`] when the map would be too small for the charts or too large altogether, or when the options
    /// demand the file's coordinates and these do not suit a lightmap.
    pub fn with(scene: &Scene, tracer: &Tracer, options: &AtlasOptions) -> Result<Atlas> {
        let &AtlasOptions { layout, coordinates, .. } = options;
        let suitable = || match options.wants_new() {
            Some(why) => Err(why.to_owned()),
            None => own(scene, layout, coordinates == Coordinates::File),
        };
        let mut sparse = None;
        let refused = match coordinates {
            Coordinates::New => "new ones were demanded".to_owned(),
            Coordinates::Auto | Coordinates::File => match suitable() {
                Ok(atlas) => {
                    let [covered, shared] = atlas.covered_and_shared_texels();
                    let used = covered as f64 / atlas.texels() as f64;
                    if shared == 0 && used >= USED || coordinates == Coordinates::File {
                        return Ok(atlas);
                    }
                    if shared > 0 {
                        format!("{shared} texels of this size would belong to two charts")
                    } else {
                        sparse = Some((covered, atlas));
                        format!("they would use only {:.1} % of the texels", 100.0 * used)
                    }
                }
                Err(why) if coordinates == Coordinates::File => {
                    return Err(Error::setting(
                        &[Setting::Coordinates],
                        format!("the file's texture coordinates do not suit a lightmap: {why}"),
                        "let new ones be made",
                    ));
                }
                Err(why) => why,
            },
        };
        let made = unwrap(scene, tracer, options);
        match (sparse, made) {
            // New coordinates are no reason to refuse what the file's can do, and not always better.
            (Some((_, own)), Err(_)) => Ok(own),
            (Some((covered, own)), Ok(made))
                if covered * made.texels() >= made.covered_and_shared_texels()[0] * own.texels() =>
            {
                Ok(own)
            }
            (_, made) => made.map(|made| Atlas { refused: Some(refused), ..made }),
        }
    }

    /// The facets as triangles of a scene; the given scene if none is cut.
    pub fn scene<'a>(&'a self, scene: &'a Scene) -> &'a Scene {
        self.cut.as_ref().map_or(scene, |cut| &cut.scene)
    }

    /// Number of triangles of the scene.
    pub fn triangles(&self) -> usize {
        self.cut.as_ref().map_or(self.corners.len(), Cut::triangles)
    }

    /// The triangle of the scene that a facet belongs to.
    pub fn triangle(&self, facet: usize) -> usize {
        self.cut.as_ref().map_or(facet, |cut| cut.facets[facet].triangle as usize)
    }

    /// The facets of a triangle's first copy.
    pub(super) fn facets_of(&self, t: usize) -> std::ops::Range<usize> {
        self.cut.as_ref().map_or(t..t + 1, |cut| cut.facets_of(t, false))
    }

    /// Whether any facet of a triangle has a place in the map.
    pub(super) fn is_mapped(&self, t: usize) -> bool {
        self.facets_of(t).any(|facet| self.chart[facet] != NONE)
    }

    /// Whether a facet is the second copy of a triangle, for its back.
    pub fn is_second(&self, facet: usize) -> bool {
        self.cut.as_ref().is_some_and(|cut| cut.facets[facet].turned)
    }

    /// Barycentric coordinates in the triangle of a point given by its barycentric coordinates in a facet.
    pub fn in_triangle(&self, facet: usize, barycentric: [f64; 3]) -> [f64; 3] {
        match &self.cut {
            None => barycentric,
            Some(cut) => in_triangle(barycentric, &cut.facets[facet].corners),
        }
    }

    /// The facet of a triangle that holds a point, and the barycentric coordinates of the point in that facet. `second`
    /// asks for the second copy of the triangle, which shows its back.
    pub(super) fn facet_at(
        &self,
        t: usize,
        barycentric: [f64; 3],
        second: bool,
    ) -> Option<(usize, [f64; 3])> {
        let Some(cut) = &self.cut else { return (!second).then_some((t, barycentric)) };
        let places = cut.facets_of(t, second).map(|f| (f, cut.facets[f].place(barycentric)));
        // A point on a border is in both facets, and rounding may put it in neither.
        let least = |place: &[f64; 3]| place.iter().copied().fold(f64::INFINITY, f64::min);
        places.max_by(|(_, a), (_, b)| least(a).total_cmp(&least(b)))
    }

    /// The corners of a facet in texels of its page; `None` if it has no place in the map.
    pub fn texel_corners(&self, t: usize) -> Option<[DVec2; 3]> {
        let size = DVec2::new(self.width as f64, self.height as f64);
        (self.chart[t] != NONE).then(|| self.corners[t].map(|i| self.coordinates[i as usize] * size))
    }

    /// Number of texels on all pages.
    pub fn texels(&self) -> usize {
        self.pages * self.width * self.height
    }

    /// Number of texels that hold parts of a chart, and of texels that hold parts of more than one.
    pub(super) fn covered_and_shared_texels(&self) -> [usize; 2] {
        let mut owner = vec![NONE; self.texels()];
        let mut shared = vec![false; self.texels()];
        for t in 0..self.corners.len() {
            let Some(corners) = self.texel_corners(t) else { continue };
            let page = self.page[t] as usize * self.width * self.height;
            raster::for_each_texel(corners, |x, y, part| {
                let at = page + y.min(self.height - 1) * self.width + x.min(self.width - 1);
                // Coordinates are rounded to single precision, so a chart may touch a texel by rounding alone.
                if part.area() > 1e-9 {
                    shared[at] |= owner[at] != NONE && owner[at] != self.chart[t];
                    owner[at] = self.chart[t];
                }
            });
        }
        [owner.iter().filter(|&&chart| chart != NONE).count(), shared.iter().filter(|&&s| s).count()]
    }

    /// Width of each chart in texels: the least distance between two parallel lines that enclose the chart.
    pub fn chart_widths(&self) -> Vec<f64> {
        let mut points = vec![Vec::new(); self.charts];
        for t in 0..self.corners.len() {
            if let Some(corners) = self.texel_corners(t) {
                points[self.chart[t] as usize].extend(corners);
            }
        }
        points.into_iter().map(width).collect()
    }

    /// The longest side of any chart's bounding box, in texels.
    pub(super) fn longest_chart(&self) -> f64 {
        let mut boxes = vec![[DVec2::INFINITY, DVec2::NEG_INFINITY]; self.charts];
        for f in 0..self.corners.len() {
            for corner in self.texel_corners(f).into_iter().flatten() {
                let [low, high] = &mut boxes[self.chart[f] as usize];
                (*low, *high) = (low.min(corner), high.max(corner));
            }
        }
        boxes.into_iter().map(|[low, high]| (high - low).max_element()).fold(0.0, f64::max)
    }

    /// Number of charts thinner than two texels, and their share of the mapped surface.
    pub fn thin_charts(&self, scene: &Scene) -> (usize, f64) {
        let scene = self.scene(scene);
        let thin: Vec<bool> = self.chart_widths().into_iter().map(|w| w < THIN).collect();
        let (mut area, mut total) = (0.0, 0.0);
        for t in (0..self.chart.len()).filter(|&t| self.chart[t] != NONE) {
            total += scene.area(t);
            area += if thin[self.chart[t] as usize] { scene.area(t) } else { 0.0 };
        }
        let mut is_there = vec![false; self.charts];
        self.chart.iter().filter(|&&chart| chart != NONE).for_each(|&chart| is_there[chart as usize] = true);
        let count = thin.iter().zip(is_there).filter(|&(&thin, there)| thin && there).count();
        (count, if total > 0.0 { area / total } else { 0.0 })
    }

    /// Square root of the mean surface area per texel, in scene units.
    pub fn texel_length(&self, scene: &Scene) -> f64 {
        let scene = self.scene(scene);
        let (mut surface, mut texels) = (0.0, 0.0);
        for t in 0..self.corners.len() {
            if let Some([a, b, c]) = self.texel_corners(t) {
                surface += scene.area(t);
                texels += 0.5 * (b - a).perp_dot(c - a).abs();
            }
        }
        if texels > 0.0 { (surface / texels).sqrt() } else { 0.0 }
    }

    /// Root mean square over the surface of ln(density / mean density), where density is texels per surface area. It is
    /// 0 if texels are equally dense everywhere, and 0.1 if their density varies by 10 %.
    pub fn density_spread(&self, scene: &Scene) -> f64 {
        let scene = self.scene(scene);
        let mean = self.texel_length(scene).powi(2);
        let (mut squares, mut total) = (0.0, 0.0);
        for t in 0..self.corners.len() {
            if let Some([a, b, c]) = self.texel_corners(t) {
                let (area, texels) = (scene.area(t), 0.5 * (b - a).perp_dot(c - a).abs());
                if texels > 0.0 {
                    squares += area * (texels * mean / area).ln().powi(2);
                    total += area;
                }
            }
        }
        if total > 0.0 { (squares / total).sqrt() } else { 0.0 }
    }
}

/// Coordinates that lie outside 0 to 1 by less than this are clamped.
const OUTSIDE: f64 = 1e-5;
/// Largest share of the surface in triangles whose coordinates enclose no area, if the options do not demand the file's
/// coordinates.
const WITHOUT_AREA: f64 = 1e-3;

/// The layout by the file's own coordinates, or the reason why they do not suit. Triangles whose coordinates enclose no
/// area get no place in the map. If the coordinates are `demanded`, such triangles may hold half of the surface instead
/// of [`WITHOUT_AREA`].
fn own(scene: &Scene, layout: Layout, demanded: bool) -> std::result::Result<Atlas, String> {
    if scene.texcoords.is_empty() {
        return Err("the file has none".into());
    }
    let triangle = |t: usize| format!("triangle {}", scene.triangles[t].source + 1);
    let is_outside = |uv: &DVec2| uv.min_element() < -OUTSIDE || uv.max_element() > 1.0 + OUTSIDE;
    if let Some(t) = (0..scene.texcoords.len()).find(|&t| scene.texcoords[t].iter().any(is_outside)) {
        return Err(format!("the coordinates of {} lie outside 0..1", triangle(t)));
    }
    let texcoords: Vec<[DVec2; 3]> =
        scene.texcoords.iter().map(|uv| uv.map(|uv| uv.clamp(DVec2::ZERO, DVec2::ONE) + 0.0)).collect();
    let doubled = |[a, b, c]: [DVec2; 3]| (b - a).perp_dot(c - a).abs();
    let flat: Vec<bool> = texcoords.iter().map(|&uv| doubled(uv) == 0.0).collect();
    if let Some(t) = flat.iter().position(|&flat| flat) {
        let area = |keep: &dyn Fn(usize) -> bool| -> f64 {
            (0..flat.len()).filter(|&t| keep(t)).map(|t| scene.area(t)).sum()
        };
        let (without, whole) = (area(&|t| flat[t]), area(&|_| true));
        if without > if demanded { 0.5 * whole } else { WITHOUT_AREA * whole } {
            return Err(format!("the coordinates of {} enclose no area", triangle(t)));
        }
    }
    let pairs = overlap::find(&texcoords, 3);
    if !pairs.is_empty() {
        let named: Vec<_> =
            pairs.iter().map(|&[t, u]| format!("{} and {}", triangle(t), triangle(u))).collect();
        return Err(format!("the coordinates of {} overlap", named.join(", of ")));
    }
    let area: f64 = texcoords.iter().map(|&uv| 0.5 * doubled(uv)).sum();
    let side = match layout {
        Layout::Resolution(side) => side,
        Layout::Texel(length, _) => {
            let surface: f64 = (0..flat.len()).filter(|&t| !flat[t]).map(|t| scene.area(t)).sum();
            ((surface / area).sqrt() / length).ceil().max(1.0) as usize
        }
    };
    if side > LARGEST {
        return Err(format!("with texels of this length a page would have {side} of them a side"));
    }
    let (coordinates, corners) = share(scene, &texcoords);
    let (mut chart, charts) = components(&corners);
    chart.iter_mut().zip(&flat).filter(|(_, flat)| **flat).for_each(|(chart, _)| *chart = NONE);
    let page = vec![0; corners.len()];
    Ok(Atlas {
        width: side,
        height: side,
        pages: 1,
        coordinates,
        corners,
        chart,
        page,
        charts,
        refused: None,
        cut: None,
    })
}

/// Removes duplicates: corners at the same vertex with the same coordinates share one entry.
fn share(scene: &Scene, texcoords: &[[DVec2; 3]]) -> (Vec<DVec2>, Vec<[u32; 3]>) {
    let (mut known, mut coordinates) = (HashMap::new(), Vec::new());
    let corners = (0..scene.triangles.len())
        .map(|t| {
            std::array::from_fn(|k| {
                let uv = texcoords[t][k];
                let key = (scene.triangles[t].vertices[k], uv.to_array().map(f64::to_bits));
                *known.entry(key).or_insert_with(|| {
                    coordinates.push(uv);
                    coordinates.len() as u32 - 1
                })
            })
        })
        .collect();
    (coordinates, corners)
}

/// Numbers the charts. Triangles that share an edge in the map belong to the same chart.
fn components(corners: &[[u32; 3]]) -> (Vec<u32>, usize) {
    let mut sets = DisjointSets::new(corners.len());
    let mut edges: HashMap<(u32, u32), usize> = HashMap::new();
    for (t, c) in corners.iter().enumerate() {
        for k in 0..3 {
            let (a, b) = (c[k], c[(k + 1) % 3]);
            match edges.entry((a.min(b), a.max(b))) {
                std::collections::hash_map::Entry::Occupied(other) => sets.unite(t, *other.get()),
                std::collections::hash_map::Entry::Vacant(place) => drop(place.insert(t)),
            }
        }
    }
    sets.numbers()
}

/// Least width of the convex hull of points. The least width is attained perpendicular to one of the hull's edges.
fn width(mut points: Vec<DVec2>) -> f64 {
    points.sort_unstable_by(|a, b| a.x.total_cmp(&b.x).then(a.y.total_cmp(&b.y)));
    points.dedup();
    // Andrew's monotone chain.
    let mut hull: Vec<DVec2> = Vec::new();
    for pass in 0..2 {
        let start = hull.len();
        let mut add = |p: DVec2| {
            while hull.len() >= start + 2
                && (hull[hull.len() - 1] - hull[hull.len() - 2]).perp_dot(p - hull[hull.len() - 1]) <= 0.0
            {
                hull.pop();
            }
            hull.push(p);
        };
        if pass == 0 {
            points.iter().copied().for_each(&mut add)
        } else {
            points.iter().rev().copied().for_each(&mut add)
        }
        hull.pop();
    }
    if hull.len() < 3 {
        return 0.0;
    }
    let across = |k: usize| {
        let (a, b) = (hull[k], hull[(k + 1) % hull.len()]);
        let edge = (b - a).normalize();
        hull.iter().map(|&p| edge.perp_dot(p - a).abs()).fold(0.0, f64::max)
    };
    (0..hull.len()).map(across).fold(f64::INFINITY, f64::min)
}
