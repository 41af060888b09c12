//! The command `exchange`: heat in a report, and exchange areas as a table.

use std::fs;

use crate::common::program::{Here, stderr};
use radiosity::{form_factor::exact::opposed_rectangles, heat::STEFAN_BOLTZMANN};

/// Two unit squares that face each other, cut into 4 × 4, a metre apart.
fn plates() -> String {
    let mut text = String::new();
    for (name, height) in [("hot", 0.0), ("cold", 1.0)] {
        text += &format!("g {name}\n");
        for (x, y) in (0..16).map(|k| (0.25 * f64::from(k % 4), 0.25 * f64::from(k / 4))) {
            let mut corners = [(x, y), (x + 0.25, y), (x + 0.25, y + 0.25), (x, y + 0.25)];
            if height > 0.0 {
                corners.reverse();
            }
            corners.iter().for_each(|(x, y)| text += &format!("v {x} {y} {height}\n"));
            text += "f -4 -3 -2 -1\n";
        }
    }
    text
}

/// Black plates under a sky exchange A F σ (T1⁴ - T2⁴) with each other and the rest with the sky. Heat balances to
/// 10⁻⁹, and a row of script-F sums to the emissivity. The view factors have an error of 10⁻⁵.
#[test]
fn black_plates_under_a_sky() {
    let here = Here::new(&plates(), "");
    fs::write(
        here.path("a.toml"),
        "hot = { temperature = 500, emissivity = 1.0 }\ncold = { temperature = 300, emissivity = 1 }\n\
         sky = { temperature = 250 }\n",
    )
    .unwrap();
    let output =
        here.run("exchange scene.obj --surfaces a.toml --report r.json --exchange-areas f.csv --quiet");
    assert_eq!(output.status.code(), Some(0), "{}", stderr(&output));
    let report = here.json("r.json");
    let heat = |k: usize| report["surfaces"][k]["heat"].as_f64().unwrap();
    let power = |t: f64| STEFAN_BOLTZMANN * t.powi(4);
    let f = opposed_rectangles(1.0, 1.0, 1.0);
    for (k, [own, other]) in [[500.0, 300.0], [300.0, 500.0]].into_iter().enumerate() {
        let right = power(own) - f * power(other) - (1.0 - f) * power(250.0);
        assert!((heat(k) / right - 1.0).abs() < 1e-4, "{k}: {} not {right}", heat(k));
        assert_eq!(report["surfaces"][k]["name"], ["hot", "cold"][k]);
    }
    let sum = heat(0) + heat(1) + report["sky"]["heat"].as_f64().unwrap();
    assert!(sum.abs() < 1e-9 * heat(0), "off balance by {sum}");
    let table = String::from_utf8(here.read("f.csv")).unwrap();
    let row: Vec<f64> =
        table.lines().nth(1).unwrap().split(',').skip(1).map(|word| word.parse().unwrap()).collect();
    assert!((row[1] / f - 1.0).abs() < 1e-4 && (row.iter().sum::<f64>() - 1.0).abs() < 1e-9, "{row:?}");
}

/// A surface without a condition, and conditions that no surface has, are errors that name the line.
#[test]
fn conditions_must_fit_the_surfaces() {
    let here = Here::new(&plates(), "");
    fs::write(
        here.path("a.toml"),
        "hot = { temperature = 500, emissivity = 1.0 }\nlid = { emissivity = 1.0 }\n",
    )
    .unwrap();
    let errors = here.fails("exchange scene.obj --surfaces a.toml --report r.json", 2);
    assert!(errors.contains("a.toml:2: `lid` is no surface"), "{errors}");
}
