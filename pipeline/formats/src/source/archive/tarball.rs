//! Tar archives, uncompressed or compressed.

use std::cell::Cell;
use std::fs::File;
use std::io::{self, Read, Write};
use std::path::Path;
use std::sync::Arc;

use bzip2::read::MultiBzDecoder;
use datasets_spec::Progress;
use datasets_spec::store::{ByPath, Reader, Store};
use flate2::read::MultiGzDecoder;
use lzma_rust2::XzReader;
use tar::EntryType;

use super::content::{Content, DAMAGED, too_large, unreadable};
use super::ending::{Ending, UNMARKED};
use super::kind::Kind;
use super::limits::Budget;
use super::members::{Member, ReadFrom};
use super::scratch::{Scratch, no_room};
use super::unpacked::{Capped, Counting, Slice};
use crate::Error;
use clip::Rejected;

/// Maximum memory in KiB of an xz stream; the strongest preset needs 64 MiB.
const XZ_MEMORY_KIB: u32 = 128 << 10;
/// Bytes copied at once.
const COPIED: usize = 1 << 16;
/// Size of a tar's blocks.
const BLOCK: u64 = 512;

/// Lists a tar archive that is not packed.
pub(super) fn content(path: &Path, mut budget: Budget) -> Result<Content, Rejected> {
    let file = ByPath.open_at(path).map_err(|error| unreadable(&error))?;
    let mut content = Content::default();
    let is_at_end = Cell::new(false);
    let mut archive = tar::Archive::new(Ending {
        inner: Reader::new(Arc::clone(&file)),
        is_at_end: &is_at_end,
    });
    let entries = archive
        .entries_with_seek()
        .map_err(|error| unreadable(&error))?;
    // Expected offset of the next header.
    let mut end = 0;
    for entry in entries {
        let entry = match entry {
            Ok(entry) => entry,
            Err(error) => {
                content.refuse("", DAMAGED, broken(end, &error), end);
                return Ok(content);
            }
        };
        let (start, size) = (entry.raw_file_position(), entry.size());
        end = start.saturating_add(size.next_multiple_of(BLOCK));
        budget
            .take(size.min(budget.size))
            .map_err(|reason| too_large(reason, start))?;
        let Some(name) = file_name(&mut content, &entry) else {
            continue;
        };
        if start.saturating_add(size) > budget.size {
            // The archive is refused, not the member alone: members behind this one cannot be read either.
            let reason = format!(
                "it is cut short: it ends before its member {name} does; the members before this place are read"
            );
            content.refuse("", DAMAGED, reason, start);
            return Ok(content);
        }
        let file = Arc::clone(&file);
        content.add(name, Member::Range(Slice { file, start, size }));
    }
    if is_at_end.get() && end > 0 {
        content.refuse("", DAMAGED, UNMARKED, budget.size);
    }
    Ok(content)
}

/// The name of a member that is a file. Other members are noted.
fn file_name<R: Read>(content: &mut Content, entry: &tar::Entry<'_, R>) -> Option<String> {
    let kind = entry.header().entry_type();
    if matches!(kind, EntryType::Directory | EntryType::XGlobalHeader) {
        return None;
    }
    let name = content.file_name(&entry.path_bytes(), entry.raw_header_position())?;
    let reason = match kind {
        EntryType::Regular | EntryType::Continuous => return Some(name),
        EntryType::Symlink | EntryType::Link => "link in an archive, not followed",
        EntryType::GNUSparse => "file with holes in an archive, not read; unpack it",
        _ => "pipe or device in an archive",
    };
    content.skip(name, reason);
    None
}

/// Error message for a damaged archive.
fn broken(end: u64, error: &io::Error) -> String {
    match end {
        0 => format!("it is no tar archive, or damaged at its beginning ({error})"),
        _ => {
            format!("it is damaged or cut short ({error}); the members before this place are read")
        }
    }
}

