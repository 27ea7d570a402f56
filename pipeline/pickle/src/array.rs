//! Arrays of numbers and text.

use std::fmt;
use std::sync::Arc;

/// Maximum number of dimensions of an array, as in NumPy 2.
pub(crate) const MAX_DIMENSIONS: usize = 64;

/// Type of an array's items.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Dtype {
    /// One-byte Booleans.
    Bool,
    /// Floating-point numbers of this many bytes: 2, 4 or 8.
    Float(usize),
    /// Signed integers of this many bytes: 1, 2, 4 or 8.
    Signed(usize),
    /// Unsigned integers of this many bytes: 1, 2, 4 or 8.
    Unsigned(usize),
    /// Byte strings of this many bytes.
    Bytes(usize),
    /// Text of this many code points.
    Text(usize),
}

impl Dtype {
    /// Size of an item in bytes.
    pub fn item_len(self) -> usize {
        match self {
            Self::Bool => 1,
            Self::Float(len) | Self::Signed(len) | Self::Unsigned(len) | Self::Bytes(len) => len,
            Self::Text(chars) => 4 * chars,
        }
    }

    /// Size in bytes of the unit to which the byte order applies.
    fn unit_len(self) -> usize {
        match self {
            Self::Bytes(_) => 1,
            Self::Text(_) => 4,
            _ => self.item_len(),
        }
    }
}

impl fmt::Display for Dtype {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let (letter, number) = match *self {
            Self::Bool => ('b', 1),
            Self::Float(len) => ('f', len),
            Self::Signed(len) => ('i', len),
            Self::Unsigned(len) => ('u', len),
            Self::Bytes(len) => ('S', len),
            Self::Text(chars) => ('U', chars),
        };
        write!(f, "{letter}{number}")
    }
}

/// Type and byte order of an array's items, as stated in a pickle or the header of an npy file.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct ItemType {
    /// `None` for Python objects.
    pub(crate) dtype: Option<Dtype>,
    pub(crate) big_endian: bool,
}

impl ItemType {
    /// Parses a type such as `f4`, `<f8`, `|b1`, `U7` or `O8`.
    pub(crate) fn parse(text: &str) -> Option<Self> {
        let big_endian = text.starts_with('>');
        let mut chars = text.trim_start_matches(['<', '>', '|', '=']).chars();
        let dtype = match chars.next()? {
            'O' => None,
            letter => Some(match (letter, chars.as_str().parse().ok()?) {
                ('b', 1) => Dtype::Bool,
                ('f', len @ (2 | 4 | 8)) => Dtype::Float(len),
                ('i', len @ (1 | 2 | 4 | 8)) => Dtype::Signed(len),
                ('u', len @ (1 | 2 | 4 | 8)) => Dtype::Unsigned(len),
                ('S' | 'a', len @ 1..) => Dtype::Bytes(len),
                ('U', len @ 1..) if len < usize::MAX / 4 => Dtype::Text(len),
                _ => return None,
            }),
        };
        Some(Self { dtype, big_endian })
    }
}

/// An array in row-major order.
///
/// # Shapes
/// `shape` is empty for a scalar; `data` holds the items in little-endian bytes, the last index running fastest.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Array {
    dtype: Dtype,
    shape: Vec<usize>,
    data: Arc<[u8]>,
}

impl Array {
    /// An array of single-precision numbers.
    ///
    /// # Panics
    /// If the number of values does not match the shape.
    pub fn from_f32(shape: &[usize], values: impl IntoIterator<Item = f32>) -> Self {
        let data: Vec<u8> = values.into_iter().flat_map(f32::to_le_bytes).collect();
        let dtype = Dtype::Float(4);
        assert_eq!(
            byte_len(dtype, shape),
            Some(data.len()),
            "shape {shape:?} does not fit the values"
        );
        Self {
            dtype,
            shape: shape.to_vec(),
            data: data.into(),
        }
    }

