//! The nodes of a scene and the places of its meshes, without recursion.

use glam::{DMat4, DQuat, DVec3, DVec4};

use super::container::Document;
use super::document::Node;
use crate::Result;

/// A mesh in the scene.
pub struct Instance {
    /// The node that places it.
    pub node: usize,
    /// The number of the copy that EXT_mesh_gpu_instancing makes of the node's mesh; `None` without the extension.
    pub copy: Option<usize>,
    /// The mesh.
    pub mesh: usize,
    /// The matrix from the space of the mesh to the space of the scene.
    pub matrix: DMat4,
}

/// The meshes of a scene, and the places of its nodes.
pub struct Nodes {
    /// The meshes in the order of the walk, parents first.
    pub instances: Vec<Instance>,
    /// The matrix of each node that belongs to the scene.
    pub matrices: Vec<Option<DMat4>>,
}

impl Document {
    /// Walks the default scene. If there is none, walks all nodes that are not children.
    ///
    /// # Errors
    /// [`Error::Input`](crate::Error::Input) when a node is missing, is visited twice, or has an unusable matrix.
    pub fn nodes(&self) -> Result<Nodes> {
        let root = &self.root;
        let roots = match root.scene {
            Some(scene) => match root.scenes.get(scene) {
                Some(scene) => scene.nodes.clone(),
                None => return Err(self.error(format!("the default scene scenes[{scene}] does not exist"))),
            },
            None => self.roots(),
        };
        let mut nodes = Nodes { instances: Vec::new(), matrices: vec![None; root.nodes.len()] };
        let mut waiting: Vec<(usize, DMat4)> = roots.iter().rev().map(|&r| (r, DMat4::IDENTITY)).collect();
        while let Some((i, parent)) = waiting.pop() {
            let failed = |what: &str| self.error(format!("nodes[{i}]: {what}"));
            let Some(node) = root.nodes.get(i) else { return Err(failed("it does not exist")) };
            if nodes.matrices[i].is_some() {
                return Err(failed(
                    "it is met twice: a node must have one parent, and must not be its own descendant",
                ));
            }
            let matrix = parent * local(node).map_err(failed)?;
            if !matrix.is_finite() {
                return Err(failed("its place is not finite"));
            }
            nodes.matrices[i] = Some(matrix);
            if let Some(mesh) = node.mesh {
                if mesh >= root.meshes.len() {
                    return Err(failed(&format!("meshes[{mesh}] does not exist")));
                }
                match &node.extensions.instancing {
                    None => nodes.instances.push(Instance { node: i, copy: None, mesh, matrix }),
                    Some(_) => {
                        let copies = self.copies(i)?;
                        nodes.instances.extend(copies.into_iter().enumerate().map(|(copy, place)| {
                            Instance { node: i, copy: Some(copy), mesh, matrix: matrix * place }
                        }));
                    }
                }
            }
            waiting.extend(node.children.iter().rev().map(|&child| (child, matrix)));
        }
        Ok(nodes)
    }

    fn roots(&self) -> Vec<usize> {
        let mut has_parent = vec![false; self.root.nodes.len()];
        for &child in self.root.nodes.iter().flat_map(|node| &node.children) {
            if let Some(child) = has_parent.get_mut(child) {
                *child = true;
            }
        }
        (0..has_parent.len()).filter(|&i| !has_parent[i]).collect()
    }

    /// The places of the copies by EXT_mesh_gpu_instancing, relative to node `i`.
    ///
    /// # Errors
    /// [`Error::Input`](crate::Error::Input) when its accessors cannot be read or differ in length.
    pub fn copies(&self, i: usize) -> Result<Vec<DMat4>> {
        let Some(instancing) = &self.root.nodes[i].extensions.instancing else { return Ok(Vec::new()) };
        let attributes = &instancing.attributes;
        let read3 = |accessor: Option<usize>| accessor.map(|a| self.numbers::<3>(a, "VEC3")).transpose();
        let (translation, scale) = (read3(attributes.translation)?, read3(attributes.scale)?);
        let rotation = attributes.rotation.map(|a| self.numbers::<4>(a, "VEC4")).transpose()?;
        let lengths = [
            translation.as_ref().map(Vec::len),
            rotation.as_ref().map(Vec::len),
            scale.as_ref().map(Vec::len),
        ];
        let count = lengths.iter().flatten().max().copied().unwrap_or(0);
        if lengths.iter().flatten().any(|&n| n != count) {
            return Err(self.error(format!("nodes[{i}]: the attributes of its instances differ in length")));
        }
        (0..count)
            .map(|k| {
                let translation = translation.as_ref().map_or([0.0; 3], |t| t[k]);
                let rotation = rotation.as_ref().map_or([0.0, 0.0, 0.0, 1.0], |r| r[k]);
                let scale = scale.as_ref().map_or([1.0; 3], |s| s[k]);
                placed(translation, rotation, scale)
                    .map_err(|what| self.error(format!("nodes[{i}], instance {k}: {what}")))
            })
            .collect()
    }
}

/// The matrix of a node relative to its parent.
fn local(node: &Node) -> std::result::Result<DMat4, &'static str> {
    let parts = (node.translation, node.rotation, node.scale);
    match (node.matrix, parts) {
        (Some(_), (Some(_), ..) | (_, Some(_), _) | (.., Some(_))) => {
            Err("it has both a matrix and a translation, rotation or scale")
        }
        (Some(matrix), _) => {
            let matrix = DMat4::from_cols_array(&matrix);
            // Section 5.25: the matrix must be a product of translation, rotation and scale, so it has no perspective.
            if matrix.row(3) == DVec4::W {
                Ok(matrix)
            } else {
                Err("its matrix is not affine: the last row is not 0 0 0 1")
            }
        }
        (None, (translation, rotation, scale)) => placed(
            translation.unwrap_or([0.0; 3]),
            rotation.unwrap_or([0.0, 0.0, 0.0, 1.0]),
            scale.unwrap_or([1.0; 3]),
        ),
    }
}

fn placed(
    translation: [f64; 3],
    rotation: [f64; 4],
    scale: [f64; 3],
) -> std::result::Result<DMat4, &'static str> {
    let rotation = DQuat::from_array(rotation);
    let length = rotation.length();
    if !(length > 0.0 && length.is_finite()) {
        return Err("its rotation is not a quaternion");
    }
    Ok(DMat4::from_scale_rotation_translation(scale.into(), rotation / length, DVec3::from(translation)))
}
