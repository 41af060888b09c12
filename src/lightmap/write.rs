//! A map as files: images, and a mesh whose texture coordinates address them.

use std::{
    collections::HashMap,
    io::{self, Write},
};

use glam::DVec2;

use super::{Lightmap, Texel, atlas::NONE, dilation, grid::Grid};
use crate::{
    monte_carlo::{Film, PictureFormat},
    scene::Scene,
    tone::{Exposure, luminance},
};

/// The first line of every mesh and material library written here.
pub const SIGNATURE: &str = "# radiosity bake";

/// What an image shows.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Picture {
    /// Irradiance.
    Irradiance,
    /// Radiosity: what a viewer without lights of its own should show.
    Radiosity,
    /// Standard error of irradiance.
    StandardError,
    /// White: surface; grey: hidden surface; dark grey: a value from neighbours; black: nothing.
    Mask,
}

impl Lightmap {
    /// One page as an image, rows from the top as image files have them.
    ///
    /// # Panics
    /// When there is no such page.
    pub fn picture(&self, scene: &Scene, what: Picture, page: usize) -> Film {
        let values = match what {
            Picture::Irradiance => self.irradiance.clone(),
            Picture::Radiosity => self.dilated_radiosity(scene),
            Picture::StandardError => {
                let mut values = vec![[0.0; 3]; self.irradiance.len()];
                for (&at, &error) in self.coverage.texels().iter().zip(&self.standard_error) {
                    values[at as usize] = error;
                }
                values
            }
            Picture::Mask => self
                .texels
                .iter()
                .map(|texel| match texel {
                    Texel::Valid => [1.0; 3],
                    // What sRGB encodes as 128 and 64.
                    Texel::Hidden => [0.215_86; 3],
                    Texel::Dilated => [0.051_27; 3],
                    Texel::Empty => [0.0; 3],
                })
                .collect(),
        };
        let (width, height) = (self.atlas.width, self.atlas.height);
        let rows = values[page * width * height..][..width * height].chunks(width).rev();
        Film::from_pixels(width, height, rows.flatten().copied().collect())
    }

    /// Exposure that suits the irradiance of surfaces, by area.
    pub fn exposure(&self) -> Exposure {
        Exposure::automatic(
            self.coverage
                .texels()
                .iter()
                .enumerate()
                .map(|(i, &at)| (luminance(self.irradiance[at as usize].map(f64::from)), self.open_area(i))),
        )
    }

    pub(super) fn dilated_radiosity(&self, scene: &Scene) -> Vec<[f32; 3]> {
        let mut values = self.radiosity(scene);
        if self.texels.contains(&Texel::Dilated) {
            let grid = Grid::new(&self.atlas, &self.coverage);
            let mut owner = vec![NONE; values.len()];
            for (i, &at) in self.coverage.texels().iter().enumerate() {
                owner[at as usize] = grid.chart(i);
            }
            dilation::dilate(&grid, &mut owner, &mut values);
        }
        values
    }

    /// Name of a page's material for a material of the scene.
    fn material_name(&self, names: &[String], t: usize, scene: &Scene) -> String {
        let name = &names[scene.triangles[t].material as usize];
        match self.atlas.page[t] {
            0 => name.clone(),
            page => format!("{name} page {}", page + 1),
        }
    }

    /// Writes the mesh with the texture coordinates of the map; `library` names its materials' file.
    ///
    /// # Errors
    /// What `out` says.
    pub fn write_obj(&self, scene: &Scene, library: &str, out: &mut dyn Write) -> io::Result<()> {
        writeln!(out, "{SIGNATURE}: texture coordinates address the lightmap, v upwards")?;
        writeln!(out, "mtllib {library}")?;
        let names = distinct_names(scene);
        let name = |t: usize| self.material_name(&names, t, scene);
        mesh(scene, &self.atlas.coordinates, &self.atlas.corners, name, out)
    }