    /// Converts raw items to row-major order and little-endian bytes.
    pub(crate) fn from_raw(
        item: ItemType,
        shape: Vec<usize>,
        raw: Arc<[u8]>,
        fortran_order: bool,
    ) -> Result<Self, String> {
        let Some(dtype) = item.dtype else {
            return Err("found objects where bytes of numbers were expected".to_owned());
        };
        if byte_len(dtype, &shape) != Some(raw.len()) {
            return Err(format!(
                "found {} bytes, expected those of shape {shape:?} of {dtype}",
                raw.len()
            ));
        }
        let mut data = raw;
        if item.big_endian && dtype.unit_len() > 1 {
            let mut swapped = data.to_vec();
            for unit in swapped.chunks_exact_mut(dtype.unit_len()) {
                unit.reverse();
            }
            data = swapped.into();
        }
        if fortran_order && shape.len() > 1 && !data.is_empty() {
            data = row_major(&data, dtype.item_len(), &shape).into();
        }
        Ok(Self { dtype, shape, data })
    }

    /// Takes items out of a storage by offset and strides, all counted in items.
    pub(crate) fn from_strides(
        dtype: Dtype,
        storage: &Arc<[u8]>,
        offset: usize,
        shape: Vec<usize>,
        strides: &[usize],
    ) -> Result<Self, String> {
        let stored = storage.len() / dtype.item_len();
        let wrong = || {
            format!(
                "found a tensor of shape {shape:?}, offset {offset} and strides {strides:?} in a \
                 storage of {stored} items"
            )
        };
        // With strides of zero, a small storage could give any number of items.
        let count = count(&shape).filter(|&count| count <= stored);
        let count = count.ok_or_else(wrong)?;
        if strides.len() != shape.len() {
            return Err(wrong());
        }
        if count == 0 {
            return Ok(Self {
                dtype,
                shape,
                data: Arc::from([]),
            });
        }
        let last = shape
            .iter()
            .zip(strides)
            .try_fold(offset, |at, (&extent, &stride)| {
                (extent - 1)
                    .checked_mul(stride)
                    .and_then(|step| at.checked_add(step))
            });
        if last.is_none_or(|last| last >= stored) {
            return Err(wrong());
        }
        let row_major =
            shape
                .iter()
                .zip(strides)
                .rev()
                .try_fold(1, |expected, (&extent, &stride)| {
                    (extent == 1 || stride == expected).then_some(expected * extent)
                });
        let data = if row_major.is_some() && offset == 0 && count == stored {
            storage.clone()
        } else {
            gather(storage, dtype.item_len(), offset, &shape, strides).into()
        };
        Ok(Self { dtype, shape, data })
    }

    /// The same array with numbers of double precision rounded to single precision.
    pub(crate) fn in_single_precision(self) -> Self {
        if self.dtype != Dtype::Float(8) {
            return self;
        }
        let data: Vec<u8> = self
            .numbers()
            .flat_map(|value| (value as f32).to_le_bytes())
            .collect();
        Self {
            dtype: Dtype::Float(4),
            shape: self.shape,
            data: data.into(),
        }
    }

    /// Type of the items.
    pub fn dtype(&self) -> Dtype {
        self.dtype
    }

    /// Extent of each dimension.
    pub fn shape(&self) -> &[usize] {
        &self.shape
    }

    /// The items in little-endian bytes.
    pub fn data(&self) -> &[u8] {
        &self.data
    }

    /// The items as numbers; `None` for text.
    pub fn to_f64(&self) -> Option<Vec<f64>> {
        self.is_numeric().then(|| self.numbers().collect())
    }

    /// The items as numbers in single precision; `None` for text.
    pub fn to_f32(&self) -> Option<Vec<f32>> {
        self.is_numeric()
            .then(|| self.numbers().map(|value| value as f32).collect())
    }

    fn is_numeric(&self) -> bool {
        !matches!(self.dtype, Dtype::Bytes(_) | Dtype::Text(_))
    }

