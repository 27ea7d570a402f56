//! Tables with one row for each clip: a shard of motions has shards of markers and features beside it.

use std::collections::BTreeSet;

use datasets_spec::dataset::ShardName;
use datasets_spec::manifest::FileEntry;
use datasets_spec::record::{
    CAPTION_BY_RULE, HumanMl3dRow, MarkerRow, MaskRow, MotionRow, PairRow, QuarantineRow,
    SkippedRow,
};
use datasets_spec::table::{Caption, PartCaption, Row, ShardReader, read_rows};
use datasets_spec::{Dataset, MotionId, Split, Transaction};

datasets_spec::table! {
    /// Columns of a clip besides its frames and labels. Markers without a motion lack the columns of motions.
    pub struct ClipFacts = "motions" {
        /// Id
        pub id: MotionId [""],
        /// Kind of source
        pub source: String ["", newer],
        /// Name of the source
        pub source_name: String ["", newer],
        /// Path of the source file
        pub source_path: String [""],
        /// BLAKE3 of the source file
        pub source_hash: String [""],
        /// BLAKE3 of all files that the clip was read from
        pub inputs_hash: String ["", newer],
        /// Id of the clip this one mirrors
        pub mirrored_of: Option<String> ["", newer],
        /// Stored frame rate
        pub fps: f32 ["1/s"],
        /// Stored frames
        pub n_frames: i32 ["frame"],
        /// BLAKE3 of the motion; empty for markers without a motion
        pub content_hash: String ["", newer],
        /// x of [`ClipFacts::centre`]
        pub centre_x: Option<f32> ["m", newer],
        /// y of [`ClipFacts::centre`]
        pub centre_y: Option<f32> ["m", newer],
        /// z of [`ClipFacts::centre`]
        pub centre_z: Option<f32> ["m", newer],
    }
}

datasets_spec::table! {
    /// Columns that describe a clip, as its source does.
    pub struct ClipWords = "motions" {
        /// Id
        pub id: MotionId [""],
        /// Descriptions
        pub captions: Vec<Caption> ["s"],
        /// Origins of the descriptions
        pub caption_origins: Vec<String> ["", newer],
        /// Descriptions of body parts
        pub part_captions: Vec<PartCaption> [""],
        /// Performer
        pub subject: Option<String> ["", newer],
        /// Action
        pub action: Option<String> [""],
        /// Style
        pub style: Option<String> [""],
    }
}

impl ClipWords {
    /// Names of the columns in which the source says something. Captions that a rule made of a name do not count.
    pub(crate) fn said(&self) -> BTreeSet<&'static str> {
        let made = self
            .caption_origins
            .iter()
            .filter(|origin| *origin == CAPTION_BY_RULE);
        let columns = [
            ("captions", made.count() < self.captions.len()),
            ("part_captions", !self.part_captions.is_empty()),
            ("subject", self.subject.is_some()),
            ("action", self.action.is_some()),
            ("style", self.style.is_some()),
        ];
        let said = columns.into_iter().filter(|(_, says)| *says);
        said.map(|(name, _)| name).collect()
    }
}

impl ClipFacts {
    pub(crate) fn centre(&self) -> Option<[f32; 3]> {
        Some([self.centre_x?, self.centre_y?, self.centre_z?])
    }
}

/// The clips of a dataset with their splits: all motions, then the markers without a motion.
pub(crate) fn clip_facts(
    dataset: &Dataset,
) -> Result<Vec<(Split, ClipFacts)>, datasets_spec::Error> {
    let mut clips = Vec::new();
    let mut met = BTreeSet::new();
    for table in [MotionRow::TABLE, MarkerRow::TABLE] {
        for (path, file) in dataset.files(table, None) {
            let split = file.split.unwrap_or(Split::Train);
            let mut rows: Vec<ClipFacts> = ShardReader::open(&path)?.rows()?;
            rows.retain(|row| met.insert(row.id.clone()));
            clips.extend(rows.into_iter().map(|row| (split, row)));
        }
    }
    Ok(clips)
}

pub(crate) const CLIP_TABLES: [&str; 3] = [MotionRow::TABLE, MarkerRow::TABLE, HumanMl3dRow::TABLE];

