//! EULUMDAT files (.ldt): one value a line, in a fixed order (Stockmar, "EULUMDAT - a format for the exchange of
//! photometric data", 1990).

use super::measured::{Goniometer, MOST_DIRECTIONS, Measured, Opening, Wrong, reach_all_round};

/// Number of lines for each set of lamps.
const LINES_OF_SET: usize = 6;
/// Number of direct ratios between the sets of lamps and the angles.
const RATIOS: usize = 10;

struct Lines<'a> {
    lines: Vec<&'a str>,
    at: usize,
}

impl<'a> Lines<'a> {
    fn text(&mut self, what: &str) -> Result<&'a str, Wrong> {
        self.at += 1;
        let line = self.lines.get(self.at - 1);
        line.map(|line| line.trim())
            .ok_or_else(|| Wrong::at(self.lines.len(), format!("the file ends where {what} should be")))
    }

    fn number(&mut self, what: &str) -> Result<f64, Wrong> {
        let text = self.text(what)?;
        // Some programs write decimal commas.
        let number = text.replace(',', ".").parse::<f64>().ok().filter(|x| x.is_finite() && x.abs() < 1e30);
        number.ok_or_else(|| {
            Wrong::at(self.at, format!("`{}` is not a number: {what} should be here", shortened(text)))
        })
    }

    fn count(&mut self, what: &str, most: usize) -> Result<usize, Wrong> {
        let number = self.number(what)?;
        if !(0.0..=most as f64).contains(&number) || number.fract() != 0.0 {
            return Err(Wrong::at(self.at, format!("{number} cannot be {what}")));
        }
        Ok(number as usize)
    }

    fn skip(&mut self, many: usize, what: &str) -> Result<(), Wrong> {
        (0..many).try_for_each(|_| self.text(what).map(|_| ()))
    }

    fn angles(&mut self, many: usize, most: f64, what: &str) -> Result<Vec<f64>, Wrong> {
        let mut angles: Vec<f64> = Vec::new();
        for _ in 0..many {
            let angle = self.number(what)?;
            if angles.last().is_some_and(|&last| angle <= last) || !(0.0..=most).contains(&angle) {
                return Err(Wrong::at(self.at, format!("{angle} is out of order among {what}s")));
            }
            angles.push(angle);
        }
        Ok(angles)
    }
}

fn shortened(text: &str) -> String {
    text.chars().take(40).collect()
}

/// Reads the text of a file.
pub(super) fn parse(text: &str) -> Result<Measured, Wrong> {
    let mut lines = Lines { lines: text.trim_start_matches('\u{feff}').lines().collect(), at: 0 };
    lines.text("the name of the company")?;
    lines.count("the type of the light source", 9)?;
    let symmetry = lines.count("the symmetry, 0 to 4,", 4)?;
    let planes = lines.count("the number of C planes", MOST_DIRECTIONS)?;
    let first_count = lines.at;
    lines.number("the distance of C planes")?;
    let rows = lines.count("the number of intensities a plane", MOST_DIRECTIONS)?;
    lines.number("the distance of intensities")?;
    if planes == 0 || rows == 0 || planes.saturating_mul(rows) > MOST_DIRECTIONS {
        return Err(Wrong::at(first_count, format!("{planes} planes with {rows} intensities each")));
    }
    // Numbers and names of the report, the luminaire and the file, the date, and sizes of the luminaire are skipped.
    lines.skip(5, "a name")?;
    lines.skip(3, "a size of the luminaire")?;
    let (length, width) = (lines.number("the length of the luminous area")?, lines.number("its width")?);
    lines.skip(4, "a height of the luminous area")?;
    lines.skip(2, "the downward flux or the light output ratio")?;
    let factor = lines.number("the conversion factor of intensities")?;
    lines.skip(1, "the tilt")?;
    let sets = lines.count("the number of sets of lamps", 20)?;
    let mut flux = 0.0;
    let mut absolute = false;
    for _ in 0..sets {
        absolute |= lines.number("the number of lamps")? < 0.0;
        lines.skip(1, "the type of lamps")?;
        // This is the flux of the whole set, whatever its number of lamps.
        flux += lines.number("the flux of lamps")?.abs();
        lines.skip(LINES_OF_SET - 3, "a figure of lamps")?;
    }
    if !(flux > 0.0 && factor > 0.0) {
        return Err(Wrong::at(lines.at, "the flux of lamps and the conversion factor must be above 0"));
    }
    lines.skip(RATIOS, "a direct ratio")?;
    let angles = lines.angles(planes, 360.0, "a C angle")?;
    let vertical = lines.angles(rows, 180.0, "a vertical angle")?;
    let horizontal = measured_planes(symmetry, &angles).map_err(|message| Wrong::at(first_count, message))?;
    let mut candela = Vec::new();
    for _ in 0..horizontal.len() * rows {
        let intensity = lines.number("an intensity")?;
        if intensity < 0.0 {
            return Err(Wrong::at(lines.at, format!("an intensity is negative: {intensity}")));
        }
        // Intensities are given per 1000 lm of the lamps.
        candela.push(intensity * factor * flux / 1000.0);
    }
    let mut warnings = Vec::new();
    if absolute {
        warnings.push("photometry is absolute: the flux of the lamps is the flux of the luminaire".into());
    }
    let millimetres = 1e-3;
    let round = width == 0.0;
    let width = if round { length } else { width };
    Ok(Measured {
        goniometer: Goniometer::C,
        horizontal,
        vertical,
        candela,
        // The flux of the lamps is not the flux of the luminaire.
        stated_flux: None,
        opening: (length > 0.0 && width > 0.0).then_some(Opening {
            length: length * millimetres,
            width: width * millimetres,
            round,
        }),
        warnings,
    })
}

