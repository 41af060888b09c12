//! `bake --per-light`: a map for each emitting material and each light, so that an engine can switch and dim them.

use radiosity::{
    Result, Scene,
    lightmap::{self, Atlas, Lightmap},
    trace::Tracer,
};

use super::{bake::BakeArgs, options::keep_emitters, watch::Watch};

/// The names of what emits, each once, in the order of materials, lights, sky.
pub fn names(scene: &Scene) -> Vec<String> {
    let materials = scene.materials.iter().filter(|m| m.emits()).map(|m| &m.name[..]);
    let mut names: Vec<String> = Vec::new();
    for name in materials.chain(scene.lights.names()) {
        if !names.iter().any(|known| known == name) {
            names.push(name.into());
        }
    }
    names
}

/// The names as parts of file names: other characters than letters, digits, `-`, `_` and `.` become `_`, and equal ones get a number.
pub fn stems(names: &[String]) -> Vec<String> {
    let plain = |c: char| if c.is_alphanumeric() || "-_.".contains(c) { c } else { '_' };
    let mut stems: Vec<String> = Vec::new();
    for name in names {
        let stem: String = name.chars().map(plain).collect();
        // File systems may not tell upper from lower case.
        let is_taken = |stem: &str| stems.iter().any(|known| known.to_lowercase() == stem.to_lowercase());
        let numbered = (2..).map(|k| format!("{stem}-{k}"));
        let free = std::iter::once(stem.clone()).chain(numbered).find(|stem| !is_taken(stem));
        stems.extend(free);
    }
    stems
}

/// A map for each name, on the same atlas. Each takes rays of its own, since rays go where light is.
pub fn bake(
    args: &BakeArgs,
    (scene, tracer): (&Scene, &Tracer),
    atlas: &Atlas,
    names: &[String],
    watch: &Watch,
) -> Result<Vec<Lightmap>> {
    let bake_one = |name: &String| {
        let mut alone = scene.clone();
        keep_emitters(&mut alone, std::slice::from_ref(name));
        let solved = args.job().solve(&alone, tracer, watch, &mut Default::default())?;
        let light = (&solved.patches, &solved.solution);
        let (map, _) = watch.stage("texels", || {
            lightmap::bake(&alone, tracer, light, atlas.clone(), &args.options(), watch.progress())
        })?;
        Ok(map)
    };
    names.iter().map(bake_one).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn names_become_file_names() {
        let of = |names: &[&str]| stems(&names.iter().map(|name| name.to_string()).collect::<Vec<_>>());
        assert_eq!(
            of(&["lamp", "a/b: c", "Lamp", "lamp", "été"]),
            ["lamp", "a_b__c", "Lamp-2", "lamp-3", "été"]
        );
    }
}
