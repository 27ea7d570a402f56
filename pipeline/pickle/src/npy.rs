//! Arrays in NumPy's npy format, read and written.
//!
//! The header is parsed by its grammar and never evaluated, pickled objects are refused, and shapes are
//! checked against the available bytes before memory is allocated.

use std::borrow::Cow;

use crate::array::{self, Dtype, ItemType, MAX_DIMENSIONS};
use crate::error::{Error, error};

const MAGIC: &[u8] = b"\x93NUMPY";
/// Longest header read, in bytes. NumPy's own limit is 10,000 for files it does not trust.
const MAX_HEADER_LEN: usize = 10_000;
/// The parsed header of an npy file.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Header {
    dtype: Dtype,
    big_endian: bool,
    fortran_order: bool,
    shape: Vec<usize>,
    data_start: usize,
}

/// An array of numbers in row-major order.
#[derive(Clone, Debug, PartialEq)]
pub struct Array {
    /// Extent of each dimension; empty for a scalar.
    pub shape: Vec<usize>,
    /// The numbers, the last index running fastest.
    pub values: Vec<f64>,
}

impl Header {
    /// Parses the header of an array and checks it against the length of `bytes`. `name` names the array in messages.
    ///
    /// # Errors
    /// `E-PICKLE-REFUSED` for objects, `E-NPY-SHAPE` if the shape does not fit the bytes, `E-NPY-DTYPE` for types that
    /// are not supported, `E-NPY-HEADER` if the header cannot be parsed.
    pub fn parse(name: &str, bytes: &[u8]) -> Result<Self, Error> {
        let (header, descr) = Self::parse_text(name, bytes)?;
        let found = bytes.len() - header.data_start;
        let mut extents = header.shape.iter();
        let needed = match header.shape.contains(&0) {
            // An empty array has no bytes. The product of its other extents could overflow.
            true => Some(0),
            false => extents.try_fold(header.dtype.item_len(), |product, &extent| {
                product.checked_mul(extent)
            }),
        };
        if needed != Some(found) {
            return Err(error!(
                "E-NPY-SHAPE",
                "{name}: found {found} bytes of data, expected {} for shape {:?} of {descr}",
                needed.map_or("more than 2^64".to_owned(), |needed| needed.to_string()),
                header.shape
            )
            .at(header.data_start));
        }
        Ok(header)
    }

    /// Byte offset of the number with this row-major index; `None` if the order is column-major.
    pub fn place_of(&self, index: usize) -> Option<usize> {
        let is_flat = self.shape.len() < 2;
        let at = self.data_start + index * self.dtype.item_len();
        (is_flat || !self.fortran_order).then_some(at)
    }

    /// Reads the shape from the first bytes of an npy file, which need not contain the data.
    ///
    /// # Errors
    /// As [`Header::parse`], except `E-NPY-SHAPE`.
    pub fn peek_shape(name: &str, head: &[u8]) -> Result<Vec<usize>, Error> {
        Self::parse_text(name, head).map(|(header, _)| header.shape)
    }

    /// Parses the header without checking the length of the data; also returns the type's text.
    fn parse_text(name: &str, bytes: &[u8]) -> Result<(Self, String), Error> {
        let (literal, data_start) = Self::parse_literal(name, bytes)?;
        let (dtype, big_endian) = parse_descr(name, &literal.descr)?;
        let header = Self {
            dtype,
            big_endian,
            fortran_order: literal.fortran_order,
            shape: literal.shape,
            data_start,
        };
        Ok((header, literal.descr))
    }