/// Whether a stage composes a table from motions, and so can make it again.
pub(crate) fn is_composed(table: &str) -> bool {
    let of_ingestion = [
        MaskRow::TABLE,
        PairRow::TABLE,
        QuarantineRow::TABLE,
        SkippedRow::TABLE,
    ];
    !CLIP_TABLES.contains(&table) && !of_ingestion.contains(&table)
}

pub(crate) fn clip_ids(
    table: &str,
    shard: &ShardReader,
) -> Result<Vec<MotionId>, datasets_spec::Error> {
    match table {
        MotionRow::TABLE => shard.column::<MotionRow, _>("id"),
        MarkerRow::TABLE => shard.column::<MarkerRow, _>("id"),
        _ => shard.column::<HumanMl3dRow, _>("id"),
    }
}

/// Borrows the facts of a file in the form that the writer takes.
pub(crate) fn borrowed(facts: &[(String, String)]) -> Vec<(&str, String)> {
    let facts = facts.iter();
    facts
        .map(|(key, value)| (key.as_str(), value.clone()))
        .collect()
}

/// Copies to a new file the clips for which `stays` returns the name of their source. Returns `None` if no clip stays.
pub(crate) fn rewrite<'a>(
    transaction: &Transaction,
    name: &ShardName,
    file: &FileEntry,
    facts: &[(&str, String)],
    stays: &dyn Fn(&MotionId) -> Option<&'a str>,
) -> Result<Option<FileEntry>, datasets_spec::Error> {
    match name.table {
        MotionRow::TABLE => rewrite_rows::<MotionRow>(transaction, name, file, facts, stays),
        MarkerRow::TABLE => rewrite_rows::<MarkerRow>(transaction, name, file, facts, stays),
        _ => rewrite_rows::<HumanMl3dRow>(transaction, name, file, facts, stays),
    }
}

fn rewrite_rows<'a, R: ClipRow>(
    transaction: &Transaction,
    name: &ShardName,
    file: &FileEntry,
    facts: &[(&str, String)],
    stays: &dyn Fn(&MotionId) -> Option<&'a str>,
) -> Result<Option<FileEntry>, datasets_spec::Error> {
    let mut rows: Vec<R> = read_rows(&transaction.root().join(&file.path))?;
    rows.retain_mut(|row| {
        let clip = row.of_clip();
        let source = stays(clip.id);
        // Files of older formats lack the name, so it is filled in.
        if let (Some(source), Some([name, _])) = (source, clip.source)
            && name.is_empty()
        {
            name.push_str(source);
        }
        source.is_some()
    });
    match rows.is_empty() {
        true => Ok(None),
        false => transaction.write_shard(name, &rows, facts).map(Some),
    }
}

/// Columns that a row has about its clip.
pub(crate) struct OfClip<'a> {
    pub(crate) id: &'a mut MotionId,
    pub(crate) split: &'a mut Split,
    /// Name of the source, and path of the file that the clip came from; `None` if the table lacks these columns.
    pub(crate) source: Option<[&'a mut String; 2]>,
    pub(crate) mirrored_of: Option<&'a mut String>,
}

/// A row that belongs to one clip.
pub(crate) trait ClipRow: Row {
    fn of_clip(&mut self) -> OfClip<'_>;
}

impl ClipRow for MotionRow {
    fn of_clip(&mut self) -> OfClip<'_> {
        OfClip {
            id: &mut self.id,
            split: &mut self.split,
            source: Some([&mut self.source_name, &mut self.source_path]),
            mirrored_of: self.mirrored_of.as_mut(),
        }
    }
}

impl ClipRow for MarkerRow {
    fn of_clip(&mut self) -> OfClip<'_> {
        OfClip {
            id: &mut self.id,
            split: &mut self.split,
            source: Some([&mut self.source_name, &mut self.source_path]),
            mirrored_of: None,
        }
    }
}

impl ClipRow for HumanMl3dRow {
    fn of_clip(&mut self) -> OfClip<'_> {
        OfClip {
            id: &mut self.id,
            split: &mut self.split,
            source: None,
            mirrored_of: None,
        }
    }
}
