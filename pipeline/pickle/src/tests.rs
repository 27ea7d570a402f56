use std::io::Write;
use std::sync::Arc;

use proptest::prelude::*;
use zip::write::SimpleFileOptions;

use super::fixture::{NUM_PICKLES, pickle};
use super::*;

fn code(bytes: &[u8]) -> &'static str {
    match read(bytes) {
        Ok(_) => "accepted",
        Err(error) => error.code,
    }
}

fn numbers(value: &Value, key: &str) -> Vec<f64> {
    let array = value.get(key).and_then(Value::as_array).expect(key);
    assert_eq!(array.shape(), [2, 3], "{key}");
    array.to_f64().expect("numbers")
}

#[test]
fn python_says_the_same_in_every_protocol() {
    for (name, bytes) in (0..NUM_PICKLES).map(pickle) {
        let value = read(&bytes).unwrap_or_else(|r| panic!("{name}: {r:?}"));
        let count: Vec<f64> = (0..6).map(f64::from).collect();
        assert_eq!(numbers(&value, "rots"), count, "{name}");
        assert_eq!(numbers(&value, "F"), count, "{name}");
        for (key, expected) in [
            ("text", Value::text("raise")),
            ("s", Value::Float(2.5)),
            ("n", Value::Int(-3)),
            ("big", Value::Int(1 << 70)),
            ("o", Value::Bytes(Arc::from([0, 255]))),
            ("set", Value::Set(vec![Value::Int(1)])),
            ("od", Value::Dict(vec![(Value::text("k"), Value::Int(1))])),
        ] {
            assert_eq!(value.get(key), Some(&expected), "{name} {key}");
        }
        let text = value.get("u").and_then(Value::as_array);
        let text = text.and_then(Array::to_text);
        assert_eq!(text, Some(vec!["ab".to_owned(), "c".to_owned()]), "{name}");
    }
}

#[test]
fn text_of_python_2_is_latin_1() {
    let quoted = b"(dp0\nS'caf\\xe9'\np1\nS\"it's\"\np2\nsV\\u20ac\np3\nI-7\ns.";
    let entries = vec![
        (Value::text("café"), Value::text("it's")),
        (Value::text("€"), Value::Int(-7)),
    ];
    assert_eq!(read(quoted), Ok(Value::Dict(entries)));
    assert_eq!(read(b"\x80\x02U\x02\xe9a."), Ok(Value::text("éa")));
    let items = vec![Value::Bool(true), Value::Float(2.5), Value::Int(12)];
    let list = read(b"(lp0\nI01\naF2.5\naL12L\na.");
    assert_eq!(list, Ok(Value::List(items)));
}

#[test]
fn what_would_be_code_is_refused_by_name_and_never_run() {
    let dir = tempfile::tempdir().expect("temporary folder");
    let canary = dir.path().join("canary");
    let path = canary.to_str().expect("a plain path");
    let refused = |name: &str, at: u64, bytes: &[u8]| {
        let error = read(bytes).expect_err(name);
        assert_eq!(error.code, "E-PICKLE-REFUSED", "{name}");
        assert!(error.reason.contains(name), "{}", error.reason);
        assert_eq!(error.byte_offset, Some(at), "{name}");
    };
    let stacked = {
        let mut bytes = b"\x80\x04\x8c\x02os\x8c\x06system\x93\x8c".to_vec();
        let command = format!("touch {path}");
        bytes.push(command.len() as u8);
        bytes.extend(command.as_bytes());
        bytes.extend(b"\x85R.");
        bytes
    };
    for name in [
        "os.system",
        "posix.system",
        "builtins.eval",
        "builtins.getattr",
        "copyreg._reconstructor",
        "numpy.core.multiarray.fromfile",
        "numpy.testing.measure",
        "torch.load",
    ] {
        let (module, function) = name.rsplit_once('.').expect("in a module");
        let call = format!("c{module}\n{function}\n(S'touch {path}'\ntR.");
        refused(name, 0, call.as_bytes());
    }
    refused("os.system", 14, &stacked);
    refused("os.system", 1, b"(ios\nsystem\n.");
    for bytes in [
        &b"(cnumpy\nndarray\no."[..],
        b"\x80\x02\x82\x01.",
        b"Pname\n.",
        b"(tQ.",
        b"\x80\x05\x97.",
        b"cnumpy\nndarray\n.",
        b"cnumpy.core.multiarray\n_reconstruct\n(cnumpy\ndtype\n(I0\ntS'b'\ntR.",
    ] {
        assert_eq!(code(bytes), "E-PICKLE-REFUSED", "{}", bytes.escape_ascii());
    }
    assert!(!canary.exists(), "nothing was run");
}

