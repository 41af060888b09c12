//! `bake --per-light`: a map for each emitting material and each light, so that an engine can switch and dim them.

use radiosity::{
    Result, Scene,
    patch::Patches,
    solve::{Solution, solve_linear},
    trace::Tracer,
};

use super::{bake::BakeArgs, options::keep_emitters, pipeline::Solved, watch::Watch};

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

/// The scene, patches and solution of each name alone. All share the rays and form factors of the whole solution.
pub fn solutions(
    args: &BakeArgs,
    (scene, tracer): (&Scene, &Tracer),
    solved: &Solved,
    names: &[String],
    watch: &Watch,
) -> Result<Vec<(Scene, Patches, Solution)>> {
    let options = args.job().options();
    let solve = |name: &String| {
        let (mut alone, mut patches) = (scene.clone(), solved.patches.clone());
        keep_emitters(&mut alone, std::slice::from_ref(name));
        patches.update_materials(&alone);
        let form_factors = solved.form_factors.with_lights(scene, |light| light == name);
        let (solution, _) = watch.stage("solving", || {
            solve_linear((&alone, tracer), &form_factors, &patches, &options, watch.progress())
        })?;
        Ok((alone, patches, solution))
    };
    names.iter().map(solve).collect()
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
