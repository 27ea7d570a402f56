//! Files of `torch.save`, and the storages of tensors within other pickles.

use std::collections::BTreeMap;
use std::io::{Cursor, Read};
use std::sync::Arc;

use zip::ZipArchive;

use crate::error::Error;
use crate::machine::Machine;
use crate::npz::{MAX_MEMBER_LEN, check_len};
use crate::object::{Node, Storage, StorageData};
use crate::value::{Options, Value};

/// Start of a file before PyTorch 1.6: a pickle of this number, then one of the version.
const LEGACY_MAGIC: i128 = 0x1950_a86a_20f9_469c_fc6c;
const LEGACY_VERSION: i128 = 1001;
const ZIP_MAGIC: &[u8] = b"PK\x03\x04";

/// Reads a file of `torch.save` in the old or the new format; tensors become arrays.
///
/// # Errors
/// `E-TORCH-FORMAT` if the format is neither, and those of [`crate::read`].
///
/// # Source
/// `torch/serialization.py`: a zip with `data.pkl` and `data/<key>`, or five pickles (number, version, system, object,
/// keys) followed by the storages, each preceded by its length.
pub fn read(bytes: &[u8]) -> Result<Value, Error> {
    if !bytes.starts_with(ZIP_MAGIC) {
        let legacy = Legacy::read(bytes)?;
        return legacy.machine.value(legacy.root, &legacy.storages);
    }
    let mut archive = ZipArchive::new(Cursor::new(bytes))
        .map_err(|error| wrong(format!("found no complete zip archive ({error})")))?;
    let names: Vec<String> = archive
        .file_names_raw()
        .map(|name| String::from_utf8_lossy(name).into_owned())
        .collect();
    let name = names
        .iter()
        .find(|name| *name == "data.pkl" || name.ends_with("/data.pkl"))
        .ok_or_else(|| wrong("found an archive without data.pkl"))?;
    let folder = name.trim_end_matches("data.pkl");
    let order = format!("{folder}byteorder");
    if names.contains(&order) && member(&mut archive, &order)?.trim_ascii() != b"little" {
        return Err(wrong("found a byte order other than little"));
    }
    let pickle = member(&mut archive, name)?;
    let mut machine = Machine::new(&pickle[..], Options::default());
    machine.outside_storages = true;
    let root = machine.run()?;
    let mut storages = BTreeMap::new();
    for key in machine.outside_storages().into_keys() {
        let bytes = member(&mut archive, &format!("{folder}data/{key}"))?;
        storages.insert(key, bytes.into());
    }
    machine.value(root, &storages)
}

fn member(archive: &mut ZipArchive<Cursor<&[u8]>>, name: &str) -> Result<Vec<u8>, Error> {
    let failed = |error: &dyn std::fmt::Display| wrong(format!("cannot unpack {name} ({error})"));
    let file = archive.by_name(name).map_err(|error| failed(&error))?;
    let (len, packed_len) = (file.size(), file.compressed_size());
    // The ratio limit refuses no real file: `torch.save` does not compress.
    check_len("E-PICKLE-LIMIT", name, len, packed_len, MAX_MEMBER_LEN)?;
    let mut bytes = Vec::new();
    file.take(len)
        .read_to_end(&mut bytes)
        .map_err(|error| failed(&error))?;
    Ok(bytes)
}

/// Reads the storage from a file of `torch.save` that is nested in an ordinary pickle.
pub(crate) fn read_storage(bytes: &[u8]) -> Result<Storage, Error> {
    let legacy = Legacy::read(bytes)?;
    let Node::Storage(Storage {
        dtype,
        data: StorageData::Named(key),
    }) = legacy.machine.node(legacy.root)
    else {
        return Err(wrong("found a file without a storage"));
    };
    let data = legacy.storages.get(key);
    let data = data.ok_or_else(|| wrong("found a storage without bytes"))?;
    Ok(Storage {
        dtype: *dtype,
        data: StorageData::Present(data.clone()),
    })
}

struct Legacy<'a> {
    machine: Machine<'a>,
    root: u32,
    storages: BTreeMap<String, Arc<[u8]>>,
}

impl<'a> Legacy<'a> {
    fn read(bytes: &'a [u8]) -> Result<Self, Error> {
        let mut machine = Machine::new(bytes, Options::default());
        machine.outside_storages = true;
        for (what, expected) in [("number", LEGACY_MAGIC), ("version", LEGACY_VERSION)] {
            let id = machine.run()?;
            if !matches!(machine.node(id), Node::Leaf(Value::Int(found)) if *found == expected) {
                return Err(wrong(format!(
                    "found another {what} than {expected} at the start of a torch file"
                )));
            }
        }
        // Byte order and integer sizes of the machine that wrote the file.
        let system = machine.run()?;
        let system = machine.value(system, &BTreeMap::new())?;
        if system.get("little_endian") == Some(&Value::Bool(false)) {
            return Err(wrong("found a byte order other than little"));
        }
        let root = machine.run()?;
        let dtypes = machine.outside_storages();
        let keys = machine.run()?;
        let keys = machine.value(keys, &BTreeMap::new())?;
        let mut storages = BTreeMap::new();
        for key in keys.as_sequence().unwrap_or_default() {
            let key = key.as_str().unwrap_or_default();
            let dtype = dtypes
                .get(key)
                .ok_or_else(|| wrong(format!("found a storage {key:?} no tensor has")))?;
            let count = u64::from_le_bytes(machine.input.array()?);
            let len = count
                .checked_mul(dtype.item_len() as u64)
                .ok_or_else(|| wrong(format!("found a storage of {count} items")))?;
            storages.insert(key.to_owned(), machine.input.bytes(len)?.into());
        }
        Ok(Self {
            machine,
            root,
            storages,
        })
    }
}

fn wrong(reason: impl Into<String>) -> Error {
    Error::new("E-TORCH-FORMAT", reason)
}
