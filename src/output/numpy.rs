//! Matrices in the formats of NumPy and SciPy.
//!
//! Arrays have `numpy.lib.format` version 1.0. A sparse matrix is a zip archive of arrays, as `scipy.sparse.save_npz`
//! writes it.

use std::io::{self, Write};

use rayon::prelude::*;
use zip::{
    CompressionMethod, DateTime, ZipWriter,
    write::{SimpleFileOptions, StreamWriter},
};

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
/// Errors of writing to `out`.
pub(super) fn write_sparse<R: Iterator<Item = (usize, f64)>>(
    n: usize,
    row: impl Fn(usize) -> R + Sync,
    out: &mut dyn Write,
) -> io::Result<()> {
    let counts: Vec<usize> = (0..n).into_par_iter().map(|i| row(i).count()).collect();
    let mut starts = vec![0];
    starts.extend(counts.iter().scan(0, |sum, count| {
        *sum += count;
        Some(*sum)
    }));
    let count = starts[n];
    let mut zip = Archive::new(out);
    // Row by row, because a copy of all entries would take as much memory as the matrix itself.
    zip.begin("indices.npy", "<i4", &format!("({count},)"), 4 * count)?;
    for i in 0..n {
        zip.write(&row(i).flat_map(|(j, _)| (j as i32).to_le_bytes()).collect::<Vec<u8>>())?;
    }
    // SciPy wants starts and indices to have the same width, so starts have 32 bits if possible.
    let (kind, starts): (_, Vec<u8>) = match i32::try_from(count) {
        Ok(_) => ("<i4", starts.iter().flat_map(|&k| (k as i32).to_le_bytes()).collect()),
        Err(_) => ("<i8", starts.iter().flat_map(|&k| (k as i64).to_le_bytes()).collect()),
    };
    zip.add("indptr.npy", kind, &format!("({},)", n + 1), &starts)?;
    zip.add("format.npy", "|S3", "()", b"csr")?;
    zip.add("shape.npy", "<i8", "(2,)", &[n as i64, n as i64].map(i64::to_le_bytes).concat())?;
    zip.begin("data.npy", "<f8", &format!("({count},)"), 8 * count)?;
    for i in 0..n {
        zip.write(&row(i).flat_map(|(_, x)| x.to_le_bytes()).collect::<Vec<u8>>())?;
    }
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
/// Errors of writing to `out`.
///
/// # Panics
/// If the values of an array do not match its shape.
pub(super) fn write_arrays(arrays: &[Array<'_>], out: &mut dyn Write) -> io::Result<()> {
    let mut zip = Archive::new(out);
    for Array { name, shape, values } in arrays {
        let (kind, length, data): (_, _, Vec<u8>) = match values {
            Values::F32(v) => ("<f4", v.len(), v.iter().flat_map(|x| x.to_le_bytes()).collect()),
            Values::F64(v) => ("<f8", v.len(), v.iter().flat_map(|x| x.to_le_bytes()).collect()),
            Values::I32(v) => ("<i4", v.len(), v.iter().flat_map(|x| x.to_le_bytes()).collect()),
        };
        assert_eq!(length, shape.iter().product::<usize>(), "{name}: values and shape disagree");
        let sizes: String = shape.iter().map(|n| format!("{n},")).collect();
        zip.add(&format!("{name}.npy"), kind, &format!("({sizes})"), &data)?;
    }
    zip.finish()
}

/// A zip archive without compression, as `numpy.savez` writes it.
struct Archive<'a>(ZipWriter<StreamWriter<&'a mut dyn Write>>);

impl<'a> Archive<'a> {
    fn new(out: &'a mut dyn Write) -> Self {
        Archive(ZipWriter::new_stream(out))
    }

    fn add(&mut self, name: &str, kind: &str, shape: &str, data: &[u8]) -> io::Result<()> {
        self.begin(name, kind, shape, data.len())?;
        self.write(data)
    }

    /// Begins an array, whose data of this many bytes follow.
    fn begin(&mut self, name: &str, kind: &str, shape: &str, length: usize) -> io::Result<()> {
        let header = header(kind, shape);
        // Every file has the same date, so that equal arrays give equal bytes.
        let options = SimpleFileOptions::default()
            .compression_method(CompressionMethod::Stored)
            .last_modified_time(DateTime::default())
            .large_file(u32::try_from(length + header.len()).is_err());
        self.0.start_file(name, options)?;
        self.0.write_all(&header)
    }

    fn write(&mut self, data: &[u8]) -> io::Result<()> {
        self.0.write_all(data)
    }

    fn finish(self) -> io::Result<()> {
        self.0.finish()?;
        Ok(())
    }
}
