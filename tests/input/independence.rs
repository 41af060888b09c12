//! No module imports from a higher layer, and the referee shares only scene and rays with the solver.

use std::{
    collections::BTreeSet,
    fs,
    path::{Path, PathBuf},
};

/// Items at the root of the crate that every module may use.
const COMMON: [&str; 9] =
    ["Error", "MeshError", "Setting", "Result", "Progress", "Quality", "Scene", "Connection", "Ranks"];

/// Each module, the modules it may use, and the modules that its tests may use in addition.
const LAYERS: [(&str, &[&str], &[&str]); 26] = [
    ("setters", &[], &[]),
    ("error", &[], &[]),
    ("progress", &[], &[]),
    ("quality", &[], &[]),
    ("ranks", &[], &[]),
    ("tone", &[], &[]),
    ("parallel", &[], &[]),
    ("slopes", &[], &[]),
    ("exact", &[], &[]),
    ("scene", &["tone"], &["trace"]),
    ("trace", &["scene"], &[]),
    ("patch", &["scene"], &["trace"]),
    ("rays", &["ranks", "parallel", "scene", "trace", "patch"], &[]),
    ("symmetric", &["ranks"], &[]),
    ("direct", &["ranks", "exact", "parallel", "slopes", "scene", "trace", "patch", "rays"], &[]),
    (
        "form_factor",
        &["ranks", "exact", "parallel", "scene", "trace", "patch", "rays", "symmetric", "direct"],
        &[],
    ),
    ("moments", &["slopes", "scene", "trace", "patch", "rays", "direct", "form_factor"], &[]),
    ("view_factor", &["scene", "trace", "patch", "form_factor"], &[]),
    (
        "solve",
        &["slopes", "parallel", "scene", "trace", "patch", "rays", "direct", "form_factor", "moments"],
        &[],
    ),
    ("daylight", &["scene", "trace", "patch", "rays", "direct", "form_factor"], &[]),
    ("heat", &["form_factor", "scene", "view_factor", "solve"], &[]),
    ("energy", &["patch", "form_factor", "solve"], &["scene", "trace"]),
    ("monte_carlo", &["tone", "scene", "trace"], &[]),
    (
        "accuracy",
        &[
            "tone",
            "scene",
            "trace",
            "patch",
            "rays",
            "direct",
            "form_factor",
            "moments",
            "solve",
            "energy",
            "monte_carlo",
        ],
        &[],
    ),
    (
        "output",
        &[
            "tone",
            "slopes",
            "scene",
            "trace",
            "patch",
            "rays",
            "form_factor",
            "view_factor",
            "solve",
            "heat",
            "daylight",
            "energy",
            "monte_carlo",
            "accuracy",
        ],
        &[],
    ),
    ("lightmap", &["tone", "scene", "trace", "patch", "solve", "monte_carlo", "output"], &["form_factor"]),
];

/// The code without comments and without the contents of string literals.
fn bare(source: &str) -> String {
    let mut code = String::new();
    let mut rest = source;
    while let Some(at) = rest.find(['/', '"', '\'']) {
        code.push_str(&rest[..at]);
        rest = &rest[at..];
        let skipped = if rest.starts_with("//") {
            rest.find('\n').unwrap_or(rest.len())
        } else if rest.starts_with("/*") {
            rest.find("*/").map_or(rest.len(), |end| end + 2)
        } else if rest.starts_with('"') {
            string_length(rest)
        } else if rest.starts_with("'\"'") {
            3
        } else {
            code.push_str(&rest[..1]);
            1
        };
        rest = &rest[skipped..];
    }
    code + rest
}

/// The length in bytes of the string literal at the start of `text`.
fn string_length(text: &str) -> usize {
    let bytes = text.as_bytes();
    let mut i = 1;
    while i < bytes.len() && bytes[i] != b'"' {
        i += if bytes[i] == b'\\' { 2 } else { 1 };
    }
    (i + 1).min(bytes.len())
}

