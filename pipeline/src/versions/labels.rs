//! Labels of clips that are restored, changed or removed, and which of these labels people made.

use std::collections::BTreeMap;
use std::path::Path;

use datasets_spec::manifest::FileEntry;
use datasets_spec::record::{MaskRow, PairRow};
use datasets_spec::table::Row;
use datasets_spec::{Dataset, Skeleton, Split, Transaction};
use formats::source::format_named;
use serde::Serialize;

use crate::Error;
use crate::annotation::masks::is_derived;
use crate::annotation::pairs::{LISTED, is_from_labels};
use crate::ingest::LostLabel;

const SHOWN: usize = 5;

/// A label that stays.
#[derive(Clone, Debug, PartialEq, Eq, PartialOrd, Ord, Serialize)]
pub struct KeptLabel {
    /// The table: masks or pairs.
    pub table: String,
    /// Id of the row.
    pub id: String,
}

#[derive(Clone, Debug, Default, PartialEq)]
pub(crate) struct Labels {
    pub(crate) masks: BTreeMap<String, MaskRow>,
    pub(crate) pairs: BTreeMap<String, PairRow>,
}

impl Labels {
    pub(super) fn read(dataset: &Dataset) -> Result<Self, Error> {
        let (masks, pairs): (Vec<MaskRow>, Vec<PairRow>) =
            (dataset.read(None)?, dataset.read(None)?);
        Ok(Self {
            masks: masks.into_iter().map(|row| (row.id.clone(), row)).collect(),
            pairs: pairs.into_iter().map(|row| (row.id.clone(), row)).collect(),
        })
    }

    /// Writes the tables that differ from `before`. A table without rows has no files.
    pub(crate) fn write(
        &self,
        before: &Self,
        transaction: &Transaction,
        skeleton: &Skeleton,
        plan: &str,
    ) -> Result<BTreeMap<String, Vec<FileEntry>>, Error> {
        let stage = (transaction, skeleton, plan);
        let masks = changed([&self.masks, &before.masks], |row| row.split, stage)?;
        let pairs = changed([&self.pairs, &before.pairs], |row| row.split, stage)?;
        let tables = [(MaskRow::TABLE, masks), (PairRow::TABLE, pairs)].into_iter();
        Ok(tables
            .filter_map(|(table, files)| Some((table.to_owned(), files?)))
            .collect())
    }
}

/// Writes a table and returns its files; `None` if its rows equal those of `before`.
fn changed<R: Row + PartialEq>(
    [rows, before]: [&BTreeMap<String, R>; 2],
    split: fn(&R) -> Split,
    (transaction, skeleton, plan): (&Transaction, &Skeleton, &str),
) -> Result<Option<Vec<FileEntry>>, Error> {
    if rows == before {
        return Ok(None);
    }
    let rows: Vec<R> = rows.values().cloned().collect();
    Ok(Some(match rows.is_empty() {
        true => Vec::new(),
        false => transaction.write_rows(&rows, Some(split), skeleton, plan)?,
    }))
}

/// Whether a mask is made again when the source of its clip is read.
pub(crate) fn is_mask_of_source(mask: &MaskRow) -> bool {
    mask.text_origin == "imported" && format_named(&mask.author).is_some()
}

/// Whether a person made or judged a mask. A stage cannot derive such a mask again, and no source holds it.
pub(crate) fn is_mask_of_people(mask: &MaskRow) -> bool {
    let derived = mask.text_origin != "human" && is_derived(mask);
    !is_mask_of_source(mask) && !derived && mask.text_origin != "automatic"
}

/// Whether a pair is made again when the source of its target is read.
pub(crate) fn is_pair_of_source(pair: &PairRow) -> bool {
    format_named(&pair.source).is_some()
}

/// Whether a person made a pair; see [`is_mask_of_people`].
pub(crate) fn is_pair_of_people(pair: &PairRow) -> bool {
    !is_pair_of_source(pair) && !is_from_labels(pair)
}

/// Whether a person judged a pair. Pairs of lists are of people too, but nobody has judged them; the annotation tool of
/// earlier versions did not record who accepted a pair.
pub(crate) fn is_pair_judged(pair: &PairRow) -> bool {
    pair.accepted_by.is_some() || is_pair_of_people(pair) && pair.source != LISTED
}

/// Refuses to lose labels, unless that is allowed.
pub(crate) fn check_lost(root: &Path, lost: &[LostLabel], drop_labels: bool) -> Result<(), Error> {
    if drop_labels || lost.is_empty() {
        return Ok(());
    }
    let mut shown: Vec<String> = lost
        .iter()
        .take(SHOWN)
        .map(|label| format!("{} of {} ({})", label.id, label.table, label.reason))
        .collect();
    if lost.len() > SHOWN {
        shown.push("others".to_owned());
    }
    Err(Error::refused(format!(
        "{} labels in {} belong to clips that changed or went: {}; nothing was changed. Pass --drop-labels to go on \
         without them (the version before keeps them)",
        lost.len(),
        root.display(),
        shown.join(", ")
    )))
}