    /// Parses the dictionary of the header; also returns the offset of the data.
    fn parse_literal(name: &str, bytes: &[u8]) -> Result<(Literal, usize), Error> {
        let bad = |reason: &str, at: usize| error!("E-NPY-HEADER", "{name}: {reason}").at(at);
        let version_at = MAGIC.len();
        let cut_off = || bad("the header is cut off", bytes.len());
        if !bytes.starts_with(MAGIC) || bytes.len() < version_at + 4 {
            return Err(bad("found no npy magic number, expected \\x93NUMPY", 0));
        }
        let length = &bytes[version_at + 2..];
        let (header_start, header_len) = match (bytes[version_at], length) {
            (1, &[low, high, ..]) => (version_at + 4, u16::from_le_bytes([low, high]).into()),
            (2 | 3, _) => {
                let length = length.first_chunk().ok_or_else(cut_off)?;
                (version_at + 6, u32::from_le_bytes(*length) as usize)
            }
            (version, _) => {
                let reason = format!("found npy version {version}, expected 1 to 3");
                return Err(bad(&reason, version_at));
            }
        };
        if header_len > MAX_HEADER_LEN {
            let reason =
                format!("found a header of {header_len} bytes, expected at most {MAX_HEADER_LEN}");
            return Err(bad(&reason, version_at + 2));
        }
        let data_start = header_start + header_len;
        let text = bytes.get(header_start..data_start).ok_or_else(cut_off)?;
        let literal =
            Literal::parse(text).map_err(|(reason, at)| bad(reason, header_start + at))?;
        Ok((literal, data_start))
    }
}

/// The pickle in an array of objects, and its byte offset; `None` for other arrays.
///
/// # Errors
/// `E-NPY-HEADER` if the header cannot be parsed.
pub fn pickled<'a>(name: &str, bytes: &'a [u8]) -> Result<Option<(&'a [u8], usize)>, Error> {
    let (literal, data_start) = Header::parse_literal(name, bytes)?;
    let is_objects = literal.descr.trim_start_matches(['|', '<', '>', '=']) == "O";
    Ok(is_objects.then(|| (&bytes[data_start..], data_start)))
}

/// Reads an array of numbers.
///
/// # Errors
/// As [`Header::parse`]; `E-NPY-DTYPE` also for text and half precision.
pub fn read_numbers(name: &str, bytes: &[u8]) -> Result<Array, Error> {
    let header = Header::parse(name, bytes)?;
    let (dtype, shape) = (header.dtype, header.shape);
    if matches!(dtype, Dtype::Float(2) | Dtype::Bytes(_) | Dtype::Text(_)) {
        return Err(error!(
            "E-NPY-DTYPE",
            "{name}: found {dtype}, expected f4, f8 or an integer"
        ));
    }
    let items = bytes[header.data_start..].chunks_exact(dtype.item_len());
    let mut values: Vec<f64> = items
        .map(|item| array::number(dtype, header.big_endian, item))
        .collect();
    if header.fortran_order && shape.len() > 1 && !values.is_empty() {
        values = array::row_major(&values, 1, &shape);
    }
    Ok(Array { shape, values })
}

/// The rows of a two-dimensional array of numbers, read in place if possible.
#[derive(Clone, Debug)]
pub struct Rows<'a> {
    bytes: Cow<'a, [u8]>,
    data_start: usize,
    kind: RowKind,
    num_rows: usize,
    width: usize,
}

/// Storage format of the numbers of [`Rows`].
#[derive(Clone, Copy, Debug)]
enum RowKind {
    F64,
    F32,
}

impl<'a> Rows<'a> {
    /// Wraps a two-dimensional array.
    ///
    /// # Errors
    /// As [`read_numbers`]. The inner error is the shape, if it is not two-dimensional or its rows are empty.
    pub fn new(name: &str, bytes: Cow<'a, [u8]>) -> Result<Result<Self, Vec<usize>>, Error> {
        let header = Header::parse(name, &bytes)?;
        let [num_rows, width @ (1..)] = header.shape[..] else {
            return Ok(Err(header.shape));
        };
        let plain = !header.big_endian && (!header.fortran_order || num_rows == 1 || width == 1);
        let (kind, data_start, bytes) = match header.dtype {
            Dtype::Float(8) if plain => (RowKind::F64, header.data_start, bytes),
            Dtype::Float(4) if plain => (RowKind::F32, header.data_start, bytes),
            // All other formats are converted to little-endian `f64` first.
            _ => {
                let values = read_numbers(name, &bytes)?.values.into_iter();
                let bytes = values.flat_map(f64::to_le_bytes).collect();
                (RowKind::F64, 0, Cow::Owned(bytes))
            }
        };
        Ok(Ok(Self {
            bytes,
            data_start,
            kind,
            num_rows,
            width,
        }))
    }

    /// Number of rows.
    pub fn num_rows(&self) -> usize {
        self.num_rows
    }

