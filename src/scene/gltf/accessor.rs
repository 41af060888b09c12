//! Reads numbers from buffers: all types, normalised, interleaved and sparse.

use super::container::Document;
use super::document::Accessor;
use crate::Result;

/// The largest count of an accessor without bytes, unless the buffers have more bytes than this. Such an accessor is
/// all zeros, so that a file could claim any count at no cost.
const MOST_ZEROS: u64 = 1 << 12;

type Checked<T> = std::result::Result<T, String>;

/// The type of a component (section 3.6.2.2 of the specification).
#[derive(Clone, Copy, PartialEq)]
enum Component {
    I8,
    U8,
    I16,
    U16,
    U32,
    F32,
}

impl Component {
    fn of(code: u64) -> Checked<Component> {
        Ok(match code {
            5120 => Component::I8,
            5121 => Component::U8,
            5122 => Component::I16,
            5123 => Component::U16,
            5125 => Component::U32,
            5126 => Component::F32,
            _ => return Err(format!("componentType {code} is unknown")),
        })
    }

    fn size(self) -> usize {
        match self {
            Component::I8 | Component::U8 => 1,
            Component::I16 | Component::U16 => 2,
            Component::U32 | Component::F32 => 4,
        }
    }

    /// Writes a number, rounded if the type is an integer.
    fn write(self, x: f64, out: &mut [u8]) {
        let whole = x.round();
        match self {
            Component::I8 => out.copy_from_slice(&(whole as i8).to_le_bytes()),
            Component::U8 => out.copy_from_slice(&(whole as u8).to_le_bytes()),
            Component::I16 => out.copy_from_slice(&(whole as i16).to_le_bytes()),
            Component::U16 => out.copy_from_slice(&(whole as u16).to_le_bytes()),
            Component::U32 => out.copy_from_slice(&(whole as u32).to_le_bytes()),
            Component::F32 => out.copy_from_slice(&(x as f32).to_le_bytes()),
        }
    }

    /// Reads the number at the beginning of `bytes`. Normalised integers are shares of the largest value. The least
    /// signed integer counts as -1 (section 3.11 of the specification).
    fn number(self, bytes: &[u8], normalized: bool) -> f64 {
        let (value, most) = match (self, bytes) {
            (Component::I8, [a, ..]) => (f64::from(*a as i8), 127.0),
            (Component::U8, [a, ..]) => (f64::from(*a), 255.0),
            (Component::I16, [a, b, ..]) => (f64::from(i16::from_le_bytes([*a, *b])), 32767.0),
            (Component::U16, [a, b, ..]) => (f64::from(u16::from_le_bytes([*a, *b])), 65535.0),
            (Component::U32, [a, b, c, d, ..]) => {
                (f64::from(u32::from_le_bytes([*a, *b, *c, *d])), f64::from(u32::MAX))
            }
            (Component::F32, [a, b, c, d, ..]) => (f64::from(f32::from_le_bytes([*a, *b, *c, *d])), 1.0),
            _ => (0.0, 1.0),
        };
        if normalized { (value / most).max(-1.0) } else { value }
    }
}

/// The layout of an accessor's elements.
struct Layout {
    component: Component,
    /// Number of components of an element, and number of its bytes.
    width: usize,
    size: usize,
    count: usize,
}

/// The elements of an accessor as bytes without gaps.
pub struct Raw {
    bytes: Vec<u8>,
    /// Number of bytes of an element.
    pub size: usize,
    component: Component,
    /// The type of an element, as in the file.
    pub component_type: u64,
    pub kind: String,
    pub normalized: bool,
}

impl Raw {
    /// Number of elements.
    pub fn count(&self) -> usize {
        self.bytes.len() / self.size
    }

    /// The bytes of an element.
    pub fn element(&self, i: usize) -> &[u8] {
        &self.bytes[i * self.size..][..self.size]
    }

    /// The first three components of an element. Missing components are zero.
    pub fn numbers(&self, element: &[u8]) -> [f64; 3] {
        let mut numbers = element[..self.size].chunks_exact(self.component.size());
        std::array::from_fn(|_| numbers.next().map_or(0.0, |bytes| self.component.number(bytes, false)))
    }

    /// Writes an element that is interpolated from three elements.
    pub fn mix(&self, of: [u32; 3], weights: [f64; 3], out: &mut [u8]) {
        let size = self.component.size();
        for (k, out) in out.chunks_exact_mut(size).enumerate() {
            let number = |v: u32| self.component.number(&self.element(v as usize)[k * size..], false);
            let mixed: f64 = of.iter().zip(weights).map(|(&v, weight)| weight * number(v)).sum();
            self.component.write(mixed, out);
        }
    }
}

impl Document {
    /// The elements of accessor `i`, which must be of type `kind`.
    ///
    /// # Errors
    /// [`Error::Input`](crate::Error::Input) when the accessor is missing or of another type, or when its bytes are not
    /// there.
    pub fn numbers<const N: usize>(&self, i: usize, kind: &str) -> Result<Vec<[f64; N]>> {
        self.elements(i, kind, N)
            .map(|numbers| numbers.as_chunks::<N>().0.to_vec())
            .map_err(|why| self.error(format!("accessors[{i}]: {why}")))
    }

    /// The elements of accessor `i` as whole numbers.
    ///
    /// # Errors
    /// Those of [`Document::numbers`].
    pub fn indices(&self, i: usize) -> Result<Vec<u32>> {
        let failed = |why| self.error(format!("accessors[{i}]: {why}"));
        let accessor = self.accessor(i).map_err(failed)?;
        if accessor.normalized || ![5121, 5123, 5125].contains(&accessor.component_type) {
            return Err(failed("indices must be unsigned integers".into()));
        }
        // Every u32 is exact in double precision.
        Ok(self.numbers::<1>(i, "SCALAR")?.into_iter().map(|[index]| index as u32).collect())
    }

