//! Filters of tasks, as conditions in SQL.

use std::collections::BTreeSet;
use std::str::FromStr;

use super::db::{Result, ToSql};
use super::settings::has_up_to;
use crate::answer::check_text;
use crate::error::{Error, require};
use crate::wire::{SkipFilter, TaskFilter};

/// Parameters of a query under construction.
#[derive(Default)]
pub(super) struct Values(Vec<Box<dyn ToSql + Send + Sync>>);

impl Values {
    /// Adds a value and returns its placeholder in the query.
    pub(super) fn put(&mut self, value: impl ToSql + Send + Sync + 'static) -> String {
        self.0.push(Box::new(value));
        format!("?{}", self.0.len())
    }

    /// All values, for the query.
    pub(super) fn all(&self) -> Vec<&dyn ToSql> {
        let all = self.0.iter();
        all.map(|value| &**value as &dyn ToSql).collect()
    }

    /// ` AND column = value` for a `WHERE`; empty without a value.
    pub(super) fn equal(
        &mut self,
        column: &str,
        value: Option<impl ToSql + Send + Sync + 'static>,
    ) -> String {
        value.map_or(String::new(), |value| {
            format!(" AND {column} = {}", self.put(value))
        })
    }
}

/// The SQL condition of a filter on task `t`.
pub(super) fn condition(filter: &TaskFilter, values: &mut Values) -> String {
    let mut equal = "t.gold IS NULL".to_owned();
    equal += &values.equal("t.kind", filter.kind);
    equal += &values.equal("t.state", filter.state);
    equal += &values.equal("t.category", filter.category.clone());
    // As in the columns of a task, the split that its first motion has now.
    let split = "COALESCE((SELECT m.split FROM motion m WHERE m.hash = t.source), t.split)";
    equal += &values.equal(split, filter.split.clone());
    equal += &values.equal("t.id", filter.task);
    let mut all = vec![equal];
    if let Some(person) = filter.person {
        let who = values.put(person);
        all.push(format!(
            "t.id IN (SELECT task FROM revision WHERE author = {who} AND state <> 'draft'
               UNION SELECT task FROM lease WHERE usr = {who} UNION SELECT task FROM skip WHERE usr = {who})"
        ));
    }
    let answered = |condition: String| {
        format!(
            "EXISTS (SELECT 1 FROM revision r WHERE r.task = t.id AND r.state <> 'draft' AND {condition})"
        )
    };
    if let Some(part) = &filter.part {
        let like = values.put(format!("%|{part}|%"));
        all.push(format!(
            "({} OR EXISTS (SELECT 1 FROM accepted a WHERE a.task = t.id AND a.parts LIKE {like}))",
            answered(format!("r.parts LIKE {like}"))
        ));
    }
    if let Some(edit_type) = filter.edit_type {
        let value = values.put(edit_type);
        all.push(answered(format!("r.edit_type = {value}")));
    }
    if let Some(verdict) = filter.verdict {
        let value = values.put(verdict);
        all.push(answered(format!("r.verdict = {value}")));
    }
    if let Some(least) = filter.min_distance {
        all.push(format!("t.distance >= {}", values.put(least)));
    }
    if let Some(most) = filter.max_distance {
        all.push(format!("t.distance <= {}", values.put(most)));
    }
    if let Some(rule) = &filter.rule {
        let basis = values.put(format!("rule:{rule}"));
        all.push(format!(
            "EXISTS (SELECT 1 FROM accepted a WHERE a.task = t.id AND a.basis = {basis})"
        ));
    }
    all.extend(filter.skipped.map(skipped));
    if let Some(text) = filter.q.as_deref().map(str::trim)
        && !text.is_empty()
    {
        all.push(contains(text, values));
    }
    all.join(" AND ")
}

/// The SQL condition for skipped tasks.
fn skipped(by: SkipFilter) -> String {
    let skipped = "EXISTS (SELECT 1 FROM skip s WHERE s.task = t.id AND s.postponed = 0)";
    match by {
        SkipFilter::Any => skipped.to_owned(),
        SkipFilter::Everybody => format!(
            "t.state IN ('open', 'leased', 'returned') AND {skipped} AND NOT EXISTS (
               SELECT 1 FROM usr u WHERE u.active = 1
                 AND (u.role = 'annotator'
                   OR NOT EXISTS (SELECT 1 FROM usr a WHERE a.active = 1 AND a.role = 'annotator'))
                 AND NOT EXISTS (SELECT 1 FROM skip s WHERE s.task = t.id AND s.usr = u.id AND s.postponed = 0)
                 AND NOT EXISTS (SELECT 1 FROM revision r WHERE r.task = t.id AND r.author = u.id
                   AND r.state NOT IN ('draft', 'returned')))"
        ),
    }
}

