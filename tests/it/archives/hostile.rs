//! Archives that would fill the disk, leave their folder or are cut off.

use super::*;

/// Byte offset of the header of member `b_poses.npz` in a zip: 30 bytes before its name. Members are zips themselves,
/// so the signature of a header is ambiguous.
fn header_of_b(zip: &[u8]) -> usize {
    let name = b"b_poses.npz";
    let mut places = zip.windows(name.len());
    places.position(|bytes| bytes == name).expect("a member") - 30
}

/// Fills the folder `in` with archives that are damaged, encrypted, too large or nested too deep, or whose names lead
/// out of it.
fn put_hostile(place: &Place) {
    let good = place.walks(&["good_poses.npz"]);
    place.put("in/good.zip", zipped(&good));
    // Names that lead out of the archive.
    let names = ["../up_poses.npz", "/abs_poses.npz", "in_poses.npz"];
    place.put("in/climbs.tar", tarred(&place.walks(&names)));
    let names = ["a/../../up_poses.npz", "in_poses.npz"];
    place.put("in/climbs.zip", zipped(&place.walks(&names)));
    // A symbolic link and a device in a tar.
    let mut links = tar::Builder::new(Vec::new());
    for (kind, name) in [
        (tar::EntryType::Symlink, "link_poses.npz"),
        (tar::EntryType::Char, "device"),
    ] {
        let mut header = tar::Header::new_gnu();
        header.set_entry_type(kind);
        header.set_size(0);
        let added = links.append_link(&mut header, name, "/etc/passwd");
        added.expect("in memory");
    }
    place.put("in/links.tar", links.into_inner().expect("in memory"));
    // Cut short and altered.
    let two = place.walks(&["a_poses.npz", "b_poses.npz"]);
    let whole = zipped(&two);
    place.put("in/cut.zip", &whole[..whole.len() / 2]);
    let mut altered = whole.clone();
    altered[300] ^= 0x55;
    place.put("in/altered.zip", altered);
    let mut altered = whole.clone();
    altered[header_of_b(&whole) + 100] ^= 0x55;
    place.put("in/second.zip", altered);
    let tar = tarred(&two);
    place.put("in/cut.tar", &tar[..tar.len() * 2 / 3]);
    let gz = gzipped(&tar);
    place.put("in/cut.tar.gz", &gz[..gz.len() * 2 / 3]);
    let bz2 = bzipped(&tar);
    place.put("in/cut.tar.bz2", &bz2[..bz2.len() - 20]);
    place.put("in/no.tar.xz", "not an archive");
    place.put("in/empty.zip", "");
    // Encrypted: the flag in both headers.
    let mut encrypted = zipped(&good);
    for (magic, at) in [(&b"PK\x03\x04"[..], 6), (b"PK\x01\x02", 8)] {
        let mut places = encrypted.windows(4);
        let start = places.position(|bytes| bytes == magic);
        let start = start.expect("a header");
        encrypted[start + at] |= 1;
    }
    place.put("in/secret.zip", encrypted);
    // Bombs: small archives whose content exceeds the limits.
    let zeros: Files = [("zeros.bin".to_owned(), vec![0; 80 << 20])].into();
    let bomb = zipped(&zeros);
    assert!(bomb.len() < 1 << 20);
    place.put("in/bomb.zip", bomb);
    place.put("in/bomb.tar.bz2", bzipped(&tarred(&zeros)));
    // An archive in an archive is read; at one more level it is not.
    let inner: Files = [("inner.zip".to_owned(), zipped(&good))].into();
    place.put("in/outer.tar.gz", packed("outer.tar.gz", &inner));
    let outer: Files = [("outer.zip".to_owned(), zipped(&inner))].into();
    place.put("in/outmost.zip", zipped(&outer));
}

#[test]
fn hostile_archives_are_quarantined_and_the_rest_goes_on() {
    let place = Place::of_clips(2);
    put_hostile(&place);
    let done = place.ingest("in", "out", 3);
    let ids: BTreeSet<String> = place.clips("out", "").into_keys().collect();
    let expected = [
        "altered.zip/b",
        "climbs.tar/in",
        "climbs.zip/in",
        "cut.tar.bz2/a",
        "cut.tar.gz/a",
        "cut.tar/a",
        "good.zip/good",
        "outer.tar.gz/inner.zip/good",
        "second.zip/a",
    ];
    let expected: BTreeSet<String> = expected.iter().map(|id| format!("{id}_poses")).collect();
    assert_eq!(ids, expected, "{done}");
    let expected = [
        ("climbs.tar/../up_poses.npz", "E-ARCHIVE-NAME"),
        ("climbs.tar//abs_poses.npz", "E-ARCHIVE-NAME"),
        ("climbs.zip/a/../../up_poses.npz", "E-ARCHIVE-NAME"),
        ("cut.zip", "E-ARCHIVE-DAMAGED"),
        ("altered.zip/a_poses.npz", "E-ARCHIVE-DAMAGED"),
        ("second.zip/b_poses.npz", "E-ARCHIVE-DAMAGED"),
        ("cut.tar", "E-ARCHIVE-DAMAGED"),
        ("cut.tar.gz", "E-ARCHIVE-DAMAGED"),
        ("cut.tar.bz2", "E-ARCHIVE-DAMAGED"),
        ("no.tar.xz", "E-ARCHIVE-DAMAGED"),
        ("empty.zip", "E-ARCHIVE-DAMAGED"),
        ("secret.zip/good_poses.npz", "E-ARCHIVE-PACKING"),
        ("bomb.zip", "E-ARCHIVE-LIMIT"),
        ("bomb.tar.bz2", "E-ARCHIVE-LIMIT"),
        ("outmost.zip/outer.zip/inner.zip", "E-ARCHIVE-LIMIT"),
    ];
    let quarantine = assert_quarantined(&place.path("out"), &expected);
    for (path, row) in &quarantine {
        let is_placeless = path.contains("inner.zip");
        let has_place = row.byte_offset.is_some() || is_placeless;
        assert!(has_place, "{path}: {}", row.reason);
        // The content of a damaged member is unknown.
        let is_damaged_member = path.starts_with("altered.zip") || path.starts_with("second.zip");
        let is_hashed = !row.source_hash.is_empty();
        assert!(is_hashed || is_damaged_member || is_placeless, "{path}");
    }
    let second = fs::read(place.path("in/second.zip")).expect("read");
    let place_of_b = quarantine["second.zip/b_poses.npz"].byte_offset;
    assert_eq!(place_of_b, Some(header_of_b(&second) as u64));
    let skipped = skipped_of(&place.path("out"));
    let skipped: Vec<&String> = skipped.keys().collect();
    assert_eq!(skipped, ["links.tar/device", "links.tar/link_poses.npz"]);
    let again = place.ingest("in", "out", 3);
    assert_eq!(again["already_complete"], true, "{again}");
    // `doctor` reports them before any work.
    let doctor = place.clean("doctor @in", 0);
    let damaged = ["cut.zip", "bomb.tar.bz2", "secret.zip/good_poses.npz"];
    assert_has(&doctor.stdout, &damaged);
}
