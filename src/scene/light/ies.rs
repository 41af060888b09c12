//! IES files: ANSI/IES LM-63 of 1986, 1991, 1995, 2002 and 2019.
//!
//! After lines of text comes `TILT=`. Then come numbers, and lines may end anywhere between them: the number of lamps,
//! lumens per lamp, the multiplier, the counts of vertical and horizontal angles, type, unit, width, length and height
//! of the opening, the ballast factor, one more factor, and watts. All angles follow, and then the intensities plane by
//! plane.

use super::measured::{Goniometer, MOST_DIRECTIONS, Measured, Opening, Wrong, reach_all_round};

/// Metres per foot.
const FOOT: f64 = 0.3048;

/// The numbers of a text, with their lines.
struct Numbers<'a> {
    words: std::vec::IntoIter<(usize, &'a str)>,
    line: usize,
}

impl<'a> Numbers<'a> {
    fn next(&mut self, what: &str) -> Result<f64, Wrong> {
        let (line, word) = self
            .words
            .next()
            .ok_or_else(|| Wrong::at(self.line, format!("the file ends where {what} should be")))?;
        self.line = line;
        let number = word.parse::<f64>().ok().filter(|x| x.is_finite() && x.abs() < 1e30);
        number.ok_or_else(|| Wrong::at(line, format!("`{word}` is not a number: {what} should be here")))
    }

    fn count(&mut self, what: &str) -> Result<usize, Wrong> {
        let number = self.next(what)?;
        if !(1.0..=MOST_DIRECTIONS as f64).contains(&number) || number.fract() != 0.0 {
            return Err(Wrong::at(self.line, format!("{number} cannot be {what}")));
        }
        Ok(number as usize)
    }

    fn angles(&mut self, many: usize, what: &str) -> Result<Vec<f64>, Wrong> {
        let mut angles: Vec<f64> = Vec::new();
        for _ in 0..many {
            let angle = self.next(what)?;
            if angles.last().is_some_and(|&last| angle <= last) || !(-180.0..=360.0).contains(&angle) {
                return Err(Wrong::at(self.line, format!("{angle} is out of order among {what}s")));
            }
            angles.push(angle);
        }
        Ok(angles)
    }
}

/// Reads the text of a file.
pub(super) fn parse(text: &str) -> Result<Measured, Wrong> {
    let lines: Vec<&str> = text.trim_start_matches('\u{feff}').lines().collect();
    let header = lines.first().map_or("", |line| line.trim());
    // Since 2002, the second factor is reserved.
    let has_second = !(header.contains("LM-63-2002") || header.contains("LM-63-2019"));
    let Some(tilt) = lines.iter().position(|line| line.trim_start().to_uppercase().starts_with("TILT="))
    else {
        return Err(Wrong::at(
            lines.len(),
            "the file ends, and no line began with TILT=: is it an IES file?",
        ));
    };
    let words: Vec<(usize, &str)> = (tilt + 1..lines.len())
        .flat_map(|k| {
            let words = lines[k].split(|c: char| c.is_whitespace() || c == ',' || c == ';');
            words.filter(|word| !word.is_empty()).map(move |word| (k + 1, word))
        })
        .collect();
    let mut numbers = Numbers { words: words.into_iter(), line: tilt + 1 };
    let mut warnings = Vec::new();
    let of_tilt = lines[tilt].trim_start()[5..].trim();
    match of_tilt.to_uppercase().as_str() {
        "NONE" => {}
        "INCLUDE" => {
            numbers.next("the geometry of the lamp")?;
            let pairs = numbers.count("the number of tilt angles")?;
            for _ in 0..2 * pairs {
                numbers.next("a tilt angle or its factor")?;
            }
            warnings
                .push("the tilt factors are left out: the luminaire has the tilt of the measurement".into());
        }
        _ => warnings.push(format!(
            "the tilt file `{of_tilt}` is not read: the luminaire has the tilt of the measurement"
        )),
    }
    let lamps = numbers.next("the number of lamps")?;
    let lumens = numbers.next("the lumens of a lamp")?;
    let multiplier = numbers.next("the multiplier")?;
    let rows = numbers.count("the number of vertical angles")?;
    let columns = numbers.count("the number of horizontal angles")?;
    let goniometer = match numbers.next("the photometric type")? {
        1.0 => Goniometer::C,
        2.0 => Goniometer::B,
        3.0 => Goniometer::A,
        other => {
            return Err(Wrong::at(
                numbers.line,
                format!("the photometric type must be 1, 2 or 3, not {other}"),
            ));
        }
    };
    let unit = match numbers.next("the type of unit")? {
        1.0 => FOOT,
        2.0 => 1.0,
        other => {
            return Err(Wrong::at(numbers.line, format!("the type of unit must be 1 or 2, not {other}")));
        }
    };
    let [width, length, _height] =
        [numbers.next("the width")?, numbers.next("the length")?, numbers.next("the height")?];
    let ballast = numbers.next("the ballast factor")?;
    let second = numbers.next("the second factor")?;
    numbers.next("the input watts")?;
    let factors = multiplier * ballast * if has_second && second > 0.0 { second } else { 1.0 };
    if !(factors > 0.0) {
        return Err(Wrong::at(numbers.line, "multiplier and ballast factor must be above 0"));
    }
    if rows.saturating_mul(columns) > MOST_DIRECTIONS {
        return Err(Wrong::at(numbers.line, format!("{rows} times {columns} directions are too many")));
    }
    let vertical = numbers.angles(rows, "a vertical angle")?;
    let first_of_vertical = numbers.line;
    let horizontal = numbers.angles(columns, "a horizontal angle")?;
    check_angles(goniometer, &vertical, &horizontal).map_err(|message| {
        Wrong::at(if message.starts_with("vertical") { first_of_vertical } else { numbers.line }, message)
    })?;
    let mut candela = Vec::new();
    for _ in 0..rows * columns {
        let intensity = numbers.next("an intensity")?;
        if intensity < 0.0 {
            return Err(Wrong::at(numbers.line, format!("an intensity is negative: {intensity}")));
        }
        candela.push(intensity * factors);
    }
    if numbers.words.next().is_some() {
        warnings.push("numbers after the intensities are left out".into());
    }
    Ok(Measured {
        goniometer,
        horizontal,
        vertical,
        candela,
        stated_flux: (lumens > 0.0 && lamps > 0.0).then_some(lamps * lumens * ballast),
        opening: opening(width * unit, length * unit),
        warnings,
    })
}