fn is_word(c: char) -> bool {
    c.is_alphanumeric() || c == '_'
}

/// The names that follow each `crate::` and each chain of `super::`, also those in braces.
fn used(code: &str) -> BTreeSet<String> {
    let mut names = BTreeSet::new();
    for root in ["crate", "super"] {
        for (at, _) in code.match_indices(root) {
            if code[..at].ends_with(is_word) {
                continue;
            }
            let Some(mut rest) = code[at + root.len()..].trim_start().strip_prefix("::") else {
                // A visibility, `pub(crate)`. An alias of the crate would hide uses.
                assert!(!code[at + root.len()..].trim_start().starts_with("as "), "the crate has an alias");
                continue;
            };
            rest = rest.trim_start();
            match rest.strip_prefix('{') {
                Some(group) => names.extend(firsts(group)),
                None => names.extend(first(rest)),
            }
        }
    }
    names
}

/// The first word of a path.
fn first(path: &str) -> Option<String> {
    let path = path.trim_start();
    if path.starts_with('*') {
        return Some("*".into());
    }
    let word: String = path.chars().take_while(|&c| is_word(c)).collect();
    (!word.is_empty()).then_some(word)
}

/// The first words of the paths in a group, up to its closing brace.
fn firsts(group: &str) -> Vec<String> {
    let (mut depth, mut start, mut names) = (0, 0, Vec::new());
    for (i, c) in group.char_indices() {
        match c {
            '{' => depth += 1,
            '}' if depth > 0 => depth -= 1,
            ',' | '}' if depth == 0 => {
                names.extend(first(&group[start..i]));
                start = i + 1;
                if c == '}' {
                    break;
                }
            }
            _ => {}
        }
    }
    names
}

/// The modules that a source file uses although the lists do not allow them.
fn offences(source: &str, module: &str, allowed: &[&str], in_tests: &[&str]) -> Vec<String> {
    let code = bare(source);
    assert!(!code.contains("crate::*"), "a glob hides what is used");
    // The name of the crate is for the command line, which uses the library as other programs do.
    let is_path = |at: usize| !code[..at].ends_with(|c| is_word(c) || c == '.');
    assert!(!code.match_indices("radiosity::").any(|(at, _)| is_path(at)), "crate:: is wanted");
    let tests = code.find("#[cfg(test)]\nmod tests {").unwrap_or(code.len());
    let modules: BTreeSet<&str> = LAYERS.iter().map(|layer| layer.0).chain(["cli"]).collect();
    let offends = |name: &String, more: &[&str]| {
        let foreign = modules.contains(name.as_str()) || name == "self";
        foreign && name != module && !allowed.contains(&name.as_str()) && !more.contains(&name.as_str())
    };
    let (work, test) = code.split_at(tests);
    let mut found: Vec<String> = used(work).into_iter().filter(|name| offends(name, &[])).collect();
    found.extend(used(test).into_iter().filter(|name| offends(name, in_tests)));
    found
}

fn sources(path: &Path) -> Vec<PathBuf> {
    if path.is_file() {
        return vec![path.to_owned()];
    }
    let mut files: Vec<PathBuf> =
        fs::read_dir(path).unwrap().flat_map(|entry| sources(&entry.unwrap().path())).collect();
    files.retain(|file| file.extension().is_some_and(|e| e == "rs"));
    files.sort();
    files
}

fn src() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("src")
}

/// The files of a module: the file or the directory with its name, or both.
fn files(module: &str) -> Vec<PathBuf> {
    [src().join(format!("{module}.rs")), src().join(module)]
        .into_iter()
        .filter(|path| path.exists())
        .flat_map(|path| sources(&path))
        .collect()
}