    /// Numbers per row.
    pub fn width(&self) -> usize {
        self.width
    }

    /// Whether `len` numbers of a row, from `column` on, are finite and can be stored as `f32`.
    ///
    /// # Panics
    /// If the row or a column does not exist.
    pub fn is_finite(&self, row: usize, column: usize, len: usize) -> bool {
        const LARGEST: f64 = f32::MAX as f64;
        // There is no early exit, so that the loop vectorises.
        match self.kind {
            RowKind::F64 => {
                let numbers = self.numbers(row, column, len).iter();
                numbers.fold(true, |all, number| {
                    all & (f64::from_le_bytes(*number).abs() <= LARGEST)
                })
            }
            RowKind::F32 => {
                let numbers = self.numbers(row, column, len).iter();
                numbers.fold(true, |all, number| {
                    all & f32::from_le_bytes(*number).is_finite()
                })
            }
        }
    }

    /// `N` numbers of a row, from `column` on.
    ///
    /// # Panics
    /// If the row or a column does not exist.
    pub fn get<const N: usize>(&self, row: usize, column: usize) -> [f64; N] {
        match self.kind {
            RowKind::F64 => {
                let numbers = self.numbers(row, column, N);
                std::array::from_fn(|i| f64::from_le_bytes(numbers[i]))
            }
            RowKind::F32 => {
                let numbers = self.numbers(row, column, N);
                std::array::from_fn(|i| f64::from(f32::from_le_bytes(numbers[i])))
            }
        }
    }

    /// The bytes of `len` numbers of a row, each of `SIZE` bytes.
    fn numbers<const SIZE: usize>(&self, row: usize, column: usize, len: usize) -> &[[u8; SIZE]] {
        assert!(
            column + len <= self.width,
            "columns {column}.. of {}",
            self.width
        );
        let first = row * self.width + column;
        let data = &self.bytes[self.data_start..];
        data[SIZE * first..][..SIZE * len].as_chunks().0
    }
}

/// Reads the first item of a text array of any shape; an empty array gives an empty text.
///
/// # Errors
/// As [`Header::parse`]; `E-NPY-DTYPE` for numbers.
pub fn read_text(name: &str, bytes: &[u8]) -> Result<String, Error> {
    let header = Header::parse(name, bytes)?;
    let items = &bytes[header.data_start..];
    let item = items.get(..header.dtype.item_len()).unwrap_or_default();
    let text: String = match header.dtype {
        Dtype::Bytes(_) => String::from_utf8_lossy(item).into_owned(),
        Dtype::Text(_) => {
            let decode = match header.big_endian {
                true => u32::from_be_bytes,
                false => u32::from_le_bytes,
            };
            let codes = item.as_chunks().0.iter().copied().map(decode);
            codes.filter_map(char::from_u32).collect()
        }
        dtype => {
            return Err(error!(
                "E-NPY-DTYPE",
                "{name}: found {dtype}, expected text"
            ));
        }
    };
    Ok(text.trim_end_matches('\0').to_owned())
}

/// A type of numbers that [`encode`] writes.
pub trait Number: Copy {
    /// NumPy's name of the type.
    const DESCR: &str;

    /// Appends the number in little-endian bytes.
    fn put(self, out: &mut Vec<u8>);
}

macro_rules! number {
    ($($type:ty: $descr:literal),*) => {$(
        impl Number for $type {
            const DESCR: &str = $descr;

            fn put(self, out: &mut Vec<u8>) {
                out.extend(self.to_le_bytes());
            }
        }
    )*};
}

number!(f32: "<f4", f64: "<f8", i64: "<i8");

/// Encodes an array of numbers in row-major order.
///
/// # Panics
/// If the shape does not fit the numbers.
pub fn encode<T: Number>(shape: &[usize], values: &[T]) -> Vec<u8> {
    assert_eq!(shape.iter().product::<usize>(), values.len());
    let mut out = header(T::DESCR, shape);
    for &value in values {
        value.put(&mut out);
    }
    out
}

/// Encodes text as NumPy does: an array of UTF-32 without dimensions.
pub(crate) fn encode_text(text: &str) -> Vec<u8> {
    let mut out = header(&format!("<U{}", text.chars().count()), &[]);
    out.extend(text.chars().flat_map(|c| u32::from(c).to_le_bytes()));
    out
}