    /// Accessor `i` as bytes, for exact copies.
    ///
    /// # Errors
    /// Those of [`Document::numbers`].
    pub fn raw(&self, i: usize) -> Result<Raw> {
        self.accessor(i)
            .and_then(|accessor| {
                let layout = self.layout(accessor)?;
                let mut bytes = vec![0; layout.count * layout.size];
                self.copy(accessor, &layout, &mut bytes)?;
                Ok(Raw {
                    bytes,
                    size: layout.size,
                    component: layout.component,
                    component_type: accessor.component_type,
                    kind: accessor.kind.clone(),
                    normalized: accessor.normalized,
                })
            })
            .map_err(|why| self.error(format!("accessors[{i}]: {why}")))
    }

    /// The type of accessor `i`, such as `VEC3`.
    ///
    /// # Errors
    /// Those of [`Document::numbers`].
    pub fn kind(&self, i: usize) -> Result<&str> {
        self.accessor(i).map(|a| &*a.kind).map_err(|why| self.error(format!("accessors[{i}]: {why}")))
    }

    fn accessor(&self, i: usize) -> Checked<&Accessor> {
        self.root.accessors.get(i).ok_or_else(|| "it does not exist".into())
    }

    fn elements(&self, i: usize, kind: &str, width: usize) -> Checked<Vec<f64>> {
        let accessor = self.accessor(i)?;
        if accessor.kind != kind {
            let found: String = accessor.kind.chars().take(20).collect();
            return Err(format!("its type must be {kind}, not {found}"));
        }
        let layout = self.layout(accessor)?;
        let mut bytes = vec![0; layout.count * layout.size];
        self.copy(accessor, &layout, &mut bytes)?;
        debug_assert_eq!(layout.width, width);
        let numbers = bytes.chunks_exact(layout.component.size());
        Ok(numbers.map(|bytes| layout.component.number(bytes, accessor.normalized)).collect())
    }

    fn layout(&self, accessor: &Accessor) -> Checked<Layout> {
        let component = Component::of(accessor.component_type)?;
        let (width, columns) = match &*accessor.kind {
            "SCALAR" => (1, 1),
            "VEC2" => (2, 1),
            "VEC3" => (3, 1),
            "VEC4" => (4, 1),
            "MAT2" => (4, 2),
            "MAT3" => (9, 3),
            "MAT4" => (16, 4),
            _ => return Err("its type is unknown".into()),
        };
        // Columns of matrices begin at multiples of four bytes (section 3.6.2.4). Only matrices without such gaps are
        // read.
        if columns > 1 && component.size() * width / columns % 4 != 0 {
            return Err("matrices of small integers are not read".into());
        }
        let size = width * component.size();
        let total = self.buffers.iter().map(|b| b.len() as u64).sum::<u64>();
        let most = match accessor.buffer_view {
            Some(_) => total,
            None => total.max(MOST_ZEROS),
        };
        if accessor.count > most {
            return Err(format!("its count is {}, more than the buffers can hold", accessor.count));
        }
        Ok(Layout { component, width, size, count: accessor.count as usize })
    }

    /// Copies the elements without gaps, then replaces the elements that a sparse accessor lists.
    fn copy(&self, accessor: &Accessor, layout: &Layout, out: &mut [u8]) -> Checked<()> {
        if let Some(view) = accessor.buffer_view {
            let bytes = self.view(view)?;
            let stride = self.root.buffer_views[view].byte_stride.unwrap_or(layout.size as u64);
            if stride < layout.size as u64 {
                return Err(format!(
                    "byteStride {stride} is less than its elements of {} bytes",
                    layout.size
                ));
            }
            let starts = (0..layout.count as u64)
                .map(|k| k.checked_mul(stride)?.checked_add(accessor.byte_offset)?.try_into().ok());
            for (start, out) in starts.zip(out.chunks_exact_mut(layout.size)) {
                let element =
                    start.and_then(|start: usize| bytes.get(start..start.checked_add(layout.size)?));
                out.copy_from_slice(element.ok_or_else(|| format!("it ends beyond bufferViews[{view}]"))?);
            }
        }
        let Some(sparse) = &accessor.sparse else { return Ok(()) };
        if sparse.count > layout.count as u64 {
            return Err(format!("{} of {} elements are sparse", sparse.count, layout.count));
        }
        let indices = self.view(sparse.indices.buffer_view)?;
        let values = self.view(sparse.values.buffer_view)?;
        let component = Component::of(sparse.indices.component_type)?;
        if ![Component::U8, Component::U16, Component::U32].contains(&component) {
            return Err("sparse indices must be unsigned integers".into());
        }
        let slice = |bytes: &'_ [u8], offset: u64, size: usize, k: usize| -> Option<std::ops::Range<usize>> {
            let start = usize::try_from(offset).ok()?.checked_add(k.checked_mul(size)?)?;
            let end = start.checked_add(size)?;
            (end <= bytes.len()).then_some(start..end)
        };
        for k in 0..sparse.count as usize {
            let index = slice(indices, sparse.indices.byte_offset, component.size(), k);
            let value = slice(values, sparse.values.byte_offset, layout.size, k);
            let (Some(index), Some(value)) = (index, value) else {
                return Err("its sparse part ends beyond its buffer view".into());
            };
            let at = component.number(&indices[index], false) as usize;
            let place = out.chunks_exact_mut(layout.size).nth(at);
            place
                .ok_or_else(|| format!("sparse index {at} of {} elements", layout.count))?
                .copy_from_slice(&values[value]);
        }
        Ok(())
    }
}
