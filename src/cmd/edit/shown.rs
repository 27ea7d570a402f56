//! One edited motion, written as a file or as a table.

use std::ops::Range;
use std::path::Path;

use anyhow::{Context, bail};
use datasets_spec::record::ItemRow;
use datasets_spec::{Motion, MotionId, Resample, Seed, Skeleton, Split};
use eval::draw::raster;
use eval::draw::strip::{self, Style};
use train::sample::TimedInstruction;
use train::system::{Edited, SystemIdentity};
use work::commit_edits;

use crate::global::Global;
use crate::local;

/// An edit of one motion, as it is written.
pub(super) struct Shown<'a> {
    pub(super) id: &'a str,
    pub(super) skeleton: &'a Skeleton,
    pub(super) original: &'a Motion,
    pub(super) edited: &'a Edited,
    pub(super) instructions: &'a [&'a TimedInstruction],
    pub(super) system: &'a SystemIdentity,
    pub(super) seed: Seed,
}

/// What is written for an edit, by the end of the path's name.
pub(super) enum Form {
    Amass,
    Bvh,
    Gltf,
    Strip,
    Png,
    Gif,
    Table,
}

impl Form {
    pub(super) fn of(out: &Path) -> anyhow::Result<Self> {
        Ok(
            match out.extension().and_then(|extension| extension.to_str()) {
                Some("npz") => Self::Amass,
                Some("bvh") => Self::Bvh,
                Some("glb") => Self::Gltf,
                Some("svg") => Self::Strip,
                Some("png") => Self::Png,
                Some("gif") => Self::Gif,
                None => Self::Table,
                Some(other) => bail!(
                    "{} ends in .{other}; known are .npz, .bvh, .glb, .svg, .png, .gif, and a folder",
                    out.display()
                ),
            },
        )
    }
}

impl Shown<'_> {
    /// The frames of the only instruction, if it is about some of the original.
    fn range(&self) -> Option<&Range<usize>> {
        match self.instructions {
            [only] if !self.is_whole(only) => Some(&only.frames),
            _ => None,
        }
    }

    /// Whether an instruction is about all frames. Later edits of a history change a motion of another length.
    fn is_whole(&self, asked: &TimedInstruction) -> bool {
        let lengths = [self.original.len(), self.edited.motion.len()];
        asked.frames.start == 0 && lengths.contains(&asked.frames.end)
    }

    /// The instructions as one text. Several of them have their frames with them.
    fn text(&self) -> String {
        let is_one = self.instructions.len() == 1;
        let asked = self.instructions.iter();
        let lines = asked.map(|asked| match is_one || self.is_whole(asked) {
            true => asked.text.clone(),
            false => format!("{}:{} {}", asked.frames.start, asked.frames.end, asked.text),
        });
        lines.collect::<Vec<_>>().join(" / ")
    }

    pub(super) fn write(&self, out: &Path, global: &Global) -> anyhow::Result<()> {
        let skeleton = self.skeleton;
        let (edited, text) = (&self.edited.motion, self.text());
        let rows = || {
            [
                strip::Row::new("original", self.original, skeleton),
                strip::Row::new(&text, edited, skeleton),
            ]
        };
        let style = Style::default();
        let bytes = match Form::of(out)? {
            Form::Amass => formats::write::amass::encode(edited, skeleton)?,
            Form::Bvh => formats::write::bvh::encode(edited, skeleton).into_bytes(),
            Form::Gltf => formats::write::gltf::encode(edited, skeleton)?,
            Form::Strip => strip::strip(&rows(), &style).into_bytes(),
            Form::Png => raster::png(&strip::strip(&rows(), &style), 2.0)?,
            Form::Gif => raster::gif(&rows(), 1.0)?,
            Form::Table => return self.table(out, skeleton, global),
        };
        local::write(out, &bytes)
    }

    /// Writes the original as an item without a target, and the edit of it, both at the edit's rate.
    fn table(&self, out: &Path, skeleton: &Skeleton, global: &Global) -> anyhow::Result<()> {
        let original = Resample::Exact.apply(self.original, self.edited.motion.fps())?;
        let text = self.text();
        let item = free_item(self.id, &text, self.range(), &original)?;
        let Edited { motion, misfit, .. } = self.edited;
        let edit = self.system.row(&item, motion, *misfit, self.seed);
        let plan = blake3::hash(format!("{} {text} {edit:?}", self.id).as_bytes());
        let holder = global.holder();
        commit_edits(out, &[item], &[edit], skeleton, &plan.to_hex(), &holder)?;
        Ok(())
    }
}

/// An item without a target, about these frames of the original or about all.
fn free_item(
    id: &str,
    text: &str,
    frames: Option<&Range<usize>>,
    original: &Motion,
) -> anyhow::Result<ItemRow> {
    // Histories of earlier versions have paths as ids. One that is no clip id is replaced by its hash.
    let source_id = MotionId::parse(id)
        .or_else(|_| MotionId::parse(&blake3::hash(id.as_bytes()).to_hex()))
        .context("a hash is an id")?;
    let mut item = ItemRow {
        task: "free".to_owned(),
        instruction: text.to_owned(),
        origin: format!("motion {id}"),
        ..ItemRow::blank(&source_id, Split::Test)
    };
    item.set_motions(original, None, None);
    if let Some(frames) = frames {
        item.edit_start = Some(i32::try_from(frames.start)?);
        item.edit_end = Some(i32::try_from(frames.end)?);
    }
    item.id = item.content_id();
    Ok(item)
}
