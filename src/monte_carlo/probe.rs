//! Points at which the irradiance is to be computed, and their files.

use std::{io::Write, path::Path};

use glam::DVec3;

use super::Estimate;
use crate::{
    Error, Result,
    scene::{direction, text},
};

/// A point and its normal, in the coordinates of the scene file.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Probe {
    /// The point.
    pub point: DVec3,
    /// The normal, of any length above zero.
    pub normal: DVec3,
}

/// Reads a file of probes. Each line is `x y z nx ny nz`, with blanks, tabs, commas or semicolons between the numbers.
/// If semicolons or tabs separate six numbers, a comma is a decimal point, as in spreadsheets of many languages.
/// Blank lines and everything after `#` are ignored. A table may begin with one line of names without a number.
///
/// # Errors
/// [`Error::Io`] if the file cannot be read; [`Error::Input`] with the number of a line that is not understood.
pub fn read_probes(path: &Path) -> Result<Vec<Probe>> {
    let bytes = std::fs::read(path).map_err(|source| Error::io(path, source))?;
    let text = text::decode(bytes);
    let (mut probes, mut begun) = (Vec::new(), false);
    for (i, line) in text.trim_start_matches('\u{feff}').lines().enumerate() {
        // Spreadsheets write some columns in quotes.
        let content = line.split('#').next().unwrap_or_default().replace('"', "");
        if !content.trim().is_empty() {
            if !std::mem::replace(&mut begun, true) && is_header(&content) {
                continue;
            }
            let probe = parse(content.trim()).map_err(|message| {
                Error::input(path, Some(i + 1), message).with_hint("a line reads: x y z nx ny nz")
            })?;
            probes.push(probe);
        }
    }
    if probes.is_empty() {
        return Err(Error::input(path, None, "no points").with_hint("a line reads: x y z nx ny nz"));
    }
    Ok(probes)
}

/// The words of a line, separated by commas, semicolons or blanks.
fn words(line: &str) -> impl Iterator<Item = &str> {
    line.split(|c: char| c.is_whitespace() || matches!(c, ',' | ';')).filter(|word| !word.is_empty())
}

/// The words of a line with decimal commas: six numbers between semicolons or tabs. `None` for other lines.
fn with_decimal_commas(line: &str) -> Option<Vec<String>> {
    let separator = if line.contains(';') { ';' } else { '\t' };
    let words: Vec<String> = line.split(separator).map(|word| word.trim().replace(',', ".")).collect();
    let are_numbers = words.len() == 6 && words.iter().all(|word| word.parse::<f64>().is_ok());
    (line.contains(',') && are_numbers).then_some(words)
}

/// Whether a line names columns: it has at least as many words as there are columns, and none of them is a number.
fn is_header(line: &str) -> bool {
    words(line).count() >= 6 && words(line).all(|word| word.parse::<f64>().is_err())
}

fn parse(line: &str) -> std::result::Result<Probe, String> {
    let mut numbers = Vec::with_capacity(6);
    let words = with_decimal_commas(line).unwrap_or_else(|| words(line).map(str::to_owned).collect());
    for word in words {
        match word.parse::<f64>() {
            Ok(x) if x.is_finite() => numbers.push(x),
            Ok(_) => return Err(format!("{word} is not finite")),
            Err(_) => return Err(format!("{word:?} is not a number")),
        }
    }
    let [x, y, z, nx, ny, nz] = numbers[..] else {
        return Err(format!("6 numbers expected, found {}", numbers.len()));
    };
    let normal = DVec3::new(nx, ny, nz);
    if direction(normal).is_none() {
        return Err("the normal has no direction".into());
    }
    Ok(Probe { point: DVec3::new(x, y, z), normal })
}

