//! Matrices in the formats of NumPy and SciPy.
//!
//! Arrays have `numpy.lib.format` version 1.0. A sparse matrix is a zip archive of arrays, as `scipy.sparse.save_npz`
//! writes it.

use std::io::{self, Write};

use rayon::prelude::*;

/// Number of rows that are prepared at a time.
const ROWS: usize = 256;

/// The header of an array. `kind` is the type of its items, for example `<f8`.
fn header(kind: &str, shape: &str) -> Vec<u8> {
    let mut text = format!("{{'descr': '{kind}', 'fortran_order': False, 'shape': {shape}, }}");
    // The data begin at a multiple of 64 bytes.
    let start = b"\x93NUMPY\x01\x00".len() + 2;
    let length = (start + text.len() + 1).next_multiple_of(64) - start;
    text.extend(std::iter::repeat_n(' ', length - text.len() - 1));
    text.push('\n');
    let mut bytes = b"\x93NUMPY\x01\x00".to_vec();
    bytes.extend((length as u16).to_le_bytes());
    bytes.extend(text.as_bytes());
    bytes
}

/// Writes a square matrix with all its entries as an array of double precision.
///
/// # Errors
/// Errors of writing to `out`.
pub(super) fn write_dense(
    n: usize,
    row: impl Fn(usize) -> Vec<f64> + Sync,
    out: &mut dyn Write,
) -> io::Result<()> {
    out.write_all(&header("<f8", &format!("({n}, {n})")))?;
    for start in (0..n).step_by(ROWS) {
        let bytes = |i: usize| row(i).iter().flat_map(|x| x.to_le_bytes()).collect::<Vec<u8>>();
        let rows: Vec<Vec<u8>> = (start..n.min(start + ROWS)).into_par_iter().map(bytes).collect();
        rows.iter().try_for_each(|row| out.write_all(row))?;
    }
    Ok(())
}

/// Writes the non-zero entries of a square matrix in compressed rows, for `scipy.sparse.load_npz`.
///
/// # Errors
/// Errors of writing to `out`, and an error if the file would be larger than 4 GiB.
pub(super) fn write_sparse<R: Iterator<Item = (usize, f64)>>(
    n: usize,
    row: impl Fn(usize) -> R,
    out: &mut dyn Write,
) -> io::Result<()> {
    let mut starts = vec![0u64];
    let (mut columns, mut values): (Vec<u8>, Vec<u8>) = Default::default();
    for i in 0..n {
        for (j, x) in row(i) {
            columns.extend((j as i32).to_le_bytes());
            values.extend(x.to_le_bytes());
        }
        starts.push((values.len() / 8) as u64);
    }
    let count = values.len() / 8;
    let array = |kind: &str, shape: String, data: &[u8]| {
        let mut bytes = header(kind, &shape);
        bytes.extend(data);
        bytes
    };
    let mut zip = Zip { out, files: Vec::new(), at: 0 };
    zip.add("indices.npy", &array("<i4", format!("({count},)"), &columns))?;
    drop(columns);
    // SciPy wants starts and indices to have the same width, so starts have 32 bits if possible.
    let starts: Vec<u8> = match i32::try_from(count) {
        Ok(_) => starts.iter().flat_map(|&k| (k as i32).to_le_bytes()).collect(),
        Err(_) => starts.iter().flat_map(|&k| (k as i64).to_le_bytes()).collect(),
    };
    let kind = if starts.len() == 4 * (n + 1) { "<i4" } else { "<i8" };
    zip.add("indptr.npy", &array(kind, format!("({},)", n + 1), &starts))?;
    zip.add("format.npy", &array("|S3", "()".into(), b"csr"))?;
    zip.add("shape.npy", &array("<i8", "(2,)".into(), &[n as i64, n as i64].map(i64::to_le_bytes).concat()))?;
    zip.add("data.npy", &array("<f8", format!("({count},)"), &values))?;
    zip.finish()
}

