//! Scenes from arrays: vertices, faces as indices, and a material for each face.

use glam::DVec3;

use super::{MOST_RADIANCE, Material, Part, Scene, SceneBuilder, is_radiance, triangulate};
use crate::{Error, MeshError, Result};

impl Scene {
    /// Makes a scene from indexed faces.
    ///
    /// A face is a triangle or a polygon, and lists its corners counter-clockwise as seen from its front.
    /// `material_of_face` has an index into `materials` for each face. Vertices at equal positions become one vertex.
    /// Triangles without area are left out and counted in [`Scene::degenerate`].
    ///
    /// ```
    /// use radiosity::{Scene, glam::dvec3, scene::Material};
    ///
    /// let vertices = [dvec3(0., 0., 0.), dvec3(1., 0., 0.), dvec3(1., 1., 0.), dvec3(0., 1., 0.)];
    /// let white = Material::new("white", [0.8; 3], [0.0; 3]);
    /// let scene = Scene::from_indexed(&vertices, [[0, 1, 2, 3]], &[0], vec![white])?;
    /// assert_eq!(scene.triangles.len(), 2);
    /// # Ok::<(), radiosity::Error>(())
    /// ```
    ///
    /// # Errors
    /// [`Error::Mesh`] when an array is wrong. It holds a [`MeshError`] with the first face, vertex or
    /// material that is wrong.
    pub fn from_indexed<F: AsRef<[u32]>>(
        vertices: &[DVec3],
        faces: impl IntoIterator<Item = F>,
        material_of_face: &[u32],
        materials: Vec<Material>,
    ) -> Result<Scene> {
        if let Some(vertex) = vertices.iter().position(|v| !v.is_finite()) {
            return Err(Error::Mesh(MeshError::NotFinite { vertex }));
        }
        materials.iter().try_for_each(check_material)?;

        let mut builder = SceneBuilder::default();
        let mut count = 0;
        let mut points = Vec::new();
        for (face, corners) in faces.into_iter().enumerate() {
            let corners = corners.as_ref();
            count = face + 1;
            let Some(&material) = material_of_face.get(face) else { continue };
            if material as usize >= materials.len() {
                return Err(Error::Mesh(MeshError::NoSuchMaterial {
                    face,
                    material,
                    materials: materials.len(),
                }));
            }
            if corners.len() < 3 {
                return Err(Error::Mesh(MeshError::FewCorners { face, corners: corners.len() }));
            }
            points.clear();
            for &vertex in corners {
                let Some(&point) = vertices.get(vertex as usize) else {
                    return Err(Error::Mesh(MeshError::NoSuchVertex {
                        face,
                        vertex,
                        vertices: vertices.len(),
                    }));
                };
                points.push(point);
            }
            let triangles = triangulate::polygon(&points)
                .ok_or(Error::Mesh(MeshError::ManyCorners { face, corners: corners.len() }))?;
            builder.face(None, 0);
            for triangle in triangles {
                builder.push(triangle.map(|k| points[k]), material, None);
            }
        }
        if count != material_of_face.len() {
            return Err(Error::Mesh(MeshError::MaterialOfFace {
                faces: count,
                given: material_of_face.len(),
            }));
        }
        Ok(Scene { materials, parts: vec![Part::default()], ..builder.finish() })
    }
}

fn check_material(material: &Material) -> Result<()> {
    check_values(material)?;
    let mapped = material.reflectance_map.is_some() || material.emission_map.is_some();
    let name = material.name.clone();
    if mapped { Err(Error::Mesh(MeshError::Texture { material: name })) } else { Ok(()) }
}

/// Whether the reflectance and the emission of a material are in range.
pub(super) fn check_values(material: &Material) -> Result<()> {
    let outside = |values: [f64; 3], is_right: fn(f64) -> bool| values.into_iter().find(|&x| !is_right(x));
    let name = || material.name.clone();
    if let Some(value) = outside(material.reflectance, |r| (0.0..=1.0).contains(&r)) {
        return Err(Error::Mesh(MeshError::Reflectance { material: name(), value }));
    }
    if let Some(value) = outside(material.emission, is_radiance) {
        return Err(Error::Mesh(MeshError::Emission { material: name(), value, most: MOST_RADIANCE }));
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;
    use glam::dvec3;

    fn square() -> [DVec3; 4] {
        [dvec3(0., 0., 0.), dvec3(2., 0., 0.), dvec3(2., 1., 0.), dvec3(0., 1., 0.)]
    }

    fn grey() -> Material {
        Material::new("grey", [0.5; 3], [0.0; 3])
    }

    #[test]
    fn polygons_become_triangles_with_the_same_area_front_and_face() {
        let scene =
            Scene::from_indexed(&square(), [vec![0, 1, 2, 3], vec![2, 1, 0]], &[1, 0], vec![grey(); 2]);
        let scene = scene.unwrap();
        assert_eq!((scene.triangles.len(), scene.vertices.len(), scene.faces.len()), (3, 4, 2));
        assert_eq!(scene.area(0) + scene.area(1), 2.0);
        assert_eq!((scene.normal(0), scene.normal(2)), (DVec3::Z, -DVec3::Z));
        assert_eq!(scene.triangles.iter().map(|t| t.material).collect::<Vec<_>>(), [1, 1, 0]);
        assert_eq!(scene.faces.iter().map(|f| f.first).collect::<Vec<_>>(), [0, 2]);
    }

    #[test]
    fn each_wrong_array_has_its_error() {
        let refused = |vertices: &[DVec3], face: &[u32], of_face: &[u32], material: Material| {
            match Scene::from_indexed(vertices, [face], of_face, vec![material]) {
                Err(Error::Mesh(error)) => error,
                other => panic!("{other:?}"),
            }
        };
        let good: &[u32] = &[0, 1, 2];
        let mut holes = square();
        holes[3].y = f64::NAN;
        assert_eq!(refused(&holes, good, &[0], grey()), MeshError::NotFinite { vertex: 3 });
        let far = MeshError::NoSuchVertex { face: 0, vertex: 4, vertices: 4 };
        assert_eq!(refused(&square(), &[0, 1, 4], &[0], grey()), far);
        assert_eq!(refused(&square(), &[0, 1], &[0], grey()), MeshError::FewCorners { face: 0, corners: 2 });
        let other = MeshError::NoSuchMaterial { face: 0, material: 1, materials: 1 };
        assert_eq!(refused(&square(), good, &[1], grey()), other);
        for given in [&[][..], &[0, 0]] {
            let want = MeshError::MaterialOfFace { faces: 1, given: given.len() };
            assert_eq!(refused(&square(), good, given, grey()), want);
        }
        let bright = Material { reflectance: [0.5, 1.1, 0.5], ..grey() };
        let want = MeshError::Reflectance { material: "grey".into(), value: 1.1 };
        assert_eq!(refused(&square(), good, &[0], bright), want);
        let negative = Material { emission: [-1.0, 0.0, 0.0], ..grey() };
        let want = MeshError::Emission { material: "grey".into(), value: -1.0, most: MOST_RADIANCE };
        assert_eq!(refused(&square(), good, &[0], negative), want);
    }
}