/// The SQL condition for tasks whose answers, clips or own fields contain a text.
fn contains(text: &str, values: &mut Values) -> String {
    let text = text.to_lowercase();
    // lower() knows ASCII letters alone in SQLite, and in PostgreSQL with LC_CTYPE C.
    let others: BTreeSet<char> = text.chars().filter(|letter| !letter.is_ascii()).collect();
    let mut replaced = Vec::new();
    for small in others {
        let mut capital = small.to_uppercase();
        if let (Some(capital), None) = (capital.next(), capital.next()) {
            replaced.push([capital, small].map(|letter| values.put(letter.to_string())));
        }
    }
    let lower = |column: &str| {
        let ascii = format!("lower({column})");
        let folded = replaced.iter();
        folded.fold(ascii, |text, [capital, small]| {
            format!("replace({text}, {capital}, {small})")
        })
    };
    // Captions are stored as a list in JSON, which escapes quotation marks and backslashes.
    let quoted = serde_json::Value::from(text.as_str()).to_string();
    let in_json = values.put(like(&quoted[1..quoted.len() - 1]));
    let plain = values.put(like(&text));
    let fits = |column: &str| format!("{column} LIKE {plain} ESCAPE '\\'");
    let clip = |hash: &str| {
        format!(
            "EXISTS (SELECT 1 FROM motion m WHERE m.hash = {hash} AND ({} OR {} LIKE {in_json} ESCAPE '\\'))",
            fits(&lower("m.id")),
            lower("m.captions")
        )
    };
    let any = [
        format!(
            "EXISTS (SELECT 1 FROM revision r WHERE r.task = t.id AND r.state <> 'draft' AND {})",
            fits("r.words")
        ),
        format!(
            "EXISTS (SELECT 1 FROM accepted a WHERE a.task = t.id AND {})",
            fits("a.words")
        ),
        clip("t.source"),
        clip("t.target"),
        fits(&lower("t.category")),
        fits(&lower("t.hint")),
        fits(&lower("t.style")),
    ];
    format!("({})", any.join(" OR "))
}

/// Refuses a filter with an unknown part, a long search text, a control character, or a distance outside 0 to 1.
pub(super) fn check(filter: &TaskFilter) -> Result<()> {
    const MAX_SEARCH: usize = 200;
    if let Some(part) = &filter.part
        && let Err(error) = part.parse::<datasets_spec::BodyPart>()
    {
        return Err(Error::invalid("part", error.to_string()));
    }
    let is_short = |text: &String| has_up_to(text, MAX_SEARCH);
    let problem = format!("search for up to {MAX_SEARCH} characters");
    require(filter.q.as_ref().is_none_or(is_short), "q", problem)?;
    for (field, text) in [
        ("q", &filter.q),
        ("category", &filter.category),
        ("split", &filter.split),
        ("rule", &filter.rule),
    ] {
        check_text(field, text.as_deref().unwrap_or_default())?;
    }
    for (field, value) in [
        ("min_distance", filter.min_distance),
        ("max_distance", filter.max_distance),
    ] {
        let is_share = value.is_none_or(|value| (0.0..=1.0).contains(&value));
        require(is_share, field, "a distance is 0 to 1")?;
    }
    Ok(())
}

/// The two values of a page's cursor, written `VALUE:ID`. Refused with `invalid`.
pub(super) fn cursor<T: FromStr>(field: &str, text: &str) -> Result<(T, i64)> {
    let parsed = text
        .split_once(':')
        .and_then(|(value, id)| value.parse().ok().zip(id.parse().ok()));
    let problem = "this is no cursor of a page; begin at the first";
    parsed.ok_or_else(|| Error::invalid(field, problem))
}

/// The LIKE pattern for a text anywhere in a lower-case column. Spaces around the text are ignored; a blank text
/// matches everything.
pub(super) fn like(text: &str) -> String {
    let escaped = text
        .trim()
        .to_lowercase()
        .replace('\\', "\\\\")
        .replace('%', "\\%")
        .replace('_', "\\_");
    format!("%{escaped}%")
}

#[cfg(test)]
mod tests {
    use super::like;

    #[test]
    fn a_search_is_for_the_text_as_it_stands_without_the_spaces_around_it() {
        for (text, pattern) in [
            (" Wave twice ", "%wave twice%"),
            (" ", "%%"),
            (r"50%_\", r"%50\%\_\\%"),
        ] {
            assert_eq!(like(text), pattern);
        }
    }
}
