//! Scenes as the commands read them, for programs that have other ways to give options.

use std::{error::Error as _, ffi::OsString};

use clap::{
    Args, CommandFactory, FromArgMatches, Parser,
    error::{ContextKind, ContextValue},
};
use radiosity::{Error, Result, Scene, monte_carlo::reflection::SpecularPart};

use super::{explain, lights::LightArgs, options::SceneArgs};

/// The options of one kind alone, without the name of a program before them.
#[derive(Parser)]
#[command(no_binary_name = true, disable_help_flag = true)]
struct Alone<A: Args> {
    #[command(flatten)]
    args: A,
}

/// Reads a scene by the file and the options that all commands take, as in `["room.obj", "--sun=220,40,800"]`, and says what
/// becomes of specular parts where surfaces count as Lambertian. Triangles are not yet cut where surfaces touch or cross
/// ([`Scene::cut_contacts`]).
///
/// # Errors
/// [`Error::Usage`] for options that are wrong, and those of [`Scene::load`].
pub fn read_scene(words: impl IntoIterator<Item = OsString>) -> Result<(Scene, SpecularPart)> {
    let args: SceneArgs = parsed(words)?;
    Ok((args.load()?, args.specular()))
}

/// Adds lights that are no surfaces to a scene, by the options that all commands take, as in `["--sky=uniform:1"]`. Their numbers
/// are in the units of the scene.
///
/// # Errors
/// [`Error::Usage`] for options that are wrong, and errors of the files that they name.
pub fn add_lights(scene: &mut Scene, words: impl IntoIterator<Item = OsString>) -> Result<()> {
    parsed::<LightArgs>(words)?.add(scene, None)
}

fn parsed<A: Args>(words: impl IntoIterator<Item = OsString>) -> Result<A> {
    let matches = Alone::<A>::command().try_get_matches_from(words);
    let alone = matches.and_then(|matches| Alone::from_arg_matches(&matches));
    alone.map(|alone| alone.args).map_err(|error| {
        let (what, hint) = explain(&error);
        let message = match (error.get(ContextKind::InvalidArg), error.source()) {
            // The option, without the form of its value.
            (Some(ContextValue::String(option)), Some(reason)) => {
                format!("{}: {reason}", option.split(' ').next().unwrap_or_default())
            }
            _ => what,
        };
        Error::Usage { message, hint }
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    fn words(words: &[&str]) -> Vec<OsString> {
        words.iter().map(Into::into).collect()
    }

    #[test]
    fn words_make_a_scene_with_its_lights() {
        let given = words(&["meshes/cornell-box.obj", "--emit=3@white", "--ignore=light", "--sky=uniform:2"]);
        let (scene, specular) = read_scene(given).unwrap();
        assert!(scene.materials.iter().any(|m| m.name == "white" && m.emission == [3.0; 3]));
        assert_eq!(scene.lights.names().collect::<Vec<_>>(), ["sky"]);
        assert_eq!(specular, SpecularPart::Diffuse);
    }

    #[test]
    fn lights_are_added_to_those_that_are_there() {
        let (mut scene, _) = read_scene(words(&["meshes/cornell-box.obj", "--sky=uniform:2"])).unwrap();
        add_lights(&mut scene, words(&["--sun=90,45,800"])).unwrap();
        assert_eq!(scene.lights.names().collect::<Vec<_>>(), ["sun", "sky"]);
    }

    #[test]
    fn wrong_words_are_errors_that_name_the_option() {
        let mut scene = Scene::load("meshes/cornell-box.obj").unwrap();
        for (given, message) in [
            ("--sun=1,91,3", "--sun: the altitude of the sun must be between 0 and 90 degrees"),
            ("--sky=blue:1", "--sky: expected uniform:RADIANCE"),
            ("--sky-rotation=3", "required"),
            ("--nothing", "unexpected argument"),
        ] {
            let error = add_lights(&mut scene, words(&[given])).unwrap_err();
            assert!(error.to_string().contains(message), "{error}");
            assert!(scene.lights.is_empty());
        }
    }
}
