//! WebDataset: tar shards with members grouped by name, for streaming loaders.
//!
//! A clip is `KEY.transl.npy`, `KEY.global_orient.npy`, `KEY.body_pose.npy` and `KEY.json`. A key is
//! the clip's id with every character but letters, digits, `-` and `_` replaced by `%XX`, because a
//! dot ends a key and a slash makes a folder.

use std::fs::File;
use std::io::BufWriter;
use std::path::{Path, PathBuf};

use datasets_spec::record::MotionRow;
use datasets_spec::{Progress, Split};
use serde_json::json;

use super::Exported;
use crate::Error;
use crate::clips::Clips;
use pickle::npy;

const SHARD_CLIPS: usize = 1000;
const SHARD_BYTES: u64 = 256 << 20;
const MODE: u32 = 0o644;

/// Writes the shards of every split.
pub(super) fn write(
    clips: &Clips,
    folder: &Path,
    progress: &dyn Progress,
) -> Result<Exported, Error> {
    progress.begin("export webdataset", Some(clips.len()));
    for split in Split::ALL {
        let mut index = 0;
        let mut open: Option<Shard> = None;
        for shard in clips.shards(Some(split)) {
            for row in shard.read()? {
                open.take_if(|shard| shard.is_full())
                    .map_or(Ok(()), Shard::close)?;
                if open.is_none() {
                    let path = folder.join(format!("{split}-{index:06}.tar"));
                    open = Some(Shard::create(path)?);
                    index += 1;
                }
                if let Some(shard) = &mut open {
                    shard.append_clip(&row)?;
                }
                progress.advance(1);
            }
        }
        open.map_or(Ok(()), Shard::close)?;
    }
    progress.finish(&format!("{} clips", clips.len()));
    Ok(Exported::of(clips.len()))
}

struct Shard {
    path: PathBuf,
    tar: tar::Builder<BufWriter<File>>,
    clips: usize,
    bytes: u64,
}

impl Shard {
    fn create(path: PathBuf) -> Result<Self, Error> {
        let file = File::create(&path).map_err(datasets_spec::Error::io("create", &path))?;
        Ok(Self {
            path,
            tar: tar::Builder::new(BufWriter::new(file)),
            clips: 0,
            bytes: 0,
        })
    }

    fn is_full(&self) -> bool {
        self.clips >= SHARD_CLIPS || self.bytes >= SHARD_BYTES
    }

    fn append_clip(&mut self, row: &MotionRow) -> Result<(), Error> {
        let array =
            |frames: &[f32], width: usize| npy::encode(&[frames.len() / width, width], frames);
        let key = key(row.id.as_str());
        let orient = row.global_orient.as_flattened();
        for (name, bytes) in [
            ("transl.npy", array(row.transl.as_flattened(), 3)),
            ("global_orient.npy", array(orient, 3)),
            ("body_pose.npy", array(row.body_pose.as_flattened(), 63)),
            ("json", facts(row).to_string().into_bytes()),
        ] {
            self.append(&format!("{key}.{name}"), &bytes)?;
        }
        self.clips += 1;
        Ok(())
    }

    /// Appends a member with a reproducible header.
    fn append(&mut self, name: &str, bytes: &[u8]) -> Result<(), Error> {
        let mut header = tar::Header::new_gnu();
        header.set_size(bytes.len() as u64);
        header.set_mode(MODE);
        header.set_mtime(0);
        self.bytes += bytes.len() as u64;
        let appended = self.tar.append_data(&mut header, name, bytes);
        Ok(appended.map_err(datasets_spec::Error::io("write", &self.path))?)
    }

    fn close(self) -> Result<(), Error> {
        let buffer = self.tar.into_inner();
        let file =
            buffer.and_then(|buffer| buffer.into_inner().map_err(|error| error.into_error()));
        let file = file.map_err(datasets_spec::Error::io("write", &self.path))?;
        let synced = file.sync_all();
        Ok(synced.map_err(datasets_spec::Error::io("sync", &self.path))?)
    }
}

fn key(id: &str) -> String {
    id.bytes()
        .map(|byte| match byte {
            b'a'..=b'z' | b'A'..=b'Z' | b'0'..=b'9' | b'-' | b'_' => char::from(byte).to_string(),
            other => format!("%{other:02X}"),
        })
        .collect()
}

fn facts(row: &MotionRow) -> serde_json::Value {
    let captions: Vec<_> = row
        .captions_by_origin()
        .map(|(said, origin)| {
            let mut said = json!(said);
            said["origin"] = json!(origin);
            said
        })
        .collect();
    json!({
        "id": row.id.as_str(),
        "split": row.split.as_str(),
        "source": row.source,
        "fps": row.fps,
        "frames": row.n_frames,
        "skeleton": row.skeleton,
        "rotation_source": row.rotation_source,
        "fit_error_m": row.fit_error_m,
        "captions": captions,
        "parts": row.part_captions,
        "subject": row.subject,
        "action": row.action,
        "style": row.style,
        "license": row.license,
        "mirrored_of": row.mirrored_of,
        "content_hash": row.content_hash,
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn keys_have_no_dot_and_no_slash_and_stay_apart() {
        assert_eq!(key("000012"), "000012");
        assert_eq!(key("a/b.c"), "a%2Fb%2Ec");
        assert_ne!(key("a/b"), key("a_b"));
        assert!(!key("x.y/z~m@1-2").contains(['.', '/']));
    }
}