    fn numbers(&self) -> impl Iterator<Item = f64> + '_ {
        let dtype = self.dtype;
        self.data
            .chunks_exact(dtype.item_len())
            .map(move |item| number(dtype, false, item))
    }

    /// The items as text; `None` for numbers.
    pub fn to_text(&self) -> Option<Vec<String>> {
        let decode: fn(&[u8]) -> String = match self.dtype {
            Dtype::Bytes(_) => |item| item.iter().copied().map(char::from).collect(),
            Dtype::Text(_) => |item| {
                item.as_chunks::<4>()
                    .0
                    .iter()
                    .filter_map(|code| char::from_u32(u32::from_le_bytes(*code)))
                    .collect()
            },
            _ => return None,
        };
        Some(
            self.data
                .chunks_exact(self.dtype.item_len())
                .map(|item| decode(item).trim_end_matches('\0').to_owned())
                .collect(),
        )
    }

    /// The first item as an integer; `None` for other types and for an empty array.
    pub(crate) fn first_int(&self) -> Option<i128> {
        let item = self.data.get(..self.dtype.item_len())?;
        let mut bytes = [0; 16];
        bytes[..item.len().min(16)].copy_from_slice(&item[..item.len().min(16)]);
        match self.dtype {
            Dtype::Unsigned(_) => Some(i128::from_le_bytes(bytes)),
            Dtype::Signed(len) => {
                let unused = 8 * (16 - len as u32);
                Some((i128::from_le_bytes(bytes) << unused) >> unused)
            }
            _ => None,
        }
    }
}

/// Number of items of a shape; `None` if no array can have this shape.
pub(crate) fn count(shape: &[usize]) -> Option<usize> {
    if shape.len() > MAX_DIMENSIONS {
        return None;
    }
    // The product of the extents other than zero must not overflow, because strides are computed from them.
    let full = shape
        .iter()
        .filter(|&&extent| extent > 0)
        .try_fold(1usize, |product, &extent| product.checked_mul(extent))?;
    Some(if shape.contains(&0) { 0 } else { full })
}

/// Size of an array in bytes; `None` if no array can have this shape.
pub(crate) fn byte_len(dtype: Dtype, shape: &[usize]) -> Option<usize> {
    count(shape)?.checked_mul(dtype.item_len())
}

/// Reorders items from column-major to row-major order. There is at least one item.
pub(crate) fn row_major<T: Copy>(data: &[T], item_len: usize, shape: &[usize]) -> Vec<T> {
    let strides = shape.iter().scan(1, |stride, &extent| {
        let this = *stride;
        *stride *= extent;
        Some(this)
    });
    let strides: Vec<usize> = strides.collect();
    gather(data, item_len, 0, shape, &strides)
}

/// Gathers items in row-major order of their indices. The caller has checked that all lie inside `data`.
fn gather<T: Copy>(
    data: &[T],
    item_len: usize,
    offset: usize,
    shape: &[usize],
    strides: &[usize],
) -> Vec<T> {
    let mut index = vec![0usize; shape.len()];
    let mut at = offset;
    let mut out = Vec::new();
    loop {
        out.extend_from_slice(&data[at * item_len..][..item_len]);
        let Some(dimension) = (0..shape.len())
            .rev()
            .find(|&dimension| index[dimension] + 1 < shape[dimension])
        else {
            return out;
        };
        index[dimension] += 1;
        at += strides[dimension];
        for inner in dimension + 1..shape.len() {
            at -= index[inner] * strides[inner];
            index[inner] = 0;
        }
    }
}

/// Decodes an item as a number. Text gives its first 8 bytes as an unsigned integer.
pub(crate) fn number(dtype: Dtype, big_endian: bool, item: &[u8]) -> f64 {
    let mut bytes = [0; 8];
    let len = item.len().min(8);
    bytes[..len].copy_from_slice(&item[..len]);
    if big_endian {
        bytes[..len].reverse();
    }
    let bits = u64::from_le_bytes(bytes);
    match dtype {
        Dtype::Float(8) => f64::from_bits(bits),
        Dtype::Float(4) => f64::from(f32::from_bits(bits as u32)),
        Dtype::Float(_) => half(bits as u16),
        Dtype::Signed(len) => {
            let unused = 8 * (8 - len as u32);
            ((bits << unused) as i64 >> unused) as f64
        }
        _ => bits as f64,
    }
}

/// A half-precision number: 1 sign bit, 5 bits of exponent with bias 15, 10 bits of fraction.
fn half(bits: u16) -> f64 {
    let sign = if bits >> 15 == 1 { -1.0 } else { 1.0 };
    let exponent = i32::from(bits >> 10 & 0x1f);
    let fraction = f64::from(bits & 0x3ff);
    let size = match exponent {
        0 => fraction * 2f64.powi(-24),
        31 if fraction == 0.0 => f64::INFINITY,
        31 => f64::NAN,
        _ => (1.0 + fraction / 1024.0) * 2f64.powi(exponent - 15),
    };
    sign * size
}

