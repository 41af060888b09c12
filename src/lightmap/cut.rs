//! A copy of the scene for the map's layout: long triangles are cut, and some triangles get a second copy for their
//! back.
//!
//! A chart that is longer than a page does not fit on it. A chart that is almost as long leaves the rest of the page
//! empty. So the edges of long surfaces are halved until all are short enough. An edge is halved on both of its sides,
//! so the pieces still share their vertices. The light is computed on the uncut scene. Each piece records which part of
//! which triangle it is.

use std::collections::{HashMap, HashSet};

use glam::DVec2;

use crate::scene::{NEW_CORNER, Scene, Triangle};

/// A triangle of the cut scene.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Facet {
    /// The triangle of the uncut scene that it belongs to.
    pub triangle: u32,
    /// Barycentric coordinates of its corners in that triangle.
    pub corners: [[f64; 3]; 3],
    /// Whether it is a second copy, with opposite winding, for the back.
    pub turned: bool,
}

impl Facet {
    /// Converts barycentric coordinates in the triangle to barycentric coordinates in the facet.
    pub(super) fn place(&self, barycentric: [f64; 3]) -> [f64; 3] {
        let point = |b: [f64; 3]| DVec2::new(b[0], b[1]);
        let ([a, b, c], p) = (self.corners.map(point), point(barycentric));
        let whole = (b - a).perp_dot(c - a);
        [(b - p).perp_dot(c - p), (c - p).perp_dot(a - p), (a - p).perp_dot(b - p)].map(|x| x / whole)
    }
}

/// The cut scene and the origin of its triangles.
#[derive(Debug, Clone)]
pub(super) struct Cut {
    /// The scene whose triangles are the facets. Second copies come after the faces of the file, and the backs of lamps
    /// last.
    pub scene: Scene,
    pub facets: Vec<Facet>,
    /// For each triangle of the uncut scene, the range of its facets and the range of its second copy's facets.
    ranges: Vec<[(u32, u32); 2]>,
}

impl Cut {
    /// Halves all edges longer than `longest` of the triangles marked in `long`, and adds a second copy of the
    /// triangles marked in `turned`. Both may be empty.
    pub(super) fn new(scene: &Scene, longest: f64, long: &[bool], turned: &[bool]) -> Cut {
        let of = |t: usize| scene.triangles[t].vertices;
        let edges = |t: usize| [0, 1, 2].map(|k| ends(of(t)[k], of(t)[(k + 1) % 3]));
        let shared = (0..long.len()).filter(|&t| long[t]).flat_map(edges).collect();
        let mut cutter =
            Cutter { scene, longest, long, shared, middles: HashMap::new(), cut: Cut::empty(scene) };
        // The backs of lamps are not faces of the file. They stay at the end.
        let faces = scene.triangles.len() - scene.backs_of_lamps;
        (0..faces).for_each(|t| cutter.facets_of(t));
        let mut copies: HashMap<u32, u32> = HashMap::new();
        for t in (0..faces).filter(|&t| turned.get(t) == Some(&true)) {
            let cut = &mut cutter.cut;
            let start = cut.facets.len() as u32;
            cut.facets_of(t, false).for_each(|f| cut.turn(f, &mut copies));
            cut.ranges[t][1] = (start, cut.facets.len() as u32);
        }
        let before = cutter.cut.facets.len();
        (faces..scene.triangles.len()).for_each(|t| cutter.facets_of(t));
        let mut cut = cutter.cut;
        cut.scene.backs_of_lamps = cut.facets.len() - before;
        cut
    }

    /// Number of triangles of the uncut scene.
    pub(super) fn triangles(&self) -> usize {
        self.ranges.len()
    }

    /// The facets of a triangle, or of its second copy.
    pub(super) fn facets_of(&self, t: usize, turned: bool) -> std::ops::Range<usize> {
        let (start, end) = self.ranges[t][usize::from(turned)];
        start as usize..end as usize
    }

    fn empty(scene: &Scene) -> Cut {
        let bare = Scene {
            triangles: Vec::new(),
            texcoords: Vec::new(),
            normals: Vec::new(),
            face_corners: Vec::new(),
            ..scene.clone()
        };
        Cut { scene: bare, facets: Vec::new(), ranges: Vec::new() }
    }

