//! The value of `map_Kd` and `map_Ke`: options, then a file name that may contain blanks. tobj returns it as one
//! string.

use crate::scene::text::split_keyword;

/// The parts of a texture statement that the reader uses.
#[derive(Debug, PartialEq)]
pub(super) struct MapLine {
    pub(super) file: String,
    pub(super) scale: [f64; 2],
    pub(super) offset: [f64; 2],
    pub(super) clamp: bool,
    /// Options that this reader ignores.
    pub(super) ignored: Vec<String>,
}

pub(super) fn parse(value: &str) -> MapLine {
    let mut map =
        MapLine { file: String::new(), scale: [1.0; 2], offset: [0.0; 2], clamp: false, ignored: Vec::new() };
    let mut rest = value.trim();
    loop {
        let (option, tail) = split_keyword(rest);
        match option {
            "-s" => rest = numbers(tail, &mut map.scale),
            "-o" => rest = numbers(tail, &mut map.offset),
            "-clamp" => {
                let (word, tail) = split_keyword(tail);
                map.clamp = word.eq_ignore_ascii_case("on");
                rest = tail;
            }
            "-t" => {
                map.ignored.push(option.into());
                rest = numbers(tail, &mut [0.0; 2]);
            }
            "-blendu" | "-blendv" | "-cc" | "-imfchan" | "-bm" | "-boost" | "-texres" | "-type"
            | "-colorspace" => {
                map.ignored.push(option.into());
                rest = split_keyword(tail).1;
            }
            "-mm" => {
                map.ignored.push(option.into());
                rest = split_keyword(split_keyword(tail).1).1;
            }
            _ => {
                map.file = rest.into();
                return map;
            }
        }
    }
}

/// Up to three numbers, of which the first two are used. The last word is the file, even if it is a number.
fn numbers<'a>(mut rest: &'a str, values: &mut [f64; 2]) -> &'a str {
    for i in 0..3 {
        let (word, tail) = split_keyword(rest);
        match word.parse::<f64>() {
            Ok(number) if !tail.is_empty() && number.is_finite() => {
                if let Some(value) = values.get_mut(i) {
                    *value = number;
                }
                rest = tail;
            }
            _ => break,
        }
    }
    rest
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn options_are_taken_off_the_name() {
        let map = parse("-s 2 3 4 -blendu on -o 0.5 -clamp on -mm 0 1 my -s tex 01.png");
        assert_eq!(map.file, "my -s tex 01.png");
        assert_eq!((map.scale, map.offset, map.clamp), ([2.0, 3.0], [0.5, 0.0], true));
        assert_eq!(map.ignored, ["-blendu", "-mm"]);
    }

    #[test]
    fn a_number_can_be_a_file() {
        let map = parse("-o 1 2");
        assert_eq!((map.file.as_str(), map.offset), ("2", [1.0, 0.0]));
    }
}