/// Writes a line `x y z nx ny nz Er Eg Eb SEr SEg SEb` for each probe.
///
/// # Errors
/// Errors of the writer.
///
/// # Panics
/// If the numbers of probes and estimates differ.
pub fn write_probes(out: &mut impl Write, probes: &[Probe], estimates: &[Estimate]) -> std::io::Result<()> {
    assert_eq!(probes.len(), estimates.len(), "an estimate for each probe");
    for (probe, estimate) in probes.iter().zip(estimates) {
        let (p, n) = (probe.point, probe.normal);
        write!(out, "{} {} {} {} {} {}", p.x, p.y, p.z, n.x, n.y, n.z)?;
        for x in estimate.mean.iter().chain(&estimate.standard_error) {
            write!(out, " {x:.9e}")?;
        }
        writeln!(out)?;
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    fn read(text: &str) -> Result<Vec<Probe>> {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("points.txt");
        std::fs::write(&path, text).unwrap();
        read_probes(&path)
    }

    #[test]
    fn tables_with_names_commas_semicolons_and_tabs_are_points() {
        let wanted = read("1 2 3 0 0 1\n4 5 6 0 1 0").unwrap();
        for table in [
            "x,y,z,nx,ny,nz\n1,2,3,0,0,1\n4,5,6,0,1,0\n",
            "\"x\";\"y\";\"z\";\"nx\";\"ny\";\"nz\"\n1;2; 3;0;0;1\n4;5;6;0;1;0;\n",
            "x,y,z,nx,ny,nz\n\"1\",\"2\",3,0,0,1\n4,5,6,\"0\",\"1\",0\n",
            "# sensors\nx\ty\tz\tnx\tny\tnz\n1\t2\t3\t0\t0\t1\n4, 5, 6, 0, 1, 0\n",
        ] {
            assert_eq!(read(table).unwrap(), wanted, "{table}");
        }
        let halves = read("1.5 2 3 0 0 1\n-4 5.25 6 0 1 0").unwrap();
        for table in
            ["x;y;z;nx;ny;nz\n1,5;2;3;0;0;1\n-4; 5,25;6;0;1;0", "1,5\t2\t3\t0\t0\t1\n-4\t5,25\t6\t0\t1\t0"]
        {
            assert_eq!(read(table).unwrap(), halves, "{table}");
        }
        // Commas separate numbers if semicolons or tabs do not separate six of them.
        assert_eq!(read("1,2,3;0,0,1\n4,5,6;0,1,0").unwrap(), wanted);
        // Only the first line may hold names, and a broken number is not a name.
        for (wrong, line) in [("1 2 3 0 0 1\nx y z nx ny nz", 2), ("1,x,3,0,0,1", 1), ("a b c", 1)] {
            assert!(matches!(read(wrong), Err(Error::Input { line: Some(l), .. }) if l == line), "{wrong}");
        }
    }

    /// Spreadsheets call this "Unicode text".
    #[test]
    fn utf_16_is_text() {
        let table = "x\ty\tz\tnx\tny\tnz\r\n1,5\t2\t3\t0\t0\t1\r\n";
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("points.txt");
        let bytes: Vec<u8> =
            "\u{feff}".encode_utf16().chain(table.encode_utf16()).flat_map(u16::to_le_bytes).collect();
        std::fs::write(&path, bytes).unwrap();
        assert_eq!(read_probes(&path).unwrap(), read("1.5 2 3 0 0 1").unwrap());
    }

    #[test]
    fn comments_blanks_and_line_ends_do_not_matter() {
        let probes = read("\u{feff}# a desk\r\n\r\n 1 2 3\t0 0 1 # top\r\n-1e3 0.5 +4 0 -2 0").unwrap();
        assert_eq!(probes.len(), 2);
        assert_eq!(probes[0], Probe { point: DVec3::new(1., 2., 3.), normal: DVec3::Z });
        assert_eq!(probes[1], Probe { point: DVec3::new(-1e3, 0.5, 4.), normal: DVec3::new(0., -2., 0.) });
    }

    #[test]
    fn errors_name_file_and_line() {
        for (text, place, what) in [
            ("1 2 3 0 0 1\n\n1 2 3 0 0\n", "points.txt:3:", "found 5"),
            ("1 2 3 0 0 1 7\n", "points.txt:1:", "found 7"),
            ("# one\n1 2 x 0 0 1\n", "points.txt:2:", "\"x\" is not a number"),
            ("1 2 nan 0 0 1\n", "points.txt:1:", "not finite"),
            ("1 2 3 0 0 0\n", "points.txt:1:", "no direction"),
            ("# nothing\n", "points.txt:", "no points"),
        ] {
            let error = read(text).unwrap_err();
            let shown = error.to_string();
            assert!(shown.contains(place) && shown.contains(what), "{shown}");
            assert!(error.hint().is_some());
        }
        assert!(matches!(read_probes(Path::new("/none/points")), Err(Error::Io { .. })));
    }

    #[test]
    fn lines_come_out_in_the_order_of_the_contract() {
        let probe = Probe { point: DVec3::new(0.1, 2., 3.), normal: DVec3::X };
        let estimate = Estimate { mean: [1.5, 2.5, 0.0], standard_error: [0.25, 0.125, 0.0] };
        let mut out = Vec::new();
        write_probes(&mut out, &[probe], &[estimate]).unwrap();
        let line = String::from_utf8(out).unwrap();
        let numbers: Vec<f64> = line.split_whitespace().map(|w| w.parse().unwrap()).collect();
        assert_eq!(numbers, [0.1, 2., 3., 1., 0., 0., 1.5, 2.5, 0., 0.25, 0.125, 0.]);
        assert!(line.ends_with('\n'));
    }
}