/// Magic number, version 1.0 and the dictionary, padded so that the data begins at a multiple of 64 bytes.
fn header(descr: &str, shape: &[usize]) -> Vec<u8> {
    const ALIGNMENT: usize = 64;
    let extents: String = shape.iter().map(|extent| format!("{extent}, ")).collect();
    let mut text =
        format!("{{'descr': '{descr}', 'fortran_order': False, 'shape': ({extents}), }}");
    let before = MAGIC.len() + 4;
    let len = (before + text.len() + 1).next_multiple_of(ALIGNMENT) - before;
    text.extend(std::iter::repeat_n(' ', len - 1 - text.len()));
    text.push('\n');
    let mut out = MAGIC.to_vec();
    out.extend([1, 0]);
    // The length fits: at most 64 dimensions of 20 digits.
    out.extend((len as u16).to_le_bytes());
    out.extend(text.into_bytes());
    out
}

/// Parses a type such as `<f8`; also returns whether its bytes are big-endian.
fn parse_descr(name: &str, descr: &str) -> Result<(Dtype, bool), Error> {
    let item = ItemType::parse(descr).ok_or_else(|| {
        error!(
            "E-NPY-DTYPE",
            "{name}: found type \"{descr}\", expected one such as <f4, <f8, <i8 or <U6"
        )
    })?;
    let dtype = item.dtype.ok_or_else(|| {
        error!(
            "E-PICKLE-REFUSED",
            "{name}: holds pickled objects, which are code and are never executed; save it as \
                 plain numbers"
        )
    })?;
    Ok((dtype, item.big_endian))
}

/// The dictionary of a header.
struct Literal {
    descr: String,
    fortran_order: bool,
    shape: Vec<usize>,
}

impl Literal {
    /// Parses `{'descr': '<f4', 'fortran_order': False, 'shape': (3, 4), }` in any key order.
    fn parse(text: &[u8]) -> Result<Self, (&'static str, usize)> {
        let mut scanner = Scanner { text, at: 0 };
        let (mut descr, mut fortran_order, mut shape) = (None, None, None);
        scanner.symbol(b'{')?;
        while !scanner.peek(b'}') {
            let key_at = scanner.at;
            let key = scanner.string()?;
            scanner.symbol(b':')?;
            match key {
                b"descr" if scanner.peek(b'[') => {
                    let reason = "the array has named fields, expected plain numbers";
                    return Err((reason, scanner.at));
                }
                b"descr" => descr = Some(String::from_utf8_lossy(scanner.string()?).into_owned()),
                b"fortran_order" => fortran_order = Some(scanner.boolean()?),
                b"shape" => shape = Some(scanner.tuple()?),
                _ => {
                    let reason = "unknown key, expected descr, fortran_order or shape";
                    return Err((reason, key_at));
                }
            }
            if !scanner.peek(b'}') {
                scanner.symbol(b',')?;
            }
        }
        let (Some(descr), Some(fortran_order), Some(shape)) = (descr, fortran_order, shape) else {
            let reason = "a key is missing, expected descr, fortran_order and shape";
            return Err((reason, scanner.at));
        };
        Ok(Self {
            descr,
            fortran_order,
            shape,
        })
    }
}

struct Scanner<'a> {
    text: &'a [u8],
    at: usize,
}

impl<'a> Scanner<'a> {
    fn skip_space(&mut self) {
        while self.text.get(self.at).is_some_and(u8::is_ascii_whitespace) {
            self.at += 1;
        }
    }

    fn peek(&mut self, symbol: u8) -> bool {
        self.skip_space();
        self.text.get(self.at) == Some(&symbol)
    }

    fn symbol(&mut self, symbol: u8) -> Result<(), (&'static str, usize)> {
        if !self.peek(symbol) {
            return Err(("the header is no dictionary of the npy format", self.at));
        }
        self.at += 1;
        Ok(())
    }