#[cfg(test)]
mod tests {
    use super::*;

    fn item(text: &str) -> ItemType {
        ItemType::parse(text).expect("a type")
    }

    #[test]
    fn types_are_parsed_by_their_short_names() {
        assert_eq!(item("<f8").dtype, Some(Dtype::Float(8)));
        assert!(item(">i2").big_endian);
        assert_eq!(item("|b1").dtype, Some(Dtype::Bool));
        assert_eq!(item("U7").dtype.map(Dtype::item_len), Some(28));
        assert_eq!(item("O8").dtype, None);
        for wrong in [
            "",
            "f3",
            "c8",
            "V4",
            "U0",
            "S0",
            "f",
            "M8[ns]",
            "U99999999999999999999",
        ] {
            assert_eq!(ItemType::parse(wrong), None, "{wrong}");
        }
    }

    #[test]
    fn numbers_of_every_type_have_their_value() {
        for (name, bytes, value) in [
            ("<f4", &[0, 0, 192, 191][..], -1.5),
            (">f4", &[191, 192, 0, 0], -1.5),
            ("<f2", &[0, 190], -1.5),
            ("<f2", &[1, 0], 2f64.powi(-24)),
            (">f8", &[192, 4, 0, 0, 0, 0, 0, 0], -2.5),
            ("<i1", &[255], -1.0),
            (">i2", &[255, 254], -2.0),
            ("<i8", &[253, 255, 255, 255, 255, 255, 255, 255], -3.0),
            ("<u4", &[255, 255, 255, 255], 4_294_967_295.0),
            ("|b1", &[1], 1.0),
        ] {
            let array = Array::from_raw(item(name), vec![], bytes.into(), false).expect(name);
            assert_eq!(array.to_f64(), Some(vec![value]), "{name}");
            assert_eq!(array.to_text(), None);
        }
    }

    #[test]
    fn column_major_and_strided_items_come_out_in_row_major_order() {
        let columns: Arc<[u8]> = [1, 4, 2, 5, 3, 6].into();
        let array = Array::from_raw(item("u1"), vec![2, 3], columns.clone(), true).expect("fits");
        assert_eq!(array.data(), [1, 2, 3, 4, 5, 6]);
        let dtype = Dtype::Unsigned(1);
        let same = Array::from_strides(dtype, &columns, 0, vec![2, 3], &[1, 2]).expect("inside");
        assert_eq!(same, array);
        let tail = Array::from_strides(dtype, &columns, 4, vec![2], &[1]).expect("inside");
        assert_eq!(tail.data(), [3, 6]);
        for (offset, shape, strides) in [
            (5, vec![2], vec![1]),
            (0, vec![7], vec![0]),
            (0, vec![2, usize::MAX], vec![1, 1]),
            (0, vec![2], vec![usize::MAX]),
            (0, vec![2], vec![1, 1]),
        ] {
            assert!(Array::from_strides(dtype, &columns, offset, shape, &strides).is_err());
        }
    }

    #[test]
    fn a_shape_is_held_against_the_bytes() {
        for shape in [
            vec![3],
            vec![usize::MAX, 2],
            vec![usize::MAX, usize::MAX, 0],
            vec![1; 65],
        ] {
            assert!(Array::from_raw(item("f4"), shape, Arc::from([0; 8]), false).is_err());
        }
    }

    #[test]
    fn text_loses_its_padding() {
        let raw: Arc<[u8]> = b"ab\0\0".as_slice().into();
        let array = Array::from_raw(item("S2"), vec![2], raw, false).expect("fits");
        assert_eq!(array.to_text(), Some(vec!["ab".to_owned(), String::new()]));
        let raw: Arc<[u8]> = [0, 0, 0, 0xe9, 0, 0, 0, 0].into();
        let array = Array::from_raw(item(">U2"), vec![], raw, false).expect("fits");
        assert_eq!(array.to_text(), Some(vec!["é".to_owned()]));
    }
}