/// Checks that the angles are in the range of their photometric type.
fn check_angles(goniometer: Goniometer, vertical: &[f64], horizontal: &[f64]) -> Result<(), String> {
    let ends = |angles: &[f64]| (angles[0], angles[angles.len() - 1]);
    let ((low, high), (first, last)) = (ends(vertical), ends(horizontal));
    match goniometer {
        Goniometer::C => {
            if !(0.0..=180.0).contains(&low) || high > 180.0 {
                return Err("vertical angles of type C must be between 0 and 180".into());
            }
            let symmetric = [(0.0, 0.0), (0.0, 90.0), (0.0, 180.0), (90.0, 270.0)].contains(&(first, last));
            let all_round = first == 0.0 && reach_all_round(horizontal);
            if !(symmetric || all_round) {
                return Err(format!(
                    "horizontal angles of type C must run from 0 to 0, 90, 180 or 360, or from 90 to 270, not from {first} to {last}"
                ));
            }
        }
        Goniometer::B | Goniometer::A => {
            if low < -90.0 || high > 90.0 || (low > 0.0) {
                return Err(
                    "vertical angles of types A and B must begin at 0 or below it, and be between -90 and 90"
                        .into(),
                );
            }
            if first < -180.0 || last > 180.0 || first > 0.0 {
                return Err("horizontal angles of types A and B must begin at 0 or below it, and be between -180 and 180".into());
            }
        }
    }
    Ok(())
}

/// The luminous opening. Negative sizes mean that it is round.
fn opening(width: f64, length: f64) -> Option<Opening> {
    let round = width < 0.0 || length < 0.0;
    let (width, length) = (width.abs(), length.abs());
    let (width, length) = match round {
        true => (if width > 0.0 { width } else { length }, if length > 0.0 { length } else { width }),
        false => (width, length),
    };
    (width > 0.0 && length > 0.0).then_some(Opening { length, width, round })
}

#[cfg(test)]
mod tests {
    use super::super::photometry::Photometry;
    use super::*;
    use glam::DVec3;

    const FILE: &str = "IESNA:LM-63-1995\n[TEST] made\nTILT=NONE\n1 1000 2 3 1\n1 2 0.1 0.2 0\n0.9 0.5 40\n0 45 90\n0\n100 70.71 0\n";

    fn read(text: &str) -> Photometry {
        Photometry::new(parse(text).unwrap_or_else(|wrong| panic!("{wrong:?}")))
    }

    /// Multiplier, ballast factor and, before 2002, the second factor all count.
    #[test]
    fn factors_multiply_the_intensity() {
        let down = -DVec3::Z;
        assert!((read(FILE).intensity(down) - 100.0 * 2.0 * 0.9 * 0.5).abs() < 1e-9);
        let later = FILE.replace("IESNA:LM-63-1995", "IES:LM-63-2019");
        assert!((read(&later).intensity(down) - 100.0 * 2.0 * 0.9).abs() < 1e-9);
        let oldest = FILE.replace("IESNA:LM-63-1995\n", "");
        assert!((read(&oldest).intensity(down) - 90.0).abs() < 1e-9);
        assert_eq!(read(FILE).stated_flux, Some(900.0));
        assert_eq!(read(&FILE.replace("1 1000", "1 -1")).stated_flux, None);
    }

