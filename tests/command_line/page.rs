//! Pages: written whole, the same for any number of threads, and never in place of something else. What a browser makes of them is
//! tested in `tests/page`.

use serde_json::Value;

use crate::common::program::{Here, stderr};

/// A floor under two lamps, one of which has a name that would break out of a careless page.
fn here() -> Here {
    Here::new(
        "mtllib scene.mtl\nv 0 0 0\nv 0 0 2\nv 2 0 0\nv 0 1 0\nv 1 1 0\nv 0 1 1\nv 1 1 1\nv 2 1 1\nv 1 1 2\n\
         usemtl floor\nf 1 2 3\nusemtl </script><b>\nf 4 5 6\nusemtl lamp\nf 7 8 9\n",
        "newmtl floor\nKd 0.5 0.4 0.3\nnewmtl </script><b>\nKe 1 2 3\nnewmtl lamp\nKe 3 2 1\n",
    )
}

const SMALL: &str = "--quiet --patches 60 --rays 32";

/// What a page says about itself.
fn about(here: &Here, name: &str) -> Value {
    let page = String::from_utf8(here.read(name)).unwrap();
    assert!(page.starts_with("<!doctype html>") && page.trim_end().ends_with("</html>"));
    assert!(page.contains("default-src 'none'"), "nothing may be requested");
    assert_eq!(page.matches("<script").count(), page.matches("</script").count());
    let text = page.split_once("id=\"about\">").unwrap().1.split_once("</script>").unwrap().0;
    serde_json::from_str(text).unwrap()
}

fn runs(here: &Here, arguments: &str) {
    let output = here.run(arguments);
    // The checks of `validate` are another test's business.
    assert!(matches!(output.status.code(), Some(0 | 1)), "{arguments}: {}", stderr(&output));
    assert!(output.status.success() || arguments.starts_with("validate"), "{}", stderr(&output));
}

#[test]
fn solve_writes_a_page_with_sliders_for_its_lamps() {
    let here = here();
    runs(&here, &format!("solve scene.obj --page a.html --threads 1 {SMALL}"));
    runs(&here, &format!("solve scene.obj --page b.html --threads 3 {SMALL}"));
    assert_eq!(here.read("a.html"), here.read("b.html"));
    let page = about(&here, "a.html");
    assert_eq!(page["title"], "scene.obj");
    let names: Vec<&str> =
        page["layers"].as_array().unwrap().iter().map(|layer| layer["name"].as_str().unwrap()).collect();
    assert_eq!(names, ["</script><b>", "lamp"]);
    for (options, layers, says) in [
        ("--page-lamps 1", 1, "none were asked for"),
        ("--constant-light", 2, "its own solution"),
        ("--solver stochastic-jacobi", 1, "stored none"),
        ("--sky overcast:10", 3, "its own solution"),
        ("--sky overcast:10 --page-lamps 2", 2, "its own solution"),
    ] {
        runs(&here, &format!("solve scene.obj --page a.html {SMALL} {options}"));
        let page = about(&here, "a.html");
        assert_eq!(page["layers"].as_array().unwrap().len(), layers, "{options}");
        assert!(page["notes"].to_string().contains(says), "{options}: {}", page["notes"]);
        assert_eq!(page["sky"].is_object(), options.contains("sky"));
    }
}

#[test]
fn every_report_with_charts_is_a_page_too() {
    let here = here();
    let few = "--quiet --patches 60 --rays 64 --paths 64 --particles 20000";
    runs(&here, &format!("validate scene.obj --page page.html --plots plots.html {few}"));
    let methods = about(&here, "page.html")["methods"].clone();
    let names: Vec<&Value> = methods.as_array().unwrap().iter().map(|method| &method["name"]).collect();
    assert_eq!(names, ["radiosity", "path tracing", "light tracing"]);
    assert_eq!(about(&here, "plots.html")["charts"].as_array().unwrap().len(), 2);
    runs(&here, "tradeoff scene.obj -o tradeoff --quiet --patches 20 --most-rays 20000");
    assert_eq!(about(&here, "tradeoff/tradeoff.html")["charts"].as_array().unwrap().len(), 2);
    runs(&here, &format!("daylight scene.obj -o day.npz --plots day.html {SMALL}"));
    let chart = about(&here, "day.html")["charts"][0].clone();
    assert_eq!(chart["series"][0]["points"].as_array().unwrap().last().unwrap()["y"], 100.0);
}

#[test]
fn bake_writes_a_page_with_its_texels() {
    let here = here();
    runs(&here, &format!("bake scene.obj -o out --page page.html --resolution 64 --final-gather 2 {SMALL}"));
    let page = about(&here, "page.html");
    assert_eq!(
        (&page["kind"], &page["width"], &page["height"]),
        (&"lightmap".into(), &64.into(), &64.into())
    );
}

#[test]
fn a_page_takes_no_other_name_and_no_other_files_place() {
    let here = here();
    for (options, says) in [
        ("--page page.txt", "must end in .html"),
        ("--page a.html --report a.html", "same file"),
        ("--page missing/a.html", "missing"),
        ("--page a.html --page-lamps 1000", "--page-lamps"),
    ] {
        let errors = here.fails(&format!("solve scene.obj {options}"), 2);
        assert!(errors.contains(says), "{options}: {errors}");
    }
}

/// `view` hands the page to the program that BROWSER names.
#[cfg(unix)]
#[test]
fn view_opens_the_page() {
    use std::{os::unix::fs::PermissionsExt, process::Command, time::Duration};
    let here = here();
    let browser = here.path("browser");
    std::fs::write(&browser, "#!/bin/sh\ncp \"$1\" shown.html.part && mv shown.html.part shown.html\n")
        .unwrap();
    std::fs::set_permissions(&browser, std::fs::Permissions::from_mode(0o755)).unwrap();
    let run = |arguments: &str| {
        let output = Command::new(env!("CARGO_BIN_EXE_radiosity"))
            .current_dir(here.directory())
            .env("BROWSER", &browser)
            .env("TMPDIR", here.directory())
            .args(arguments.split_whitespace())
            .output()
            .unwrap();
        assert!(output.status.success(), "{}", stderr(&output));
    };
    run(&format!("view scene.obj {SMALL}"));
    // The browser runs on by itself.
    for _ in 0..1000 {
        if here.path("shown.html").exists() {
            break;
        }
        std::thread::sleep(Duration::from_millis(10));
    }
    assert_eq!(about(&here, "shown.html")["title"], "scene.obj");
    run(&format!("view scene.obj --page mine.html {SMALL}"));
    assert_eq!(about(&here, "mine.html")["title"], "scene.obj");
    // A scene that cannot be solved leaves nothing. The second browser may still be copying.
    let names = || here.names().into_iter().filter(|name| !name.starts_with("shown")).collect::<Vec<_>>();
    let before = names();
    assert!(!here.run("view missing.obj").status.success());
    assert_eq!(names(), before);
}