#[test]
fn lengths_and_shapes_are_not_believed() {
    let far = |op: u8| [&[0x80, 4, op][..], &u64::MAX.to_le_bytes(), b"abc."].concat();
    for op in [0x8d, 0x8e, 0x96] {
        assert_eq!(code(&far(op)), "E-PICKLE-TRUNCATED", "{op:#x}");
    }
    let lying = Array::from_f32(&[1, 3], [1.0, 2.0, 3.0]);
    let bytes = encode(&Value::Array(Arc::new(lying)));
    let mut places = bytes.windows(5);
    let shape_at = places.position(|window| window == b"K\x01K\x03t");
    let shape_at = shape_at.expect("the shape");
    let mut wide = bytes.clone();
    wide[shape_at + 1] = 200;
    assert_eq!(code(&wide), "E-PICKLE-SHAPE");
    let fields = b"cnumpy\ndtype\n(S'V8'\nI0\nI1\ntR.";
    assert_eq!(code(fields), "E-PICKLE-DTYPE");
    assert_eq!(code(b""), "E-PICKLE-TRUNCATED");
    assert_eq!(code(b"\x80\x09N."), "E-PICKLE-FORMAT");
    for malformed in [
        &b"."[..],
        b"a.",
        b"]a.",
        b"R.",
        b"(0.",
        b"h\x07.",
        b"\xff",
        b"}(Nu.",
        b"e.",
    ] {
        let shown = malformed.escape_ascii();
        assert_eq!(code(malformed), "E-PICKLE-FORMAT", "{shown}");
    }
}

#[test]
fn depth_cycles_and_sharing_are_bounded() {
    let nested = |depth: usize| {
        let mut bytes = vec![b']'; depth];
        bytes.extend(vec![b'a'; depth - 1]);
        bytes.push(b'.');
        bytes
    };
    assert_eq!(code(&nested(60)), "accepted");
    assert_eq!(code(&nested(100_000)), "E-PICKLE-LIMIT");
    let in_itself = b"\x80\x04]\x94h\x00a.";
    assert_eq!(code(in_itself), "E-PICKLE-LIMIT");
    let mut laughs = b"\x80\x04]\x94".to_vec();
    for level in 0..30u8 {
        laughs.extend([b'h', level, b'h', level, 0x86, 0x94]);
    }
    laughs.push(b'.');
    assert_eq!(code(&laughs), "E-PICKLE-LIMIT");
    let twice = read(b"\x80\x04](}\x94h\x00e.").expect("shared once");
    assert_eq!(twice, Value::List(vec![Value::Dict(vec![]); 2]));
}

/// The opcodes of a tuple.
fn tuple(items: &[&[u8]]) -> Vec<u8> {
    [b"(", items.concat().as_slice(), b"t"].concat()
}

fn text(text: &str) -> Vec<u8> {
    [&[0x8c, text.len() as u8], text.as_bytes()].concat()
}

/// A column-major tensor `[2, 2]` over the second to fifth number of the storage.
fn tensor(storage: &[u8]) -> Vec<u8> {
    let arguments = tuple(&[
        storage,
        b"K\x01",
        b"K\x02K\x02\x86",
        b"K\x01K\x02\x86",
        b"\x89",
        b"ccollections\nOrderedDict\n)R",
    ]);
    [
        b"ctorch._utils\n_rebuild_tensor_v2\n",
        arguments.as_slice(),
        b"R",
    ]
    .concat()
}

fn outside_storage() -> Vec<u8> {
    let name = tuple(&[
        &text("storage"),
        b"ctorch\nFloatStorage\n",
        &text("7"),
        &text("cpu"),
        b"K\x05",
    ]);
    [name.as_slice(), b"Q"].concat()
}

fn storage_bytes() -> Vec<u8> {
    (0..5).flat_map(|i| (i as f32).to_le_bytes()).collect()
}

fn legacy_file(object: &[u8]) -> Vec<u8> {
    let mut file = b"\x80\x02\x8a\x0al\xfc\x9cF\xf9 j\xa8P\x19.\x80\x02M\xe9\x03.".to_vec();
    file.extend(b"\x80\x04}");
    file.extend(text("little_endian"));
    file.extend(b"\x88s.\x80\x04");
    file.extend(object);
    file.extend(b".\x80\x04](");
    file.extend(text("7"));
    file.extend(b"e.");
    file.extend(5u64.to_le_bytes());
    file.extend(storage_bytes());
    file
}

fn zip_file(pickle: &[u8], storage: &[u8]) -> Vec<u8> {
    let options = SimpleFileOptions::default().compression_method(zip::CompressionMethod::Stored);
    let mut writer = zip::ZipWriter::new(std::io::Cursor::new(Vec::new()));
    for (name, content) in [
        ("archive/data.pkl", pickle),
        ("archive/byteorder", b"little"),
        ("archive/data/7", storage),
    ] {
        writer.start_file(name, options).expect("in memory");
        writer.write_all(content).expect("in memory");
    }
    writer.finish().expect("in memory").into_inner()
}