    /// Lines may end anywhere, commas separate too, and tilt factors come first.
    #[test]
    fn numbers_wrap_freely() {
        let wrapped = FILE
            .replace("1 1000 2 3 1\n1 2 0.1", "1,1000,\n2\n3 1 1 2\n0.1")
            .replace("100 70.71 0", "100\n\n70.71,0");
        assert_eq!(read(&wrapped), read(FILE));
        let tilted = FILE.replace("TILT=NONE", "TILT=INCLUDE\n1\n2\n0 90\n1 0.9");
        assert_eq!(read(&tilted).intensity(-DVec3::Z), read(FILE).intensity(-DVec3::Z));
        assert_eq!(read(&tilted).warnings.len(), 1);
        assert!(read(&FILE.replace("TILT=NONE", "tilt=lamp.tlt")).warnings[0].contains("lamp.tlt"));
    }

    /// A foot has 0.3048 metres, and negative sizes mean a round opening.
    #[test]
    fn openings() {
        let of = |sizes: &str| read(&FILE.replace("1 2 0.1 0.2 0", sizes)).opening;
        assert_eq!(of("1 2 0.1 0.2 0"), Some(Opening { length: 0.2, width: 0.1, round: false }));
        assert_eq!(of("1 1 1 2 0"), Some(Opening { length: 0.6096, width: 0.3048, round: false }));
        assert_eq!(of("1 2 -0.2 0 0"), Some(Opening { length: 0.2, width: 0.2, round: true }));
        assert_eq!(of("1 2 0 0 0"), None);
    }

    /// A luminaire of type B aims down. Its vertical angles turn towards C0, its horizontal angles away from C90.
    #[test]
    fn floodlights_of_type_b() {
        let text = "IESNA91\nTILT=NONE\n1 -1 1 3 3 2 2 0 0 0 1 1 1\n-90 0 90\n-90 0 90\n0 10 20  30 40 50  60 70 80\n";
        let light = read(text);
        assert_eq!(light.intensity(-DVec3::Z), 40.0);
        let near = |direction: DVec3, wanted: f64| {
            let found = light.intensity(direction);
            assert!((found - wanted).abs() < 1e-6, "{direction}: {found} for {wanted}");
        };
        near(DVec3::X, 50.0);
        near(-DVec3::X, 30.0);
        near(-DVec3::Y, 70.0);
        near(DVec3::Y, 10.0);
    }

    /// Each wrong file is refused with the line of the error.
    #[test]
    fn wrong_files_name_the_line() {
        let wrong = |from: &str, to: &str, line: usize| {
            let Err(wrong) = parse(&FILE.replace(from, to)) else { panic!("{from} -> {to} was read") };
            assert_eq!(wrong.line, line, "{}", wrong.message);
        };
        wrong("1 1000 2", "1 abc 2", 4);
        wrong("2 3 1\n", "2 0 1\n", 4);
        wrong("2 3 1\n", "2 3.5 1\n", 4);
        wrong("2 3 1\n", "2 1e9 1\n", 4);
        wrong("2 3 1\n", "2 99999 99999\n", 6);
        wrong("1 2 0.1", "4 2 0.1", 5);
        wrong("1 2 0.1", "1 3 0.1", 5);
        wrong("0.9 0.5 40", "0 0.5 40", 6);
        wrong("0 45 90", "0 45 45", 7);
        wrong("0 45 90", "0 45 190", 7);
        wrong("100 70.71 0", "100 70.71", 9);
        wrong("100 70.71 0", "100 -1 0", 9);
        wrong("100 70.71 0", "100 nan 0", 9);
        wrong("\n0\n100", "\n30\n100", 8);
        // Planes from 0 to 200 degrees are neither a half nor the whole.
        wrong(
            " 3 1\n1 2 0.1 0.2 0\n0.9 0.5 40\n0 45 90\n0\n",
            " 2 3\n1 2 0 0 0\n1 1 40\n0 90\n0 100 200\n1 1 1 1\n",
            8,
        );
        for (text, line) in [("", 1), ("IESNA91\n", 1), ("IESNA91\n[TEST] a\n", 2), ("TILT=NONE", 1)] {
            assert_eq!(parse(text).err().map(|wrong| wrong.line), Some(line), "{text}");
        }
    }

    /// Where a file has no angles, its intensity is 0, and a warning says so.
    #[test]
    fn missing_angles_are_warned_of() {
        let warned = |text: &str| read(text).warnings;
        assert!(warned(FILE).is_empty());
        assert_eq!(warned(&FILE.replace("0 45 90", "0 45 80")).len(), 1);
        let beam = "IESNA91\nTILT=NONE\n1 -1 1 3 3 2 2 0 0 0 1 1 1\n-45 0 45\n-90 0 90\n0 10 20  30 40 50  60 70 80\n";
        assert!(warned(beam)[0].starts_with("the vertical angles run from -45 to 45"), "{:?}", warned(beam));
        assert!(warned(&beam.replace("-45 0 45", "-90 0 90")).is_empty());
        // Planes every 120 degrees reach all round without the plane at 360.
        let three = "IESNA91\nTILT=NONE\n1 -1 1 2 3 1 2 0 0 0 1 1 1\n0 90\n0 120 240\n6 3 6 3 6 3\n";
        assert!(warned(three).is_empty());
    }
}
