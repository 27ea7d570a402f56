//! Paraphrases of accepted instructions: proposed by a language model, judged by a reviewer.

use std::collections::{BTreeMap, BTreeSet};

use super::db::{Row, Tx, params};
use super::entry::{Body, Entry};
use super::log;
use super::records::Millis;
use crate::Error;
use crate::wire::{
    Code, JudgeParaphrase, MAX_TEXT_CHARS, Paraphrase, ParaphraseState, Paraphrases,
};

const COLUMNS: &str = "p.id, p.instruction, p.text, p.model, p.state, p.judge, p.at";

fn read(row: &Row) -> Result<Paraphrase, Error> {
    let state = row.text(4)?;
    Ok(Paraphrase {
        id: row.int(0)?,
        instruction: row.string(1)?,
        text: row.string(2)?,
        model: row.string(3)?,
        state: ParaphraseState::parse(state).ok_or_else(|| Error::Row {
            table: "paraphrase",
            problem: format!("state {state:?} is not known"),
        })?,
        judge: row.opt_int(5)?,
        at: row.int(6)?,
    })
}

/// Instructions that have paraphrases.
pub(super) fn paraphrased(tx: &mut dyn Tx) -> Result<BTreeSet<String>, Error> {
    tx.query("SELECT DISTINCT instruction FROM paraphrase", &[])?
        .iter()
        .map(|row| row.string(0))
        .collect()
}

/// Stores the paraphrases of an instruction that are not stored yet, and returns how many those were.
pub(super) fn put(
    tx: &mut dyn Tx,
    instruction: &str,
    texts: &[String],
    model: &str,
    prompt_hash: &str,
    now: Millis,
) -> Result<usize, Error> {
    let mut new = 0;
    for text in texts.iter().filter(|text| *text != instruction) {
        let id = 1 + tx.number("SELECT COALESCE(MAX(id), 0) FROM paraphrase", &[])?;
        new += tx.execute(
            "INSERT INTO paraphrase (id, instruction, text, model, prompt_hash, state, judge, at)
             VALUES (?1, ?2, ?3, ?4, ?5, 'proposed', NULL, ?6) ON CONFLICT (instruction, text) DO NOTHING",
            params![id, instruction, text, model, prompt_hash, now],
        )?;
    }
    Ok(usize::try_from(new).unwrap_or(0))
}

/// Paraphrases of a state, in the order they were proposed, after an id.
pub(super) fn page(
    tx: &mut dyn Tx,
    state: ParaphraseState,
    after: i64,
    limit: usize,
) -> Result<Paraphrases, Error> {
    let sql = format!(
        "SELECT {COLUMNS} FROM paraphrase p WHERE p.state = ?1 AND p.id > ?2 ORDER BY p.id LIMIT ?3"
    );
    let items: Vec<Paraphrase> = tx
        .query(&sql, params![state.as_str(), after, limit as i64])?
        .iter()
        .map(read)
        .collect::<Result<_, _>>()?;
    Ok(Paraphrases {
        next: (items.len() == limit)
            .then(|| items.last().map(|item| item.id))
            .flatten(),
        waiting: tx.number(
            "SELECT COUNT(*) FROM paraphrase WHERE state = 'proposed'",
            &[],
        )?,
        items,
    })
}

/// Applies a reviewer's judgement, which can be changed later, and taken back by the same reviewer.
pub(super) fn judge(
    tx: &mut dyn Tx,
    user: i64,
    id: i64,
    judgement: &JudgeParaphrase,
    now: Millis,
) -> Result<Paraphrase, Error> {
    let sql = format!("SELECT {COLUMNS} FROM paraphrase p WHERE p.id = ?1");
    let row = tx.one(&sql, params![id])?;
    let before = read(&row.ok_or_else(|| Error::not_found("paraphrase"))?)?;
    if judgement.was.is_some_and(|was| was != before.state) {
        return Err(Error::refused(
            Code::WrongState,
            format!(
                "somebody else judged this paraphrase meanwhile: it is {}; reload the page",
                before.state.as_str()
            ),
        ));
    }
    if judgement.accept.is_none() && before.judge != Some(user) {
        return Err(Error::refused(
            Code::WrongState,
            "this judgement is not yours to take back; judge the paraphrase anew instead",
        ));
    }
    let text = judgement
        .text
        .as_deref()
        .map_or(before.text.as_str(), str::trim)
        .to_owned();
    if text.is_empty() || text.chars().count() > MAX_TEXT_CHARS {
        return Err(Error::invalid(
            "text",
            format!("a paraphrase has 1 to {MAX_TEXT_CHARS} characters"),
        ));
    }
    let taken = tx.number(
        "SELECT COUNT(*) FROM paraphrase WHERE instruction = ?1 AND text = ?2 AND id <> ?3",
        params![&before.instruction, &text, id],
    )?;
    if taken > 0 || text == before.instruction {
        return Err(Error::invalid(
            "text",
            "this wording is there already; reject one of the two",
        ));
    }
    let (state, judge) = match judgement.accept {
        Some(true) => (ParaphraseState::Accepted, Some(user)),
        Some(false) => (ParaphraseState::Rejected, Some(user)),
        None => (ParaphraseState::Proposed, None),
    };
    tx.execute(
        "UPDATE paraphrase SET text = ?2, state = ?3, judge = ?4, at = ?5 WHERE id = ?1",
        params![id, &text, state.as_str(), judge, now],
    )?;
    let entry = Entry {
        at: now,
        actor: Some(user),
        task: None,
        epoch: None,
        body: Body::ParaphraseJudged {
            paraphrase: id,
            instruction: before.instruction.clone(),
            proposed: before.text,
            text: text.clone(),
            accepted: judgement.accept,
        },
    };
    log::note(tx, &entry)?;
    Ok(Paraphrase {
        text,
        state,
        judge,
        at: now,
        ..Paraphrase {
            text: String::new(),
            ..before
        }
    })
}

/// Accepted paraphrases by their instructions.
pub(super) fn accepted(tx: &mut dyn Tx) -> Result<BTreeMap<String, Vec<String>>, Error> {
    let mut all: BTreeMap<String, Vec<String>> = BTreeMap::new();
    for row in tx.query(
        "SELECT instruction, text FROM paraphrase WHERE state = 'accepted' ORDER BY id",
        &[],
    )? {
        all.entry(row.string(0)?).or_default().push(row.string(1)?);
    }
    Ok(all)
}
