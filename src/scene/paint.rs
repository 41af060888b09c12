//! Reflectance and emission that differ from face to face.

use std::collections::HashMap;

use super::{Scene, indexed::check_values};
use crate::Result;

impl Scene {
    /// The face that a [`Triangle::source`](super::Triangle::source) is of, as an index into [`Scene::faces`]: the last one that
    /// begins at or before it. `None` where the faces were not kept.
    pub fn face_of_source(&self, source: u32) -> Option<usize> {
        self.faces.partition_point(|face| face.first <= source).checked_sub(1)
    }

    /// The face that each triangle is of, as an index into [`Scene::faces`]; [`Triangle::source`](super::Triangle::source)
    /// where the faces were not kept.
    pub fn face_of_triangles(&self) -> Vec<usize> {
        let face = |source: u32| self.face_of_source(source).unwrap_or(source as usize);
        self.triangles.iter().map(|triangle| face(triangle.source)).collect()
    }

    /// Gives each face a reflectance, an emitted radiance, or both, R G B; `None` leaves what there is. Textures and colours of
    /// vertices do not count where a value is given. Materials are split where their faces differ; the parts keep the name.
    ///
    /// Patches made before take the change by [`Patches::update_materials`](crate::patch::Patches::update_materials).
    ///
    /// # Errors
    /// [`Error::Mesh`](crate::Error::Mesh) when a reflectance is outside 0 to 1, or a radiance [is out of
    /// range](super::is_radiance). The scene is left as it was.
    ///
    /// # Panics
    /// When a list has no value for a face that has a triangle.
    pub fn paint(&mut self, reflectance: Option<&[[f64; 3]]>, emission: Option<&[[f64; 3]]>) -> Result<()> {
        let faces = self.face_of_triangles();
        let bits = |values: Option<&[[f64; 3]]>, face: usize| values.map(|v| v[face].map(f64::to_bits));
        let mut materials = Vec::new();
        let mut known = HashMap::new();
        let mut of_triangle = Vec::with_capacity(faces.len());
        for (triangle, &face) in self.triangles.iter().zip(&faces) {
            let key = (triangle.material, bits(reflectance, face), bits(emission, face));
            of_triangle.push(*known.entry(key).or_insert_with(|| {
                let mut material = self.materials[triangle.material as usize].clone();
                if let Some(values) = reflectance {
                    material.reflectance = values[face];
                    material.reflectance_map = None;
                    material.reflectance_offset = [0.0; 3];
                }
                if let Some(values) = emission {
                    material.emission = values[face];
                    material.emission_map = None;
                }
                materials.push(material);
                materials.len() as u32 - 1
            }));
        }
        materials.iter().try_for_each(check_values)?;
        let new = self.triangles.iter_mut().zip(of_triangle);
        new.for_each(|(triangle, material)| triangle.material = material);
        self.materials = materials;
        if reflectance.is_some() {
            self.colours.iter_mut().for_each(|colours| *colours = [[1.0; 3]; 3]);
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::scene::Material;
    use glam::dvec3;

    #[test]
    fn faces_get_their_own_values_and_materials_are_shared_where_they_agree() {
        let vertices =
            [dvec3(0., 0., 0.), dvec3(1., 0., 0.), dvec3(1., 1., 0.), dvec3(0., 1., 0.), dvec3(0., 0., 1.)];
        let faces = [vec![0, 1, 2, 3], vec![0, 3, 4], vec![0, 4, 1]];
        let white = Material::new("white", [0.8; 3], [2.0; 3]);
        let mut scene = Scene::from_indexed(&vertices, faces, &[0, 0, 0], vec![white]).unwrap();
        assert_eq!(scene.face_of_triangles(), [0, 0, 1, 2]);
        scene.paint(Some(&[[0.1; 3], [0.2, 0.3, 0.4], [0.1; 3]]), None).unwrap();
        assert_eq!(scene.materials.len(), 2);
        let reflectances: Vec<f64> = (0..4).map(|t| scene.material(t).reflectance[2]).collect();
        assert_eq!(reflectances, [0.1, 0.1, 0.4, 0.1]);
        assert!((0..4).all(|t| scene.material(t).emission == [2.0; 3] && scene.material(t).name == "white"));
        scene.paint(None, Some(&[[0.0; 3], [0.0; 3], [5.0; 3]])).unwrap();
        assert_eq!((0..4).map(|t| scene.emits(t)).collect::<Vec<_>>(), [false, false, false, true]);
        assert_eq!(scene.material(2).reflectance, [0.2, 0.3, 0.4]);
        let error = scene.paint(Some(&[[0.1; 3], [1.5; 3], [0.1; 3]]), None).unwrap_err();
        assert!(error.to_string().contains("reflectance 1.5 is outside 0..1"), "{error}");
    }
}
