//! The triangles of a mesh with texture coordinates and colours, posed by skins and morph targets.

use glam::{DMat4, DVec2, DVec3};

use super::container::Document;
use super::document::{Mesh, Node, Primitive};
use super::nodes::Nodes;
use crate::Result;

/// The vertices of a primitive in the space of its mesh, and its triangles.
pub struct Geometry {
    pub positions: Vec<DVec3>,
    /// Corners, counter-clockwise seen from the front.
    pub triangles: Vec<[u32; 3]>,
    /// Linear R G B and alpha.
    pub colours: Option<Vec<[f64; 4]>>,
    /// Whether the positions are already in the space of the scene.
    pub posed: bool,
}

impl Document {
    /// Reads a primitive. `None` for points and lines, and if there are no positions.
    ///
    /// # Errors
    /// [`Error::Input`](crate::Error::Input) when an accessor cannot be read or an index has no vertex.
    pub fn geometry(
        &self,
        nodes: &Nodes,
        node: usize,
        mesh: usize,
        primitive: usize,
    ) -> Result<Option<Geometry>> {
        let place = format!("meshes[{mesh}].primitives[{primitive}]");
        let (mesh, node) = (&self.root.meshes[mesh], &self.root.nodes[node]);
        let primitive = &mesh.primitives[primitive];
        let mode = primitive.mode.unwrap_or(4);
        if mode > 6 {
            return Err(self.error(format!("{place}: mode {mode} is unknown")));
        }
        let Some(&position) = primitive.attributes.get("POSITION").filter(|_| mode >= 4) else {
            return Ok(None);
        };
        let is_there =
            |accessor: usize| self.root.accessors.get(accessor).is_some_and(|a| a.buffer_view.is_some());
        if primitive.extensions.draco.is_some() && !is_there(position) {
            return Err(self
                .error(format!("{place}: it is compressed (KHR_draco_mesh_compression), which is not read"))
                .with_hint("unpack the file: npx @gltf-transform/cli dedup IN.glb OUT.glb"));
        }
        let mut positions: Vec<DVec3> =
            self.numbers::<3>(position, "VEC3")?.into_iter().map(DVec3::from).collect();
        self.morph(primitive, mesh, node, &mut positions)?;
        let posed = self.skin(nodes, node, primitive, &mut positions)?;
        if let Some(bad) = positions.iter().position(|p| !p.is_finite()) {
            return Err(self.error(format!("{place}: the position of vertex {bad} is not finite")));
        }
        let order = match primitive.indices {
            Some(indices) => self.indices(indices)?,
            None => (0..positions.len() as u32).collect(),
        };
        if let Some(bad) = order.iter().find(|&&i| i as usize >= positions.len()) {
            let vertices = positions.len();
            return Err(self.error(format!("{place}: index {bad} of {vertices} vertices")));
        }
        let colours = match primitive.attributes.get("COLOR_0") {
            None => None,
            Some(&accessor) => Some(self.colours(accessor, positions.len(), &place)?),
        };
        Ok(Some(Geometry { positions, triangles: triangles(mode, &order), colours, posed }))
    }

    /// Reads a set of texture coordinates as it is in the file, with v downwards.
    ///
    /// # Errors
    /// Those of [`Document::geometry`].
    pub fn texture_coordinates(
        &self,
        primitive: &Primitive,
        set: u32,
        vertices: usize,
    ) -> Result<Option<Vec<DVec2>>> {
        let Some(&accessor) = primitive.attributes.get(&format!("TEXCOORD_{set}")) else { return Ok(None) };
        let uv = self.numbers::<2>(accessor, "VEC2")?;
        if uv.len() < vertices {
            return Err(self.error(format!(
                "accessors[{accessor}]: {} texture coordinates for {vertices} vertices",
                uv.len()
            )));
        }
        // Coordinates that are not finite become 0, as in OBJ files.
        let finite = |uv: [f64; 2]| if uv.iter().all(|x| x.is_finite()) { uv.into() } else { DVec2::ZERO };
        Ok(Some(uv.into_iter().map(finite).collect()))
    }