    /// Writes the material library of [`Lightmap::write_obj`]: every material shows the radiosity of its page, whose
    /// image has the name `image(page)`, without regard to lights.
    ///
    /// # Errors
    /// What `out` says.
    pub fn write_mtl(
        &self,
        scene: &Scene,
        image: impl Fn(usize) -> String,
        out: &mut dyn Write,
    ) -> io::Result<()> {
        writeln!(
            out,
            "{SIGNATURE}: the texture is what leaves the surface, lamps and reflections, exposed for viewing"
        )?;
        let names = distinct_names(scene);
        let mut written = std::collections::BTreeSet::new();
        for t in 0..scene.triangles.len() {
            let name = self.material_name(&names, t, scene);
            if written.insert(name.clone()) {
                let material = scene.material(t);
                let [r, g, b] = material.reflectance;
                writeln!(out, "\nnewmtl {name}\n# reflectance of the scene's material: {r} {g} {b}")?;
                writeln!(out, "Kd 1 1 1\nKa 0 0 0\nKs 0 0 0\nillum 0")?;
                writeln!(out, "map_Kd {}", image(self.atlas.page[t] as usize))?;
            }
        }
        Ok(())
    }
}

/// Writes the scene's mesh with the texture coordinates that its own file has, vertex by vertex and face by face as
/// [`Lightmap::write_obj`] does.
///
/// # Errors
/// What `out` says.
pub fn write_original(scene: &Scene, out: &mut dyn Write) -> io::Result<()> {
    writeln!(
        out,
        "{SIGNATURE}: the same vertices and faces as scene.obj, with the scene's own texture coordinates"
    )?;
    let (mut known, mut coordinates) = (HashMap::new(), Vec::new());
    let mut corner = |uv: DVec2| {
        *known.entry(uv.to_array().map(f64::to_bits)).or_insert_with(|| {
            coordinates.push(uv);
            coordinates.len() as u32 - 1
        })
    };
    let corners: Vec<[u32; 3]> = scene.texcoords.iter().map(|uv| uv.map(&mut corner)).collect();
    let names = distinct_names(scene);
    mesh(scene, &coordinates, &corners, |t| names[scene.triangles[t].material as usize].clone(), out)
}

fn mesh(
    scene: &Scene,
    coordinates: &[DVec2],
    corners: &[[u32; 3]],
    material: impl Fn(usize) -> String,
    out: &mut dyn Write,
) -> io::Result<()> {
    for v in &scene.vertices {
        writeln!(out, "v {} {} {}", v.x, v.y, v.z)?;
    }
    for uv in coordinates {
        writeln!(out, "vt {} {}", uv.x, uv.y)?;
    }
    let mut used = None;
    for (t, triangle) in scene.triangles.iter().enumerate() {
        let name = material(t);
        if used.as_ref() != Some(&name) {
            writeln!(out, "usemtl {name}")?;
            used = Some(name);
        }
        let [a, b, c] = triangle.vertices.map(|v| v + 1);
        let [ta, tb, tc] = corners[t].map(|i| i + 1);
        writeln!(out, "f {a}/{ta} {b}/{tb} {c}/{tc}")?;
    }
    Ok(())
}

/// Names of the scene's materials, with a number where two have the same.
fn distinct_names(scene: &Scene) -> Vec<String> {
    let mut names: Vec<String> = Vec::new();
    for material in &scene.materials {
        let mut name = material.name.clone();
        let mut number = 2;
        while names.contains(&name) {
            name = format!("{} {number}", material.name);
            number += 1;
        }
        names.push(name);
    }
    names
}

/// The name of a page's image: `stem.ext`, `stem-2.ext`, `stem-3.ext`.
pub fn page_name(stem: &str, page: usize, format: PictureFormat) -> String {
    let extension = format.extension();
    if page == 0 { format!("{stem}.{extension}") } else { format!("{stem}-{}.{extension}", page + 1) }
}