    fn string(&mut self) -> Result<&'a [u8], (&'static str, usize)> {
        self.skip_space();
        let quote = match self.text.get(self.at) {
            Some(&quote @ (b'\'' | b'"')) => quote,
            _ => return Err(("found no string where one was expected", self.at)),
        };
        let start = self.at + 1;
        let rest = &self.text[start..];
        let len = rest
            .iter()
            .position(|&byte| byte == quote)
            .ok_or(("a string has no end", self.at))?;
        self.at = start + len + 1;
        Ok(&rest[..len])
    }

    fn boolean(&mut self) -> Result<bool, (&'static str, usize)> {
        self.skip_space();
        for (word, value) in [(&b"True"[..], true), (b"False", false)] {
            if self.text[self.at..].starts_with(word) {
                self.at += word.len();
                return Ok(value);
            }
        }
        Err(("found neither True nor False", self.at))
    }

    fn tuple(&mut self) -> Result<Vec<usize>, (&'static str, usize)> {
        self.symbol(b'(')?;
        let mut items = Vec::new();
        while !self.peek(b')') {
            let digits = self.text[self.at..]
                .iter()
                .take_while(|b| b.is_ascii_digit())
                .count();
            let item = std::str::from_utf8(&self.text[self.at..self.at + digits])
                .ok()
                .and_then(|text| text.parse().ok())
                .ok_or(("found no extent of a dimension", self.at))?;
            if items.len() == MAX_DIMENSIONS {
                return Err(("too many dimensions, expected at most 64", self.at));
            }
            items.push(item);
            self.at += digits;
            // Python 2 wrote long integers with the suffix `L`.
            if self.text.get(self.at) == Some(&b'L') {
                self.at += 1;
            }
            if !self.peek(b')') {
                self.symbol(b',')?;
            }
        }
        self.symbol(b')')?;
        Ok(items)
    }
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    /// An npy file with this dictionary and data.
    fn npy(dictionary: &str, data: &[u8]) -> Vec<u8> {
        let mut bytes = MAGIC.to_vec();
        bytes.extend([1, 0]);
        bytes.extend((dictionary.len() as u16).to_le_bytes());
        bytes.extend(dictionary.as_bytes());
        bytes.extend(data);
        bytes
    }

    #[test]
    fn what_is_written_is_read_back_and_aligned() {
        let bytes = encode(&[2, 3], &[1.0f32, 2.0, 3.0, -4.0, 5.0, 6e30]);
        assert_eq!(&bytes[..10], b"\x93NUMPY\x01\x00\x76\x00");
        let dictionary = b"{'descr': '<f4', 'fortran_order': False, 'shape': (2, 3, ), }  ";
        assert!(bytes[10..].starts_with(dictionary));
        assert_eq!((bytes[127], bytes.len()), (b'\n', 128 + 24));
        let array = read_numbers("array", &bytes).expect("an array");
        assert_eq!(array.shape, [2, 3]);
        assert_eq!(array.values[3], -4.0);
        let scalar = read_numbers("n", &encode(&[], &[-7i64])).expect("a number");
        assert_eq!((scalar.shape, scalar.values), (vec![], vec![-7.0]));
        let text = read_text("gender", &encode_text("näutral")).expect("text");
        assert_eq!(text, "näutral");
    }

    #[test]
    fn every_type_and_order_gives_the_same_matrix() {
        let expected = [1.0, 2.0, 3.0, 4.0, 5.0, 6.0];
        let columns = [1.0, 4.0, 2.0, 5.0, 3.0, 6.0];
        let dictionary = |descr: &str, fortran: &str| {
            format!("{{\"shape\": (2, 3), 'fortran_order': {fortran}, 'descr': '{descr}'}}")
        };
        type ToBytes = fn(f64) -> Vec<u8>;
        let rows = |to_bytes: ToBytes| expected.into_iter().flat_map(to_bytes).collect();
        let flip = |to_bytes: ToBytes| columns.into_iter().flat_map(to_bytes).collect();
        let cases: [(&str, &str, Vec<u8>); 7] = [
            ("<f8", "False", rows(|v| v.to_le_bytes().to_vec())),
            (">f8", "False", rows(|v| v.to_be_bytes().to_vec())),
            ("<f4", "True", flip(|v| (v as f32).to_le_bytes().to_vec())),
            (">f4", "True", flip(|v| (v as f32).to_be_bytes().to_vec())),
            ("<i8", "False", rows(|v| (v as i64).to_le_bytes().to_vec())),
            (">i4", "False", rows(|v| (v as i32).to_be_bytes().to_vec())),
            ("|u1", "True", flip(|v| vec![v as u8])),
        ];
        for (descr, fortran, data) in cases {
            let array = read_numbers("m", &npy(&dictionary(descr, fortran), &data)).expect(descr);
            assert_eq!(array.shape, [2, 3], "{descr}");
            assert_eq!(array.values, expected, "{descr}");
        }
    }

    #[test]
    fn text_comes_in_bytes_and_in_unicode() {
        let bytes = npy(
            "{'descr': '|S6', 'fortran_order': False, 'shape': (), }",
            b"male\0\0",
        );
        assert_eq!(read_text("gender", &bytes).expect("text"), "male");
        let unicode: Vec<u8> = "female"
            .chars()
            .flat_map(|c| (c as u32).to_le_bytes())
            .collect();
        let bytes = npy(
            "{'descr': '<U6', 'fortran_order': False, 'shape': (1,), }",
            &unicode,
        );
        assert_eq!(read_text("gender", &bytes).expect("text"), "female");
    }

    #[test]
    fn an_empty_array_may_have_any_other_extents() {
        for (shape, extents) in [
            ("(0,)", vec![0]),
            (
                "(1099511627776, 1099511627776, 0)",
                vec![1 << 40, 1 << 40, 0],
            ),
        ] {
            for fortran in ["False", "True"] {
                let dictionary =
                    format!("{{'descr': '<f8', 'fortran_order': {fortran}, 'shape': {shape}}}");
                let array = read_numbers("m", &npy(&dictionary, &[])).expect(shape);
                let expected = (extents.clone(), vec![]);
                assert_eq!((array.shape, array.values), expected, "{dictionary}");
                let more = read_numbers("m", &npy(&dictionary, &[0; 8]));
                assert_eq!(more.expect_err(shape).code, "E-NPY-SHAPE");
            }
        }
    }

    #[test]
    fn lies_and_pickles_are_refused_by_code() {
        let code = |dictionary: &str, data: &[u8]| {
            let read = read_numbers("m", &npy(dictionary, data));
            read.expect_err(dictionary).code
        };
        let shape =
            |shape: &str| format!("{{'descr': '<f8', 'fortran_order': False, 'shape': {shape}}}");
        for (lie, data, expected) in [
            ("(1099511627776, 156)", &[0; 116][..], "E-NPY-SHAPE"),
            ("(18446744073709551615, 2)", &[], "E-NPY-SHAPE"),
            ("(3,)", &[0; 16], "E-NPY-SHAPE"),
            ("(-3,)", &[], "E-NPY-HEADER"),
            ("__import__('os')", &[], "E-NPY-HEADER"),
        ] {
            assert_eq!(code(&shape(lie), data), expected, "{lie}");
        }
        let objects = "{'descr': '|O', 'fortran_order': False, 'shape': ()}";
        assert_eq!(code(objects, b"cos\nsystem\n."), "E-PICKLE-REFUSED");
        let fields = "{'descr': [('a', '<f8')], 'fortran_order': False, 'shape': (1,)}";
        assert_eq!(code(fields, &[0; 8]), "E-NPY-HEADER");
        let complex = "{'descr': '<c16', 'fortran_order': False, 'shape': (1,)}";
        assert_eq!(code(complex, &[0; 16]), "E-NPY-DTYPE");
    }

    proptest! {
        #[test]
        fn no_bytes_make_it_panic(
            bytes in prop::collection::vec(any::<u8>(), 0..200),
            at in 0usize..120,
        ) {
            let mut mutated = encode::<f64>(&[2, 2], &[1.0, 2.0, 3.0, 4.0]);
            for (offset, byte) in bytes.iter().enumerate().take(4) {
                if let Some(slot) = mutated.get_mut(at + offset) {
                    *slot = *byte;
                }
            }
            for candidate in [&bytes, &mutated] {
                if let Ok(array) = read_numbers("m", candidate) {
                    prop_assert_eq!(array.values.len(), array.shape.iter().product::<usize>());
                }
                if let Ok(text) = read_text("t", candidate) {
                    prop_assert!(text.len() <= 4 * candidate.len());
                }
            }
        }
    }
}
