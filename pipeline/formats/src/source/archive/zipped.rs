//! Zip archives: the directory at their end names the members.

use std::path::Path;
use std::sync::Arc;

use datasets_spec::store::{ByPath, Reader, Store};
use zip::{CompressionMethod, ZipArchive};

use super::content::{Content, DAMAGED, PACKING, too_large, unreadable};
use super::limits::Budget;
use super::members::{Member, ReadFrom};
use clip::{Rejected, rejected};

/// Lists a zip archive.
pub(super) fn content(path: &Path, mut budget: Budget) -> Result<Content, Rejected> {
    let file = ByPath.open_at(path).map_err(|error| unreadable(&error))?;
    let size = budget.size;
    let zip = ZipArchive::new(Reader::new(Arc::clone(&file))).map_err(|error| {
        rejected!(
            DAMAGED,
            "found no directory of a zip archive at the end of its {size} bytes ({error}); it is cut short or no zip"
        )
        .at(size as usize)
    })?;
    // Also those that are not read: each takes memory.
    let members = budget.allow(zip.len() as u64);
    members.map_err(|reason| too_large(reason, size))?;
    let mut content = Content::default();
    if zip.has_duplicate_names() {
        let reason = "the archive has several members of one name; the last one of each is read";
        content.skip(String::new(), reason);
    }
    for number in 0..zip.len() {
        let Ok(entry) = zip.by_index_data(number) else {
            continue;
        };
        if entry.is_dir() {
            continue;
        }
        let at = entry.header_start();
        let name = entry.name();
        let raw = name
            .as_ref()
            .map_or(entry.name_raw(), |name| name.as_bytes());
        let Some(name) = content.file_name(raw, at) else {
            continue;
        };
        if entry.is_symlink() {
            content.skip(name, "link in an archive, not followed");
            continue;
        }
        if entry.encrypted() {
            let reason =
                "it is encrypted; unpack the archive with its password and name the folder";
            content.refuse(&name, PACKING, reason, at);
            continue;
        }
        let method = entry.compression();
        if !matches!(
            method,
            CompressionMethod::Stored | CompressionMethod::Deflated
        ) {
            let reason = format!(
                "it is packed by {method}, which is not read; unpack the archive and name the folder"
            );
            content.refuse(&name, PACKING, reason, at);
            continue;
        }
        if at.saturating_add(entry.compressed_size()) > budget.size {
            let reason = "the archive ends before the member does; it is cut short";
            content.refuse(&name, DAMAGED, reason, at);
            continue;
        }
        let size = entry.size();
        budget.take(size).map_err(|reason| too_large(reason, at))?;
        content.add(name, Member::Zipped { number, size });
    }
    content.read_from = Some(ReadFrom::Zip(file, zip));
    Ok(content)
}

#[cfg(test)]
mod tests {
    use std::io::{Cursor, Write};

    use zip::ZipWriter;
    use zip::write::SimpleFileOptions;

    use super::super::content::LIMIT;
    use super::*;

    #[test]
    fn members_that_are_not_read_count_towards_the_limit() {
        let options = SimpleFileOptions::default();
        let mut writer = ZipWriter::new(Cursor::new(Vec::new()));
        for link in ["a", "b"] {
            writer
                .add_symlink(link, "walk.bvh", options)
                .expect("in memory");
        }
        writer
            .start_file("../walk.bvh", options)
            .expect("in memory");
        writer.write_all(b"HIERARCHY").expect("in memory");
        let bytes = writer.finish().expect("in memory").into_inner();
        let folder = tempfile::tempdir().expect("a temporary folder");
        testkit::put(folder.path(), "takes.zip", &bytes);
        let content_within = |max_members: u64| {
            let budget = Budget {
                max_members,
                ..Budget::new(bytes.len() as u64)
            };
            content(&folder.path().join("takes.zip"), budget)
        };
        let content = content_within(3).expect("within the limit");
        assert_eq!((content.special.len(), content.refused.len()), (2, 1));
        let rejected = content_within(2).expect_err("too many members");
        assert_eq!(rejected.code, LIMIT);
    }
}
