//! One HTML file that holds everything: style, script, and numbers as base64 in script elements that no browser runs.
//!
//! Text of a scene appears in two places only. In the title `&`, `<` and `>` are written as entities. Everywhere else it is a string
//! of JSON, in which `<` is written as `\u003c`. So no name can end an element or begin one.

use std::io::{self, Write};

use serde_json::Value;

const STYLE: &str = include_str!("../../../web/dist/style.css");

/// What a page shows. `web/build.sh` makes its parts from `web/src`.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Kind {
    /// A scene to walk through.
    View,
    /// Charts.
    Charts,
}

impl Kind {
    fn template(self) -> &'static str {
        match self {
            Kind::View => include_str!("../../../web/dist/view.html"),
            Kind::Charts => include_str!("../../../web/dist/chart.html"),
        }
    }

    fn script(self) -> &'static str {
        match self {
            Kind::View => include_str!("../../../web/dist/view.js"),
            Kind::Charts => include_str!("../../../web/dist/chart.js"),
        }
    }

    /// Bytes of a page without numbers.
    pub fn bytes(self) -> usize {
        self.template().len() + self.script().len() + STYLE.len()
    }
}

/// The numbers of an array.
#[derive(Debug, Clone, PartialEq)]
pub(crate) enum Values {
    U8(Vec<u8>),
    U16(Vec<u16>),
    U32(Vec<u32>),
    F32(Vec<f32>),
    /// Bits of half floats.
    F16(Vec<u16>),
}

impl Values {
    /// Whole numbers, in two bytes each if they fit.
    pub fn indices(values: Vec<u32>) -> Values {
        match values.iter().all(|&x| x <= u32::from(u16::MAX)) {
            true => Values::U16(values.into_iter().map(|x| x as u16).collect()),
            false => Values::U32(values),
        }
    }

    fn kind(&self) -> &'static str {
        match self {
            Values::U8(_) => "u8",
            Values::U16(_) => "u16",
            Values::U32(_) => "u32",
            Values::F32(_) => "f32",
            Values::F16(_) => "f16",
        }
    }

    fn write(&self, out: &mut dyn Write) -> io::Result<()> {
        match self {
            Values::U8(values) => base64(out, values, |x| [x]),
            Values::U16(values) | Values::F16(values) => base64(out, values, u16::to_le_bytes),
            Values::U32(values) => base64(out, values, u32::to_le_bytes),
            Values::F32(values) => base64(out, values, f32::to_le_bytes),
        }
    }
}

/// A named array.
pub(crate) type Array = (String, Values);

/// Writes a page with what it says about itself and its arrays.
pub(crate) fn write(
    out: &mut dyn Write,
    kind: Kind,
    title: &str,
    about: &Value,
    arrays: &[Array],
) -> io::Result<()> {
    let mut rest = kind.template();
    while let Some((before, after)) = rest.split_once("{{") {
        let (name, after) = after.split_once("}}").expect("a name in the template ends");
        out.write_all(before.as_bytes())?;
        match name {
            "title" => out.write_all(entities(title).as_bytes())?,
            "style" => out.write_all(STYLE.as_bytes())?,
            "script" => out.write_all(kind.script().as_bytes())?,
            "data" => data(out, about, arrays)?,
            other => panic!("the template has no place for {other}"),
        }
        rest = after;
    }
    out.write_all(rest.as_bytes())
}

fn data(out: &mut dyn Write, about: &Value, arrays: &[Array]) -> io::Result<()> {
    let json = about.to_string().replace('<', "\\u003c");
    writeln!(out, "<script type=\"application/json\" id=\"about\">{json}</script>")?;
    for (name, values) in arrays {
        write!(out, "<script type=\"text/plain\" id=\"data-{name}\" data-type=\"{}\">", values.kind())?;
        values.write(out)?;
        writeln!(out, "</script>")?;
    }
    Ok(())
}

fn entities(text: &str) -> String {
    text.replace('&', "&amp;").replace('<', "&lt;").replace('>', "&gt;")
}

/// Writes numbers as base64 (RFC 4648) of their little-endian bytes.
fn base64<T: Copy, const N: usize>(
    out: &mut dyn Write,
    values: &[T],
    bytes: impl Fn(T) -> [u8; N],
) -> io::Result<()> {
    // A multiple of three values has a multiple of three bytes, which need no padding.
    const BLOCK: usize = 3 << 12;
    for block in values.chunks(BLOCK) {
        let bytes: Vec<u8> = block.iter().flat_map(|&x| bytes(x)).collect();
        out.write_all(&base64_of(&bytes))?;
    }
    Ok(())
}

/// Bytes as base64.
pub(crate) fn base64_of(bytes: &[u8]) -> Vec<u8> {
    const DIGITS: &[u8; 64] = b"ABCDEFGHIJKLMNOPQRSTUVWXYZabcdefghijklmnopqrstuvwxyz0123456789+/";
    let mut text = Vec::with_capacity(bytes.len().div_ceil(3) * 4);
    for group in bytes.chunks(3) {
        let bits = (0..3).fold(0u32, |bits, k| bits << 8 | u32::from(group.get(k).copied().unwrap_or(0)));
        let digit = |k: usize| DIGITS[(bits >> (18 - 6 * k) & 63) as usize];
        text.extend((0..4).map(|k| if k <= group.len() { digit(k) } else { b'=' }));
    }
    text
}

#[cfg(test)]
mod tests {
    use super::*;
    use serde_json::json;

    #[test]
    fn base64_is_that_of_the_standard() {
        for (bytes, text) in
            [("", ""), ("f", "Zg=="), ("fo", "Zm8="), ("foo", "Zm9v"), ("foobar", "Zm9vYmFy")]
        {
            assert_eq!(base64_of(bytes.as_bytes()), text.as_bytes());
        }
        // Blocks join without padding between them.
        let many: Vec<u16> = (0..40_000).collect();
        let mut out = Vec::new();
        base64(&mut out, &many, u16::to_le_bytes).unwrap();
        let bytes: Vec<u8> = many.iter().flat_map(|x| x.to_le_bytes()).collect();
        assert_eq!(out, base64_of(&bytes));
    }

    /// Names that would end the element, or begin a comment, do neither.
    #[test]
    fn names_of_a_scene_stay_text() {
        let name = "</script><!--<script>{{script}}&";
        let about = json!({"title": name, "notes": [], "charts": []});
        let mut out = Vec::new();
        let arrays = [("a".to_owned(), Values::U8(vec![1, 2, 3]))];
        write(&mut out, Kind::Charts, name, &about, &arrays).unwrap();
        let page = String::from_utf8(out).unwrap();
        let scripts = |text: &str| (text.matches("<script").count(), text.matches("</script").count());
        assert_eq!(scripts(&page), (3, 3));
        assert!(page.contains("<title>&lt;/script&gt;&lt;!--&lt;script&gt;{{script}}&amp;</title>"));
        let json = page.split_once("id=\"about\">").unwrap().1.split_once("</script>").unwrap().0;
        assert_eq!(serde_json::from_str::<Value>(json).unwrap(), about);
        assert!(page.contains("<script type=\"text/plain\" id=\"data-a\" data-type=\"u8\">AQID</script>"));
    }

    /// The scripts themselves hold no text that would end their element, and keep the notice that the licence of three.js demands.
    #[test]
    fn the_scripts_can_be_embedded() {
        for kind in [Kind::View, Kind::Charts] {
            assert!(!kind.script().contains("</script") && !kind.script().contains("<!--"));
        }
        assert!(Kind::View.script().contains("SPDX-License-Identifier: MIT"));
    }
}
