//! A submission to a leaderboard: the answers of one system to a set of items, in one zip.
//!
//! A bundle holds [`ANSWERS`], the rows of table `edits`; [`FACTS`], the items and the system of these answers; and a
//! card for people. It holds no items: the evaluator has them, and a digest in the facts identifies them.

use std::borrow::Cow;
use std::collections::{BTreeMap, BTreeSet};
use std::io::{Cursor, Read, Seek, Write};
use std::path::Path;

use clip::Rejected;
use compose::digest_of_ids;
use datasets_spec::record::{EditRow, ItemRow};
use datasets_spec::store::{ByPath, Store};
use datasets_spec::table::{Row, write_rows};
use datasets_spec::{Motion, Skeleton};
use formats::foreign_table;
use serde::{Deserialize, Serialize};
use zip::write::SimpleFileOptions;
use zip::{CompressionMethod, DateTime, System, ZipArchive, ZipWriter};

use crate::Error;

/// Member with the answers, a Parquet file.
pub const ANSWERS: &str = "answers.parquet";
/// Member with the facts, as JSON.
pub const FACTS: &str = "bundle.json";
/// Member with the card.
pub const CARD: &str = "README.md";
/// Version of the layout. Version 1 does not state the novelty of the items.
const FORMAT: u32 = 2;
/// Maximum bytes of the facts and of the card: the novelty of an item takes some 60 bytes.
const MAX_TEXT_LEN: u64 = 1 << 24;
/// Maximum bytes of the answers, packed and unpacked: ten thousand answers of ten seconds take 0.6 GB.
const MAX_ANSWERS_LEN: u64 = 4 << 30;
const BATCH_ROWS: usize = 64;

/// Description of a bundle in its `bundle.json`.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct BundleFacts {
    /// Version of the layout.
    pub format: u32,
    /// Name of the system.
    pub system: String,
    /// BLAKE3 of its checkpoint, hexadecimal; empty if no model took part.
    pub checkpoint_hash: String,
    /// Settings of the system.
    pub settings: serde_json::Map<String, serde_json::Value>,
    /// Licence of the answers: an SPDX identifier or expression.
    pub license: String,
    /// Digest of the ids of the items.
    pub item_hash: String,
    /// Number of items.
    pub items: usize,
    /// Novelty of the items by their ids, which do not cover it; without those whose novelty is not known. `None` in
    /// bundles of version 1.
    pub novelty: Option<BTreeMap<String, String>>,
    /// Number of answers to each item.
    pub takes: usize,
    /// Hash of the encoder that scores the answers, hexadecimal; `None` if any encoder may.
    pub judge_hash: Option<String>,
    /// Name of the skeleton.
    pub skeleton: String,
    /// BLAKE3 of [`ANSWERS`], hexadecimal.
    pub answers_hash: String,
}