/// Unpacks the bytes of a packed tar archive.
fn decoder<'a>(kind: Kind, packed: impl Read + 'a) -> Box<dyn Read + 'a> {
    match kind {
        Kind::Gzip => Box::new(MultiGzDecoder::new(packed)),
        Kind::Bzip2 => Box::new(MultiBzDecoder::new(packed)),
        Kind::Xz => Box::new(XzReader::new_mem_limit(packed, true, XZ_MEMORY_KIB)),
        Kind::Zip | Kind::Tar => Box::new(packed),
    }
}

/// Unpacks a packed tar archive into the scratch folder.
pub(super) fn unpack(
    path: &Path,
    kind: Kind,
    mut budget: Budget,
    scratch: &Arc<Scratch>,
    progress: &dyn Progress,
) -> Result<Result<Content, Rejected>, Error> {
    let packed = match ByPath.open(path) {
        Ok(packed) => packed,
        Err(error) => return Ok(Err(unreadable(&error))),
    };
    let (place, is_exceeded, is_at_end) = (Cell::new(0), Cell::new(false), Cell::new(false));
    let packed = Counting {
        inner: packed,
        count: &place,
        progress,
    };
    let (most, packed_size) = (budget.bytes_left(), budget.size);
    let mut content = Content {
        read_from: Some(ReadFrom::Scratch(Arc::clone(scratch))),
        ..Content::default()
    };
    // Headers count towards the limit too: their long names are read into memory.
    let unpacked = Capped {
        inner: decoder(kind, packed),
        left: most,
        is_exceeded: &is_exceeded,
    };
    let too_much = || {
        let reason = format!(
            "{packed_size} bytes unpack to more than {most} bytes; if its files are really so large, unpack it and \
             name the folder"
        );
        too_large(reason, place.get())
    };
    let cut_off = |mut content: Content, end: u64, error: &io::Error| {
        content.refuse("", DAMAGED, broken(end, error), place.get());
        Ok(Ok(content))
    };
    let mut archive = tar::Archive::new(Ending {
        inner: unpacked,
        is_at_end: &is_at_end,
    });
    let entries = match archive.entries() {
        Ok(entries) => entries,
        Err(error) => return Ok(Err(unreadable(&error))),
    };
    let mut is_first = true;
    for entry in entries {
        let mut entry = match entry {
            Ok(entry) => entry,
            Err(_) if is_exceeded.get() => return Ok(Err(too_much())),
            Err(error) if is_first => return cut_off(content, 0, &error),
            Err(error) => return cut_off(content, place.get(), &error),
        };
        is_first = false;
        let size = entry.size();
        if let Err(reason) = budget.take(size) {
            return Ok(Err(too_large(reason, place.get())));
        }
        let Some(name) = file_name(&mut content, &entry) else {
            continue;
        };
        let to = scratch.file()?;
        match copy(&mut entry, &to)? {
            Ok(copied) if copied == size => {
                content.add(name, Member::Unpacked { path: to, size });
            }
            _ if is_exceeded.get() => return Ok(Err(too_much())),
            copied => {
                let error = copied.err().unwrap_or(io::ErrorKind::UnexpectedEof.into());
                return cut_off(content, place.get().max(1), &error);
            }
        }
    }
    if is_at_end.get() && !is_first {
        content.refuse("", DAMAGED, UNMARKED, place.get());
    }
    Ok(Ok(content))
}

/// Copies a member to a file. The inner error is of reading the archive, the outer one of writing the file.
fn copy(from: &mut impl Read, to: &Path) -> Result<io::Result<u64>, Error> {
    let mut file = File::create_new(to).map_err(|error| no_room(to, &error))?;
    let mut buffer = vec![0; COPIED];
    let mut copied = 0;
    loop {
        let read = match from.read(&mut buffer) {
            Ok(0) => return Ok(Ok(copied)),
            Ok(read) => read,
            Err(error) if error.kind() == io::ErrorKind::Interrupted => continue,
            Err(error) => return Ok(Err(error)),
        };
        file.write_all(&buffer[..read])
            .map_err(|error| no_room(to, &error))?;
        copied += read as u64;
    }
}