/// An array of an `.npz` file.
pub(super) struct Array<'a> {
    pub(super) name: &'a str,
    pub(super) shape: Vec<usize>,
    pub(super) values: Values<'a>,
}

/// The values of an array; the last index changes fastest.
pub(super) enum Values<'a> {
    F32(&'a [f32]),
    F64(&'a [f64]),
    I32(&'a [i32]),
}

/// Writes named arrays as an `.npz` file for `numpy.load`.
///
/// # Errors
/// Errors of `out`, and an error if the file would be larger than 4 GiB.
///
/// # Panics
/// If the values of an array do not match its shape.
pub(super) fn write_arrays(arrays: &[Array<'_>], out: &mut dyn Write) -> io::Result<()> {
    let mut zip = Zip { out, files: Vec::new(), at: 0 };
    for Array { name, shape, values } in arrays {
        let (kind, length, data): (_, _, Vec<u8>) = match values {
            Values::F32(v) => ("<f4", v.len(), v.iter().flat_map(|x| x.to_le_bytes()).collect()),
            Values::F64(v) => ("<f8", v.len(), v.iter().flat_map(|x| x.to_le_bytes()).collect()),
            Values::I32(v) => ("<i4", v.len(), v.iter().flat_map(|x| x.to_le_bytes()).collect()),
        };
        assert_eq!(length, shape.iter().product::<usize>(), "{name}: values and shape disagree");
        let sizes: String = shape.iter().map(|n| format!("{n},")).collect();
        let mut bytes = header(kind, &format!("({sizes})"));
        bytes.extend(data);
        zip.add(&format!("{name}.npy"), &bytes)?;
    }
    zip.finish()
}

/// A zip archive without compression (PKWARE, *APPNOTE.TXT* 6.3, sections 4.3.7, 4.3.12 and 4.3.16).
struct Zip<'a> {
    out: &'a mut dyn Write,
    /// The entries of the central directory.
    files: Vec<Vec<u8>>,
    at: u64,
}

impl Zip<'_> {
    fn add(&mut self, name: &str, data: &[u8]) -> io::Result<()> {
        let [Ok(size), Ok(at)] = [data.len() as u64, self.at].map(u32::try_from) else {
            return Err(io::Error::other("a .npz of more than 4 GiB; write .mtx instead"));
        };
        // Version 2.0, no flags, stored, at midnight on 1 January 1980.
        let mut about: Vec<u8> = [20u16, 0, 0, 0, 0x21].iter().flat_map(|x| x.to_le_bytes()).collect();
        about.extend([crc32fast::hash(data), size, size].iter().flat_map(|x| x.to_le_bytes()));
        about.extend([name.len() as u16, 0].iter().flat_map(|x| x.to_le_bytes()));
        let mut local = b"PK\x03\x04".to_vec();
        local.extend(&about);
        local.extend(name.as_bytes());
        self.out.write_all(&local)?;
        self.out.write_all(data)?;
        self.at += (local.len() + data.len()) as u64;
        let mut central = b"PK\x01\x02\x14\x00".to_vec();
        central.extend(&about);
        // No comment, disk 0, no attributes.
        central.extend([0; 10]);
        central.extend(at.to_le_bytes());
        central.extend(name.as_bytes());
        self.files.push(central);
        Ok(())
    }

    fn finish(self) -> io::Result<()> {
        let size: usize = self.files.iter().map(Vec::len).sum();
        let Ok(at) = u32::try_from(self.at) else {
            return Err(io::Error::other("a .npz of more than 4 GiB; write .mtx instead"));
        };
        self.files.iter().try_for_each(|file| self.out.write_all(file))?;
        let mut end = b"PK\x05\x06\x00\x00\x00\x00".to_vec();
        end.extend([self.files.len() as u16; 2].iter().flat_map(|x| x.to_le_bytes()));
        end.extend([size as u32, at].iter().flat_map(|x| x.to_le_bytes()));
        end.extend([0, 0]);
        self.out.write_all(&end)
    }
}