/// The frame rate and the novelty of each item by its id.
pub type Asked<'a> = BTreeMap<&'a str, (f32, Option<&'a str>)>;

/// A bundle that was checked against its items.
#[derive(Clone, Debug)]
pub struct Bundle {
    /// Description of the bundle.
    pub facts: BundleFacts,
    /// The answers, by item, then by seed.
    pub rows: Vec<EditRow>,
}

impl Bundle {
    /// Makes a bundle of `rows`, the answers of one system to all items.
    ///
    /// # Errors
    /// The answers are of several systems or break a rule of [`Bundle::read`]. The error names `path`.
    pub fn new(
        path: &Path,
        mut rows: Vec<EditRow>,
        items: &[ItemRow],
        skeleton: &Skeleton,
        license: &str,
        judge_hash: Option<String>,
    ) -> Result<Self, Error> {
        let refused = |problem: String| refused(path, problem);
        let systems: BTreeSet<&str> = rows.iter().map(|row| row.system.as_str()).collect();
        let systems = Vec::from_iter(systems);
        let [system] = systems[..] else {
            return Err(refused(format!(
                "it holds answers of {} systems ({}), and a bundle is of one",
                systems.len(),
                systems.join(", ")
            )));
        };
        let first = rows.first().expect("there is a system");
        let settings = settings_of(first)
            .map_err(|error| refused(format!("its settings are no JSON object: {error}")))?;
        let asked: Asked<'_> = items
            .iter()
            .map(|item| (&*item.id, (item.fps, item.novelty.as_deref())))
            .collect();
        let novelty = asked
            .iter()
            .filter_map(|(id, (_, novelty))| Some(((*id).to_owned(), (*novelty)?.to_owned())));
        let mut facts = BundleFacts {
            format: FORMAT,
            system: system.to_owned(),
            checkpoint_hash: first.checkpoint_hash.clone(),
            settings,
            license: license.to_owned(),
            item_hash: digest_of_ids(asked.keys().copied()),
            items: items.len(),
            novelty: Some(novelty.collect()),
            takes: 0,
            judge_hash,
            skeleton: skeleton.name().to_owned(),
            answers_hash: String::new(),
        };
        rows.sort_by(|a, b| (&a.id, a.seed).cmp(&(&b.id, b.seed)));
        let of_items = rows.chunk_by(|a, b| a.id == b.id).map(<[EditRow]>::len);
        facts.takes = of_items.max().unwrap_or(0);
        let mut bundle = Self { facts, rows };
        bundle.check(&asked, skeleton).map_err(refused)?;
        bundle.facts.answers_hash = hash(&bundle.answers()?);
        Ok(bundle)
    }

    /// Reads a bundle and checks it. It must hold its files and no others, and state this skeleton, these items and
    /// their novelties. Every item must have the same number of answers, all of one system, each a finite motion of at
    /// least three frames at the item's rate.
    ///
    /// # Errors
    /// The bundle breaks one of these rules. The error names the bundle, and the item if it concerns one.
    pub fn read(path: &Path, items: &Asked<'_>, skeleton: &Skeleton) -> Result<Self, Error> {
        let refused = |problem: String| refused(path, problem);
        let file = ByPath
            .read(path)
            .map_err(|error| refused(format!("it cannot be read: {error}")))?;
        let mut zip = ZipArchive::new(Cursor::new(file))
            .map_err(|error| refused(format!("it is no zip archive, or cut short ({error})")))?;
        let found: BTreeSet<String> = zip
            .file_names()
            .map(|name| name.map_or_else(|_| "a name that is no text".to_owned(), Cow::into_owned))
            .collect();
        let expected = [ANSWERS, FACTS, CARD].map(str::to_owned);
        let expected = BTreeSet::from(expected);
        if found != expected || zip.len() != expected.len() {
            let found = Vec::from_iter(found).join(", ");
            return Err(refused(format!(
                "it holds {} members ({found}), expected {FACTS}, {ANSWERS} and {CARD}; `stance edits bundle` makes \
                 bundles",
                zip.len()
            )));
        }
        let facts = member(&mut zip, FACTS, MAX_TEXT_LEN).map_err(refused)?;
        let facts: BundleFacts = serde_json::from_slice(&facts)
            .map_err(|error| refused(format!("{FACTS} is not understood: {error}")))?;
        if !(1..=FORMAT).contains(&facts.format) {
            return Err(refused(format!(
                "{FACTS} is of format {}, and this program reads formats 1 to {FORMAT}",
                facts.format
            )));
        }
        member(&mut zip, CARD, MAX_TEXT_LEN).map_err(refused)?;
        let answers = member(&mut zip, ANSWERS, MAX_ANSWERS_LEN).map_err(refused)?;
        if hash(&answers) != facts.answers_hash {
            return Err(refused(format!(
                "{ANSWERS} has another hash than {FACTS} says: it was changed or damaged"
            )));
        }
        let rows = decode(answers)
            .map_err(|rejected| refused(format!("{ANSWERS}: {}", rejected.reason)))?;
        let bundle = Self { facts, rows };
        bundle.check(items, skeleton).map_err(refused)?;
        Ok(bundle)
    }

    /// The bytes of the zip. Equal bundles have equal bytes.
    ///
    /// # Errors
    /// The rows cannot be encoded, or exceed what a zip holds.
    pub fn to_zip(&self) -> Result<Vec<u8>, Error> {
        let mut facts = serde_json::to_vec_pretty(&self.facts).expect("text and numbers serialise");
        facts.push(b'\n');
        let mut zip = ZipWriter::new(Cursor::new(Vec::new()));
        // Stored, not compressed: the output of compressors may depend on the processor, and Parquet is compressed
        // already.
        let options = SimpleFileOptions::default()
            .compression_method(CompressionMethod::Stored)
            .last_modified_time(DateTime::default())
            .system(System::Unix);
        let write = |zip: &mut ZipWriter<_>, name: &str, bytes: &[u8]| -> std::io::Result<()> {
            zip.start_file(name, options)?;
            zip.write_all(bytes)
        };
        let (answers, card) = (self.answers()?, self.card());
        let members: [(&str, &[u8]); 3] = [
            (FACTS, &facts),
            (ANSWERS, &answers),
            (CARD, card.as_bytes()),
        ];
        let packed = members
            .into_iter()
            .try_for_each(|(name, bytes)| write(&mut zip, name, bytes))
            .and_then(|()| Ok(zip.finish()?.into_inner()));
        packed.map_err(|error| refused(Path::new(&self.facts.system), error.to_string()))
    }

    fn answers(&self) -> Result<Vec<u8>, Error> {
        let facts = [("skeleton", self.facts.skeleton.clone())];
        Ok(write_rows(
            Vec::new(),
            Path::new(ANSWERS),
            &self.rows,
            &facts,
        )?)
    }

    fn card(&self) -> String {
        let BundleFacts {
            system,
            checkpoint_hash,
            settings,
            license,
            item_hash,
            items,
            takes,
            judge_hash,
            skeleton,
            ..
        } = &self.facts;
        let or = |text: &str, without: &str| match text {
            "" => without.to_owned(),
            text => format!("`{text}`"),
        };
        let settings = serde_json::to_string_pretty(settings).expect("text and numbers serialise");
        format!(
            "# {system}\n\n\
             Answers to {items} items, {takes} each, to be scored by `stance eval`.\n\n\
             | | |\n|---|---|\n\
             | items | `{item_hash}` |\n\
             | judge | {} |\n\
             | checkpoint | {} |\n\
             | skeleton | {skeleton} |\n\
             | licence | {license} |\n\n\
             Settings:\n\n```json\n{settings}\n```\n",
            or(judge_hash.as_deref().unwrap_or(""), "any"),
            or(checkpoint_hash, "no model"),
        )
    }

    /// Checks the answers against the items. The error does not name the path.
    fn check(&self, items: &Asked<'_>, skeleton: &Skeleton) -> Result<(), String> {
        let facts = &self.facts;
        let digest = digest_of_ids(items.keys().copied());
        if facts.item_hash != digest {
            return Err(format!(
                "it answers the items {}, and these are {digest}; draw the items that it answers",
                facts.item_hash
            ));
        }
        if let Some(stated) = &facts.novelty {
            for (id, (_, own)) in items {
                let [stated, own] = [stated.get(*id).map(String::as_str), *own]
                    .map(|novelty| novelty.unwrap_or("not known"));
                if stated != own {
                    return Err(format!(
                        "its items state the novelty of item {id} as {stated}, and these as {own}: they were drawn from \
                         other datasets or by other versions of this program; score it on the items that it was made with"
                    ));
                }
            }
        }
        if facts.skeleton != skeleton.name() {
            return Err(format!(
                "its motions are on the skeleton {}, and the items on {}",
                facts.skeleton,
                skeleton.name()
            ));
        }
        if facts.system.trim().is_empty() || facts.license.trim().is_empty() {
            return Err("it names no system or no licence".to_owned());
        }
        let mut takes: BTreeMap<&str, BTreeSet<u64>> = BTreeMap::new();
        let first = self.rows.first();
        for row in &self.rows {
            let Some(&(fps, _)) = items.get(row.id.as_str()) else {
                return Err(format!(
                    "it answers {:?}, which is none of the items",
                    row.id
                ));
            };
            self.check_answer(row, first.unwrap_or(row), fps)
                .map_err(|problem| format!("the answer to item {}: {problem}", row.id))?;
            if !takes.entry(&row.id).or_default().insert(row.seed) {
                return Err(format!(
                    "it has two answers to item {} of seed {}",
                    row.id, row.seed
                ));
            }
        }
        for id in items.keys() {
            let found = takes.get(id).map_or(0, BTreeSet::len);
            if found == 0 || found != facts.takes {
                return Err(format!(
                    "item {id} has {found} answers, expected {}; answer each item as often as the others",
                    facts.takes
                ));
            }
        }
        Ok(())
    }

    fn check_answer(&self, row: &EditRow, first: &EditRow, fps: f32) -> Result<(), String> {
        let facts = &self.facts;
        if row.system != facts.system || row.checkpoint_hash != facts.checkpoint_hash {
            return Err(format!(
                "it is of {:?} with checkpoint {:.12}, and the bundle of {:?} with {:.12}",
                row.system, row.checkpoint_hash, facts.system, facts.checkpoint_hash
            ));
        }
        let settings = settings_of(row).map_err(|error| error.to_string())?;
        if settings != facts.settings || row.settings_hash != first.settings_hash {
            return Err("it was made with other settings than the bundle says".to_owned());
        }
        if row.fps != fps {
            return Err(format!(
                "it has {} frames a second, and the item {fps}",
                row.fps
            ));
        }
        let motion: Motion = row.motion().map_err(|error| error.to_string())?;
        if usize::try_from(row.n_frames) != Ok(motion.len()) || motion.len() < EditRow::MIN_FRAMES {
            return Err(format!(
                "it has {} frames and says {}; at least {} are needed",
                motion.len(),
                row.n_frames,
                EditRow::MIN_FRAMES
            ));
        }
        Ok(())
    }
}

/// The settings of the system of an answer; empty if the answer states none.
fn settings_of(row: &EditRow) -> serde_json::Result<serde_json::Map<String, serde_json::Value>> {
    match row.settings.as_str() {
        "" => Ok(serde_json::Map::new()),
        text => serde_json::from_str(text),
    }
}

fn refused(path: &Path, problem: String) -> Error {
    Error::refused(format!("{}: {problem}", path.display()))
}

fn hash(bytes: &[u8]) -> String {
    blake3::hash(bytes).to_hex().to_string()
}

/// Reads a member; an error if it is larger than `limit` bytes.
fn member<R: Read + Seek>(
    zip: &mut ZipArchive<R>,
    name: &str,
    limit: u64,
) -> Result<Vec<u8>, String> {
    let damaged = |error: String| format!("{name} cannot be read: {error}");
    let member = zip
        .by_name(name)
        .map_err(|error| damaged(error.to_string()))?;
    let mut bytes = Vec::new();
    member
        .take(limit + 1)
        .read_to_end(&mut bytes)
        .map_err(|error| damaged(error.to_string()))?;
    if bytes.len() as u64 > limit {
        return Err(format!("{name} has more than {limit} bytes"));
    }
    Ok(bytes)
}

fn decode(bytes: Vec<u8>) -> Result<Vec<EditRow>, Rejected> {
    foreign_table::read(bytes, |table| {
        let columns = EditRow::columns();
        let names: Vec<&str> = columns.iter().map(|column| column.name).collect();
        let mut rows = Vec::new();
        let limit = i64::try_from(MAX_ANSWERS_LEN).expect("a small number");
        table.for_each(&names, limit, BATCH_ROWS, &mut |batch| {
            let decoded = EditRow::decode(batch)
                .map_err(|error| Rejected::read("E-TABLE-COLUMNS", error.to_string()))?;
            rows.extend(decoded);
            Ok(())
        })?;
        Ok(rows)
    })
}