    /// Reads linear colours and clamps them to \[0, 1\] (section 3.7.2.1 of the specification).
    fn colours(&self, accessor: usize, vertices: usize, place: &str) -> Result<Vec<[f64; 4]>> {
        let colours: Vec<[f64; 4]> = match self.kind(accessor)? {
            "VEC3" => {
                self.numbers::<3>(accessor, "VEC3")?.into_iter().map(|[r, g, b]| [r, g, b, 1.0]).collect()
            }
            _ => self.numbers::<4>(accessor, "VEC4")?,
        };
        if colours.len() < vertices {
            return Err(self.error(format!("{place}: {} colours for {vertices} vertices", colours.len())));
        }
        let share = |x: f64| if x.is_nan() { 0.0 } else { x.clamp(0.0, 1.0) };
        Ok(colours.into_iter().map(|c| c.map(share)).collect())
    }

    /// Moves vertices by the morph targets with their weights at rest.
    fn morph(&self, primitive: &Primitive, mesh: &Mesh, node: &Node, positions: &mut [DVec3]) -> Result<()> {
        let Some(weights) = node.weights.as_ref().or(mesh.weights.as_ref()) else { return Ok(()) };
        for (target, &weight) in primitive.targets.iter().zip(weights).filter(|(_, weight)| **weight != 0.0) {
            let Some(&accessor) = target.get("POSITION") else { continue };
            for (position, moved) in positions.iter_mut().zip(self.numbers::<3>(accessor, "VEC3")?) {
                *position += weight * DVec3::from(moved);
            }
        }
        Ok(())
    }

    /// Poses vertices by the joints of the node's skin at rest. Returns whether there is a skin. If so, the transform
    /// of the node itself must be ignored (section 3.7.3.3 of the specification).
    fn skin(
        &self,
        nodes: &Nodes,
        node: &Node,
        primitive: &Primitive,
        positions: &mut [DVec3],
    ) -> Result<bool> {
        let sets = (0..).map_while(|set| {
            let of = |name: &str| primitive.attributes.get(&format!("{name}_{set}")).copied();
            Some((of("JOINTS")?, of("WEIGHTS")?))
        });
        let sets: Vec<(usize, usize)> = sets.collect();
        let Some(i) = node.skin.filter(|_| !sets.is_empty()) else { return Ok(false) };
        let failed = |what: &str| self.error(format!("skins[{i}]: {what}"));
        let skin = self.root.skins.get(i).ok_or_else(|| failed("it does not exist"))?;
        let inverse = match skin.inverse_bind_matrices {
            Some(accessor) => self.numbers::<16>(accessor, "MAT4")?,
            None => Vec::new(),
        };
        let joints: Vec<DMat4> = skin
            .joints
            .iter()
            .enumerate()
            .map(|(k, &joint)| {
                let place = nodes.matrices.get(joint).copied().flatten();
                let place = place.ok_or_else(|| failed("a joint is not a node of the scene"))?;
                Ok(place * inverse.get(k).map_or(DMat4::IDENTITY, DMat4::from_cols_array))
            })
            .collect::<Result<_>>()?;
        let mut sums = vec![(DVec3::ZERO, 0.0); positions.len()];
        for (joint, weight) in sets {
            let (joint, weight) = (self.numbers::<4>(joint, "VEC4")?, self.numbers::<4>(weight, "VEC4")?);
            for ((sum, &position), (joint, weight)) in
                sums.iter_mut().zip(&*positions).zip(joint.iter().zip(weight))
            {
                for k in (0..4).filter(|&k| weight[k] > 0.0) {
                    let matrix = joints
                        .get(joint[k] as usize)
                        .ok_or_else(|| failed("a vertex names a joint that does not exist"))?;
                    sum.0 += weight[k] * matrix.transform_point3(position);
                    sum.1 += weight[k];
                }
            }
        }
        for (position, (sum, weight)) in
            positions.iter_mut().zip(sums).filter(|(_, (_, weight))| *weight > 0.0)
        {
            *position = sum / weight;
        }
        Ok(true)
    }
}

/// The triangles of a list, a strip or a fan (section 3.7.2.1 of the specification).
pub fn triangles(mode: u64, order: &[u32]) -> Vec<[u32; 3]> {
    match mode {
        4 => order.as_chunks::<3>().0.to_vec(),
        5 => order
            .windows(3)
            .enumerate()
            .map(|(k, w)| if k % 2 == 0 { [w[0], w[1], w[2]] } else { [w[0], w[2], w[1]] })
            .collect(),
        _ => {
            let Some((&hub, rim)) = order.split_first() else { return Vec::new() };
            rim.windows(2).map(|w| [w[0], w[1], hub]).collect()
        }
    }
}