/// The planes with intensities in the file. With symmetry, these are not all planes.
fn measured_planes(symmetry: usize, angles: &[f64]) -> Result<Vec<f64>, String> {
    let upto = |last: f64| -> Vec<f64> { angles.iter().copied().filter(|&c| c <= last).collect() };
    let ends_at = |planes: Vec<f64>, last: f64| match planes.last() {
        Some(&end) if end == last && planes[0] == 0.0 => Ok(planes),
        _ => Err(format!("a luminaire of this symmetry must have C planes from 0 to {last}")),
    };
    match symmetry {
        0 if angles[0] == 0.0 && (angles.len() == 1 || reach_all_round(angles)) => Ok(angles.to_vec()),
        0 => Err("the C planes of a luminaire without symmetry must begin at 0 and reach all round".into()),
        1 => Ok(vec![0.0]),
        2 => ends_at(upto(180.0), 180.0),
        3 => {
            // From 270 over 0 to 90.
            let mut planes: Vec<f64> = angles.iter().filter(|&&c| c >= 270.0).map(|c| c - 360.0).collect();
            planes.retain(|&c| c < 0.0);
            planes.extend(upto(90.0));
            match (planes.first(), planes.last()) {
                (Some(&-90.0), Some(&90.0)) => Ok(planes),
                _ => Err("a luminaire of this symmetry must have C planes at 270 and 90".into()),
            }
        }
        _ => ends_at(upto(90.0), 90.0),
    }
}

#[cfg(test)]
mod tests {
    use super::super::photometry::Photometry;
    use super::*;
    use glam::DVec3;

    /// A file of this symmetry with planes every 90 degrees and intensities at 0, 90 and 180 degrees.
    fn file(symmetry: u32, sets: &[(&str, &str)], intensities: &str) -> String {
        let mut text = format!("maker\n1\n{symmetry}\n4\n90\n3\n90\nreport\nname\nnumber\nfile\ndate\n");
        text += "600\n600\n50\n500\n0\n0\n0\n0\n0\n100\n80\n1.0\n0\n";
        text += &format!("{}\n", sets.len());
        for (lamps, flux) in sets {
            text += &format!("{lamps}\nLED\n{flux}\n3000\n80\n20\n");
        }
        text += &"0.5\n".repeat(10);
        text + "0\n90\n180\n270\n0\n90\n180\n" + intensities
    }

    fn read(text: &str) -> Photometry {
        Photometry::new(parse(text).unwrap_or_else(|wrong| panic!("{wrong:?}")))
    }

    /// The flux belongs to the set, not to each of its lamps. Sets add up. Intensities are per 1000 lm.
    #[test]
    fn flux_is_that_of_the_sets() {
        let one = "200\n100\n0\n";
        assert_eq!(read(&file(1, &[("2", "3000")], one)).intensity(-DVec3::Z), 600.0);
        assert_eq!(read(&file(1, &[("2", "3000"), ("1", "500")], one)).intensity(-DVec3::Z), 700.0);
        let round = Some(Opening { length: 0.5, width: 0.5, round: true });
        assert_eq!(read(&file(1, &[("2", "3000")], one)).opening, round);
    }

    /// The intensity sideways in C0, C90, C180 and C270, from the planes that each symmetry lists.
    #[test]
    fn symmetries() {
        let sides = [DVec3::X, DVec3::Y, -DVec3::X, -DVec3::Y];
        let plane = |sideways: u32| format!("100\n{sideways}\n0\n");
        for (symmetry, planes, wanted) in [
            (0, vec![1, 2, 3, 4], [1.0, 2.0, 3.0, 4.0]),
            (1, vec![5], [5.0; 4]),
            (2, vec![1, 2, 3], [1.0, 2.0, 3.0, 2.0]),
            (3, vec![4, 1, 2], [1.0, 2.0, 1.0, 4.0]),
            (4, vec![1, 2], [1.0, 2.0, 1.0, 2.0]),
        ] {
            let intensities: String = planes.into_iter().map(plane).collect();
            let light = read(&file(symmetry, &[("1", "1000")], &intensities));
            for (side, wanted) in sides.into_iter().zip(wanted) {
                let found = light.intensity(side);
                assert!((found - wanted).abs() < 1e-9, "{symmetry} {side}: {found} for {wanted}");
            }
        }
    }

    #[test]
    fn wrong_files_name_the_line() {
        let good = file(1, &[("1", "1000")], "200\n100\n0\n");
        let wrong = |from: &str, to: &str, line: usize| {
            let Err(wrong) = parse(&good.replacen(from, to, 1)) else { panic!("{from} -> {to} was read") };
            assert_eq!(wrong.line, line, "{}", wrong.message);
        };
        wrong("1\n1\n4\n", "1\n7\n4\n", 3);
        wrong("1\n1\n4\n", "1\n1\nmany\n", 4);
        wrong("1\n1\n4\n", "1\n1\n0\n", 4);
        wrong("\n1000\n", "\n0\n", 32);
        wrong("\n0\n90\n180\n270\n", "\n0\n90\n80\n270\n", 45);
        wrong("200\n100\n0\n", "200\n-1\n0\n", 51);
        wrong("200\n100\n0\n", "200\n100\n", 51);
        wrong("200\n100\n0\n", "200\nx\n0\n", 51);
        let whole = file(0, &[("1", "1000")], &"200\n100\n0\n".repeat(4));
        assert_eq!(
            parse(&whole.replace("\n180\n270\n", "\n100\n110\n")).err().map(|wrong| wrong.line),
            Some(4)
        );
        assert_eq!(parse("").err().map(|wrong| wrong.line), Some(1));
    }
}