    fn push(&mut self, piece: &Piece, turned: bool, vertices: [u32; 3]) {
        self.scene.triangles.push(Triangle { vertices, ..piece.triangle });
        if let Some(texcoords) = piece.texcoords {
            self.scene.texcoords.push(texcoords);
        }
        self.scene.face_corners.push(piece.names);
        self.facets.push(Facet { triangle: piece.origin, corners: piece.corners, turned });
    }

    /// Adds a copy of a facet for its back. The copy has vertices of its own, because the two sides share no light.
    fn turn(&mut self, f: usize, copies: &mut HashMap<u32, u32>) {
        let swap = |[a, b, c]: [u32; 3]| [a, c, b];
        let triangle = self.scene.triangles[f];
        let vertices = swap(triangle.vertices).map(|v| {
            *copies.entry(v).or_insert_with(|| {
                self.scene.vertices.push(self.scene.vertices[v as usize]);
                self.scene.vertices.len() as u32 - 1
            })
        });
        let [a, b, c] = self.facets[f].corners;
        let piece = Piece {
            triangle,
            is_long: false,
            origin: self.facets[f].triangle,
            corners: [a, c, b],
            names: swap(self.scene.face_corners[f]),
            texcoords: self.scene.texcoords.get(f).map(|&[a, b, c]| [a, c, b]),
        };
        self.push(&piece, true, vertices);
    }
}

/// The key of an edge, independent of its direction.
fn ends(a: u32, b: u32) -> (u32, u32) {
    (a.min(b), a.max(b))
}

/// A triangle or a part of one that may still be cut.
#[derive(Clone, Copy)]
struct Piece {
    triangle: Triangle,
    /// Whether it belongs to a surface that is too long.
    is_long: bool,
    origin: u32,
    corners: [[f64; 3]; 3],
    /// For each of its corners, the index of the corner of the face, or a new corner; see [`NEW_CORNER`].
    names: [u32; 3],
    texcoords: Option<[DVec2; 3]>,
}

impl Piece {
    fn whole(scene: &Scene, t: usize) -> Piece {
        Piece {
            triangle: scene.triangles[t],
            is_long: false,
            origin: t as u32,
            corners: [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]],
            names: scene.face_corners.get(t).copied().unwrap_or([0, 1, 2]),
            texcoords: scene.texcoords.get(t).copied(),
        }
    }

    /// The same piece with its corners rotated so that corner `k` comes first.
    fn turned_to(&self, k: usize) -> Piece {
        let mut piece = *self;
        piece.triangle.vertices.rotate_left(k);
        piece.corners.rotate_left(k);
        piece.names.rotate_left(k);
        if let Some(texcoords) = &mut piece.texcoords {
            texcoords.rotate_left(k);
        }
        piece
    }
}

/// A corner of a piece: vertex, barycentric coordinates in the triangle, corner of the face, texture coordinate.
type Corner = (u32, [f64; 3], u32, Option<DVec2>);

struct Cutter<'a> {
    scene: &'a Scene,
    longest: f64,
    long: &'a [bool],
    /// Edges of surfaces that are too long. They are halved on both sides.
    shared: HashSet<(u32, u32)>,
    /// The vertex in the middle of each halved edge.
    middles: HashMap<(u32, u32), u32>,
    cut: Cut,
}

