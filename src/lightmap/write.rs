//! Files of a map: images, and a mesh whose texture coordinates address them.

use std::{
    borrow::Cow,
    io::{self, Write},
};

use super::{
    Atlas, Lightmap, Texel,
    atlas::NONE,
    dilation,
    grid::Grid,
    mesh::{self, Set},
};
use crate::{
    monte_carlo::{Film, PictureFormat},
    scene::Scene,
    tone::{Exposure, luminance},
};

/// The quantity that an image of the map shows.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Picture {
    /// Irradiance, W/m².
    Irradiance,
    /// Radiosity, W/m²: the light that a viewer without lights of its own should show.
    Radiosity,
    /// Standard error of irradiance, W/m².
    StandardError,
    /// Kind of each texel. White is surface, grey is hidden surface, dark grey is a value from neighbours, black is
    /// empty.
    Mask,
}

/// The values of one kind of image on all pages.
#[derive(Debug, Clone)]
pub struct Layer<'a> {
    atlas: &'a Atlas,
    values: Cow<'a, [[f32; 3]]>,
}

impl Layer<'_> {
    /// One page as an image, rows from the top as in image files.
    ///
    /// # Panics
    /// If there is no such page.
    pub fn page(&self, page: usize) -> Film {
        let (width, height) = (self.atlas.width, self.atlas.height);
        let rows = self.values[page * width * height..][..width * height].chunks(width).rev();
        Film::from_pixels(width, height, rows.flatten().copied().collect())
    }
}

impl Lightmap {
    /// The values of all pages for one kind of image. Radiosity takes time to compute, so call this once for all pages.
    pub fn layer(&self, scene: &Scene, what: Picture) -> Layer<'_> {
        let values = match what {
            Picture::Irradiance => Cow::Borrowed(&*self.irradiance),
            Picture::Radiosity => self.dilated_radiosity(scene).into(),
            Picture::StandardError => {
                let mut values = vec![[0.0; 3]; self.irradiance.len()];
                for (&at, &error) in self.coverage.texels().iter().zip(&self.standard_error) {
                    values[at as usize] = error;
                }
                values.into()
            }
            Picture::Mask => {
                let shade = |texel: &Texel| match texel {
                    Texel::Valid => [1.0; 3],
                    // sRGB encodes these values as 128 and 64.
                    Texel::Hidden => [0.215_86; 3],
                    Texel::Dilated => [0.051_27; 3],
                    Texel::Empty => [0.0; 3],
                };
                self.texels.iter().map(shade).collect()
            }
        };
        Layer { atlas: &self.atlas, values }
    }

    /// Automatic exposure for the irradiance of the texels, weighted by area.
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

    /// Writes the mesh with the texture coordinates of the map. `library` is the name of its material library.
    ///
    /// # Errors
    /// Errors of `out`. If the scene comes from an OBJ file, the mesh is a copy of that file, and errors of reading it
    /// are returned too.
    pub fn write_obj(&self, scene: &Scene, library: &str, out: &mut dyn Write) -> io::Result<()> {
        mesh::write(scene, &self.atlas, Set::Map(library), out)
    }

    /// Writes the mesh with the texture coordinates of the scene's file and the names of the scene's own material
    /// libraries. Faces and corners have the same order as in [`Lightmap::write_obj`].
    ///
    /// # Errors
    /// See [`Lightmap::write_obj`].
    pub fn write_original(&self, scene: &Scene, libraries: &[String], out: &mut dyn Write) -> io::Result<()> {
        mesh::write(scene, &self.atlas, Set::Own(libraries), out)
    }

    /// Writes the material library of [`Lightmap::write_obj`]. Every material emits the radiosity of its page, whose
    /// image has the name `image(page)`, and reflects nothing. So viewers show the same with and without lights of
    /// their own.
    ///
    /// # Errors
    /// Errors of `out`.
    pub fn write_mtl(
        &self,
        scene: &Scene,
        image: impl Fn(usize) -> String,
        out: &mut dyn Write,
    ) -> io::Result<()> {
        writeln!(
            out,
            "# radiosity bake: the texture is what leaves the surface, lamps and reflections, exposed for viewing"
        )?;
        let scene = self.atlas.scene(scene);
        let mut written = std::collections::BTreeSet::new();
        for t in 0..scene.triangles.len() {
            let name = mesh::material_name(scene, &self.atlas, t);
            if !written.contains(&*name) {
                let [r, g, b] = scene.material(t).reflectance;
                writeln!(out, "\nnewmtl {name}\n# reflectance of the scene's material: {r} {g} {b}")?;
                writeln!(out, "Ka 0 0 0\nKd 0 0 0\nKs 0 0 0\nKe 1 1 1\nillum 1")?;
                writeln!(out, "map_Ke {}", image(self.atlas.page[t] as usize))?;
                written.insert(name.into_owned());
            }
        }
        Ok(())
    }
}

/// The name of a page's image: `stem.ext`, `stem-2.ext`, `stem-3.ext`.
pub fn page_name(stem: &str, page: usize, format: PictureFormat) -> String {
    let extension = format.extension();
    if page == 0 { format!("{stem}.{extension}") } else { format!("{stem}-{}.{extension}", page + 1) }
}