#[test]
fn tensors_are_read_from_every_container_of_torch() {
    let object = tensor(&outside_storage());
    let inner = legacy_file(&outside_storage());
    let within = {
        let mut call = b"ctorch.storage\n_load_from_bytes\n\x8e".to_vec();
        call.extend((inner.len() as u64).to_le_bytes());
        call.extend(&inner);
        call.extend(b"\x85R");
        [b"\x80\x04", tensor(&call).as_slice(), b"."].concat()
    };
    let pickle = [b"\x80\x02", object.as_slice(), b"."].concat();
    for (name, value) in [
        ("legacy", torch::read(&legacy_file(&object))),
        ("zip", torch::read(&zip_file(&pickle, &storage_bytes()))),
        ("pickle", read(&within)),
    ] {
        let value = value.unwrap_or_else(|r| panic!("{name}: {r:?}"));
        let array = value.as_array().expect(name);
        assert_eq!(array.shape(), [2, 2], "{name}");
        assert_eq!(array.to_f32(), Some(vec![1.0, 3.0, 2.0, 4.0]), "{name}");
    }
    let legacy = legacy_file(&object);
    let cut = legacy[..legacy.len() - 1].to_vec();
    for (file, code) in [
        (zip_file(&pickle, &[0; 16]), "E-PICKLE-SHAPE"),
        (b"\x80\x02N.".to_vec(), "E-TORCH-FORMAT"),
        (cut, "E-PICKLE-TRUNCATED"),
        (zip_file(b"cos\nsystem\n.", &[]), "E-PICKLE-REFUSED"),
        (zip_file(&pickle, &[])[..60].to_vec(), "E-TORCH-FORMAT"),
    ] {
        let error = torch::read(&file).expect_err(code);
        assert_eq!(error.code, code, "{}", error.reason);
    }
}

#[test]
fn attributes_of_an_ordered_dictionary_are_left_out() {
    // PyTorch's pickle of a state dict: entries, then `_metadata` as an attribute.
    let value = read(
        b"\x80\x02ccollections\nOrderedDict\n)R(X\x01\x00\x00\x00aK\x01u}X\x09\x00\x00\x00_metadata\
          ccollections\nOrderedDict\n)RX\x00\x00\x00\x00}X\x07\x00\x00\x00versionK\x01sssb.",
    )
    .expect("a dictionary");
    assert_eq!(value, Value::Dict(vec![(Value::text("a"), Value::Int(1))]));
}

#[test]
fn dropped_keys_and_single_precision_save_memory() {
    let (_, bytes) = pickle(2);
    let options = Options {
        drop_keys: &["rots"],
        single_precision: true,
    };
    let value = read_from(&bytes[..], &options).expect("valid");
    assert_eq!(value.get("rots"), Some(&Value::None));
    let kept = value.get("F").and_then(Value::as_array).expect("kept");
    assert_eq!(kept.dtype(), Dtype::Float(4));
    assert_eq!(kept.to_f64(), Some((0..6).map(f64::from).collect()));
}

fn flat_value() -> impl Strategy<Value = Value> {
    prop_oneof![
        Just(Value::None),
        any::<bool>().prop_map(Value::Bool),
        any::<i128>().prop_map(Value::Int),
        any::<i32>().prop_map(|number| Value::Int(number.into())),
        (-1e9..1e9).prop_map(Value::Float),
        any::<String>().prop_map(|text| Value::text(&text)),
        prop::collection::vec(any::<u8>(), 0..300).prop_map(|bytes| Value::Bytes(bytes.into())),
        prop::collection::vec(-1e3f32..1e3, 0..20)
            .prop_map(|v| Value::Array(Arc::new(Array::from_f32(&[v.len()], v.clone())))),
    ]
}

fn value() -> impl Strategy<Value = Value> {
    flat_value().prop_recursive(4, 40, 6, |inner| {
        prop_oneof![
            prop::collection::vec(inner.clone(), 0..6).prop_map(Value::List),
            prop::collection::vec(inner.clone(), 0..6).prop_map(Value::Tuple),
            prop::collection::vec((inner.clone(), inner), 0..6).prop_map(Value::Dict),
        ]
    })
}

proptest! {
    #[test]
    fn what_is_written_is_read_back(value in value()) {
        prop_assert_eq!(read(&encode(&value)), Ok(value));
    }

    #[test]
    fn no_bytes_make_it_panic(
        bytes in prop::collection::vec(any::<u8>(), 0..200),
        which in 0..5usize,
        edits in prop::collection::vec((any::<prop::sample::Index>(), any::<u8>()), 1..8),
        cut in any::<prop::sample::Index>(),
    ) {
        let object = tensor(&outside_storage());
        let valid = match which {
            0 => legacy_file(&object),
            1 => zip_file(&[b"\x80\x02", object.as_slice(), b"."].concat(), &storage_bytes()),
            which => pickle(which - 2).1,
        };
        let mut mutated = valid.clone();
        for (at, byte) in edits {
            let at = at.index(mutated.len());
            mutated[at] = byte;
        }
        for candidate in [&bytes[..], &mutated, &valid[..cut.index(valid.len())]] {
            for read in [read(candidate), torch::read(candidate)] {
                if let Err(error) = read {
                    prop_assert!(error.code.starts_with("E-"), "{:?}", error);
                }
            }
        }
    }
}