impl Cutter<'_> {
    /// Adds the facets of a triangle.
    fn facets_of(&mut self, t: usize) {
        let start = self.cut.facets.len() as u32;
        self.cut(&Piece { is_long: self.long.get(t) == Some(&true), ..Piece::whole(self.scene, t) });
        self.cut.ranges.push([(start, self.cut.facets.len() as u32), (0, 0)]);
    }

    /// Cuts a piece until all its edges are short enough, and adds the parts. Whether an edge is cut depends on the
    /// edge alone.
    fn cut(&mut self, piece: &Piece) {
        let is_long = [0, 1, 2].map(|k| self.is_long(piece, k));
        let long = is_long.iter().filter(|&&long| long).count();
        // Rotate the piece to the position that the patterns below assume: one long edge comes first, two follow the
        // short one.
        let first = match long {
            0 => return self.cut.push(piece, false, piece.triangle.vertices),
            1 => is_long.iter().position(|&long| long),
            2 => is_long.iter().position(|&long| !long).map(|k| (k + 1) % 3),
            _ => Some(0),
        };
        let piece = piece.turned_to(first.unwrap_or(0));
        let [a, b, c] = [0, 1, 2].map(|k| self.corner(&piece, k));
        let ab = self.middle(a, b);
        let parts: Vec<[Corner; 3]> = match long {
            1 => vec![[a, ab, c], [ab, b, c]],
            2 => {
                let bc = self.middle(b, c);
                vec![[ab, b, bc], [a, ab, bc], [a, bc, c]]
            }
            _ => {
                let (bc, ca) = (self.middle(b, c), self.middle(c, a));
                vec![[a, ab, ca], [ab, b, bc], [ca, bc, c], [ab, bc, ca]]
            }
        };
        for corners in parts {
            let part = Piece {
                triangle: Triangle { vertices: corners.map(|corner| corner.0), ..piece.triangle },
                corners: corners.map(|corner| corner.1),
                names: corners.map(|corner| corner.2),
                texcoords: piece.texcoords.map(|_| corners.map(|corner| corner.3.unwrap_or_default())),
                ..piece
            };
            self.cut(&part);
        }
    }

    fn is_long(&self, piece: &Piece, k: usize) -> bool {
        let [a, b] = [k, (k + 1) % 3].map(|k| piece.triangle.vertices[k]);
        let [from, to] = [a, b].map(|v| self.cut.scene.vertices[v as usize]);
        (piece.is_long || self.shared.contains(&ends(a, b))) && (to - from).length() > self.longest
    }

    fn corner(&self, piece: &Piece, k: usize) -> Corner {
        (piece.triangle.vertices[k], piece.corners[k], piece.names[k], piece.texcoords.map(|uv| uv[k]))
    }

    fn middle(&mut self, a: Corner, b: Corner) -> Corner {
        let ends = ends(a.0, b.0);
        let vertices = &mut self.cut.scene.vertices;
        let vertex = *self.middles.entry(ends).or_insert_with(|| {
            let middle = vertices[ends.0 as usize] * 0.5 + vertices[ends.1 as usize] * 0.5;
            vertices.push(middle);
            vertices.len() as u32 - 1
        });
        if self.shared.contains(&ends) {
            self.shared.extend([self::ends(a.0, vertex), self::ends(vertex, b.0)]);
        }
        let corner = std::array::from_fn(|k| 0.5 * (a.1[k] + b.1[k]));
        (vertex, corner, NEW_CORNER | vertex, a.3.zip(b.3).map(|(a, b)| 0.5 * (a + b)))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::scene::Material;
    use glam::DVec3;

    #[test]
    fn pieces_make_up_the_triangles_and_share_their_vertices() {
        let (x, y) = (DVec3::X, DVec3::Y);
        let triangles = [([DVec3::ZERO, 9.0 * x, 0.5 * y], 0), ([9.0 * x, 9.0 * x + 0.5 * y, 0.5 * y], 0)];
        let scene = Scene::new(&triangles, vec![Material::new("m", [0.5; 3], [0.0; 3])]);
        let cut = Cut::new(&scene, 1.0, &[true; 2], &[true, false]);
        let mut edges = HashMap::new();
        let mut areas = [0.0; 2];
        let turned = cut.facets.iter().filter(|facet| facet.turned).count();
        for (f, facet) in cut.facets.iter().enumerate() {
            let corners = cut.scene.corners(f);
            let whole = scene.corners(facet.triangle as usize);
            for k in 0..3 {
                assert!((corners[(k + 1) % 3] - corners[k]).length() <= 1.0);
                let there: DVec3 = (0..3).map(|c| whole[c] * facet.corners[k][c]).sum();
                assert!((there - corners[k]).length() < 1e-15);
                if !facet.turned {
                    let v = cut.scene.triangles[f].vertices;
                    *edges.entry((v[k], v[(k + 1) % 3])).or_insert(0) += 1;
                }
            }
            let sign = if facet.turned { -1.0 } else { 1.0 };
            assert!(sign * cut.scene.normal(f).z > 0.0);
            areas[usize::from(facet.turned)] += cut.scene.area(f);
        }
        assert!((areas[0] - 4.5).abs() < 1e-12 && (areas[1] - 2.25).abs() < 1e-12, "{areas:?}");
        assert!(turned > 9 && turned < cut.facets.len() / 2 + 1);
        // Every edge occurs once in each direction, unless it lies on the rim of the rectangle.
        let is_rim = |v: u32| {
            let p = cut.scene.vertices[v as usize];
            p.x == 0.0 || p.x == 9.0 || p.y == 0.0 || p.y == 0.5
        };
        assert!(
            edges
                .iter()
                .all(|(&(a, b), &n)| n == 1 && (edges.contains_key(&(b, a)) || is_rim(a) && is_rim(b)))
        );
    }
}