#[test]
fn every_module_uses_only_what_is_below_it() {
    let mut read = 0;
    for (module, allowed, in_tests) in LAYERS {
        let files = files(module);
        assert!(!files.is_empty(), "there is no module {module}");
        for file in files {
            let found = offences(&fs::read_to_string(&file).unwrap(), module, allowed, in_tests);
            assert!(found.is_empty(), "{} uses {found:?}", file.display());
            read += 1;
        }
    }
    assert!(read > 40, "only {read} files were read");
}

#[test]
fn no_module_is_forgotten() {
    let known: BTreeSet<String> = LAYERS.iter().map(|layer| layer.0.to_owned()).collect();
    for entry in fs::read_dir(src()).unwrap() {
        let name = entry.unwrap().path().file_stem().unwrap().to_string_lossy().into_owned();
        assert!(
            ["lib", "main", "cli"].contains(&name.as_str()) || known.contains(&name),
            "{name} has no layer"
        );
    }
    // The root re-exports only from the lowest layers.
    let root = bare(&fs::read_to_string(src().join("lib.rs")).unwrap());
    for line in root.lines().filter_map(|line| line.strip_prefix("pub use ")).filter(|line| *line != "glam;")
    {
        let (from, names) = line.split_once("::").unwrap();
        assert!(["error", "progress", "quality", "ranks", "scene"].contains(&from), "{line}");
        let names = names.trim_matches(['{', '}', ';']);
        assert!(names.split(", ").all(|name| COMMON.contains(&name)), "{line}");
    }
}

/// The command line adds the names of its options to hints of the library. Other programs have no such options.
#[test]
fn no_message_of_the_library_names_an_option() {
    for file in LAYERS.iter().flat_map(|layer| files(layer.0)) {
        let source = fs::read_to_string(&file).unwrap();
        for line in source.lines().filter(|line| !line.trim_start().starts_with("//")) {
            let named = line
                .match_indices("--")
                .any(|(at, _)| line[at + 2..].starts_with(|c: char| c.is_ascii_lowercase()));
            assert!(!named, "{}: {line}", file.display());
        }
    }
}

#[test]
fn the_referee_uses_neither_the_solver_nor_what_builds_on_it() {
    let referee: Vec<PathBuf> = files("monte_carlo");
    assert!(referee.len() >= 10);
    for file in referee {
        let names = used(&bare(&fs::read_to_string(&file).unwrap()));
        for forbidden in ["form_factor", "solve", "patch", "energy", "accuracy", "output", "cli"] {
            assert!(!names.contains(forbidden), "{} uses {forbidden}", file.display());
        }
    }
}

#[test]
fn a_forbidden_use_is_found_wherever_it_hides() {
    let found = |source: &str| offences(source, "monte_carlo", &["tone", "scene", "trace"], &["patch"]);
    for source in [
        "use crate::form_factor::FormFactors;",
        "use crate::{Error, scene::Scene, form_factor::{self, FormFactors}};",
        "use crate::{\n    trace::{Hit, Tracer},\n    form_factor::exact,\n};",
        "fn f() -> f64 { crate::form_factor::exact::point_to_polygon() }",
        "use super::super::form_factor::FormFactors;",
        "use super::super::{Camera, form_factor};",
        "use crate :: form_factor;",
        "const QUOTE: char = '\"'; use crate::form_factor;",
        "let s = \"\\\"\"; crate::form_factor::f();",
        "#[cfg(test)]\nmod tests {\n    use crate::form_factor;\n}",
    ] {
        assert_eq!(found(source), ["form_factor"], "{source}");
    }
    assert_eq!(found("use crate::{self, scene};"), ["self"]);
    for source in [
        "//! Not [`crate::form_factor`].\nuse crate::{Result, scene::Scene, trace};",
        "/* crate::solve */ let s = \"crate::solve\";",
        "pub(crate) fn solve() {}\nuse super::Samples;",
        "#[cfg(test)]\nmod tests {\n    use crate::patch;\n}",
    ] {
        assert!(found(source).is_empty(), "{source}");
    }
    assert_eq!(found("use crate::patch;"), ["patch"]);
}
