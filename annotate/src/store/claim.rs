//! Claims: which task a person gets next. New annotators first get practice tasks of a kind, whose answers are known.

use std::collections::{BTreeMap, BTreeSet};

use super::db::{Result, ToSql, Tx, params};
use super::draw::percent;
use super::entry::Place;
use super::import::GOLD_KEY;
use super::leases::{HERE, PLACED, Turn, expire, reserved_after};
use super::records::{Millis, TaskDetail};
use super::rows::{self, LEASE, LeaseRow};
use super::store::Store;
use super::{apply, read};
use crate::Error;
use crate::agreement::mean;
use crate::state::{LogKind, Purpose, ReleaseReason};
use crate::wire::{Code, EditType, Empty, Practice, RevisionState, TaskKind, TaskState};

/// SQL condition: user `?2` can get task `t` as new work. This includes the author of a returned answer, once the task
/// is no longer reserved for them.
const FOR_ME: &str = "t.claimable = 1
  AND NOT EXISTS (SELECT 1 FROM revision r WHERE r.task = t.id AND r.author = ?2 AND r.state NOT IN ('draft', 'returned'))
  AND NOT EXISTS (SELECT 1 FROM lease l WHERE l.task = t.id AND l.usr = ?2)
  AND NOT EXISTS (SELECT 1 FROM motion m WHERE m.current = 2 AND m.hash IN (t.source, t.target))";

/// SQL condition: `t` is a practice task of kind `?1` that can be given: the task that it is a copy of is accepted, and its
/// clip has not changed since. The key of a copy is `practice:` and the key of that task.
const PRACTICE: &str = "t.practice = 1 AND t.kind = ?1 AND t.state IN ('open', 'leased')
  AND NOT EXISTS (SELECT 1 FROM task o WHERE o.key = substr(t.key, 10) AND (o.state <> 'accepted' OR o.changed = 1))
  AND NOT EXISTS (SELECT 1 FROM motion m WHERE m.current = 2 AND m.hash IN (t.source, t.target))";

/// The order of [`PLACED`] tasks.
const IN_BUNDLES: &str =
    "COALESCE(g.bundle, t.bundle, 0), COALESCE(g.bundle_index, t.bundle_index), l.id";

impl Store {
    /// Claims the next task of a kind, or returns the task that the user already holds, with the hashes of the motions
    /// of the next `ahead` tasks. If there is no task, returns the reason.
    pub fn claim(
        &self,
        user: i64,
        kind: TaskKind,
        ahead: usize,
        now: Millis,
    ) -> Result<Result<(TaskDetail, Vec<String>), Empty>> {
        // The writer runs both in one transaction: its page cache is warm, while a reader's is invalidated by every
        // commit.
        self.write(move |tx| {
            let turn = Turn::begin(tx, user, now)?;
            let task = match claim(tx, &turn, kind)? {
                Ok(task) => task,
                Err(empty) => return Ok(Err(empty)),
            };
            let upcoming = upcoming(tx, &turn, kind, task, ahead)?;
            Ok(Ok((read::detail(tx, user, task)?, upcoming)))
        })
    }

    /// Claims a given task. Refused with `task_full`, `not_found`, `wrong_state`.
    pub fn claim_task(&self, user: i64, task: i64, now: Millis) -> Result<TaskDetail> {
        self.write(move |tx| {
            let turn = Turn::begin(tx, user, now)?;
            claim_task(tx, &turn, task)?;
            read::detail(tx, user, task)
        })
    }

    /// A user's progress in the practice of each kind of task.
    pub fn practice(&self, user: i64) -> Result<Vec<Practice>> {
        self.read(|tx| {
            // The time does not affect the result.
            let turn = Turn::of(tx, user, 0)?;
            let kinds = TaskKind::ALL.iter();
            kinds.map(|&kind| standing(tx, &turn, kind)).collect()
        })
    }
}

/// Numbers of tasks of a category that claims would give a user.
#[derive(Default)]
struct Offer {
    /// Tasks that already count toward the quota of the category, and want another answer.
    counted: i64,
    /// Other tasks.
    others: i64,
    /// Tasks that will no longer count toward the quota once the next claim ends their expired leases.
    freed: i64,
}

/// Number of new and postponed tasks that claims would give a user now. Pairs of categories whose quota is reached do
/// not count.
pub(super) fn on_offer(tx: &mut dyn Tx, turn: &Turn, kind: TaskKind) -> Result<i64> {
    let quota = quota(turn, kind);
    let (columns, group) = match quota {
        Some(_) => ("t.category, t.counted", "GROUP BY t.category, t.counted"),
        None => ("CAST(NULL AS TEXT), 0", ""),
    };
    let mut offers: BTreeMap<Option<String>, Offer> = BTreeMap::new();
    let claimable = format!(
        "SELECT {columns}, COUNT(*) FROM task t WHERE t.kind = ?1 AND t.claimable = 1 AND {HERE} {group}"
    );
    // Query the user's few tasks instead of checking every open task.
    let not_for_me = format!(
        "SELECT {columns}, -COUNT(*) FROM (
           SELECT task FROM revision WHERE author = ?2 AND state NOT IN ('draft', 'returned')
           UNION SELECT task FROM skip WHERE usr = ?2 AND postponed = 0
           UNION SELECT task FROM lease WHERE usr = ?2
         ) o JOIN task t ON t.id = o.task WHERE t.kind = ?1 AND t.claimable = 1 AND {HERE} {group}"
    );
    let mut counts: Vec<(Option<String>, bool, i64)> = tx.list(&claimable, params![kind])?;
    counts.append(&mut tx.list(&not_for_me, params![kind, turn.user])?);
    for (category, is_counted, count) in counts {
        let offer = offers.entry(category).or_default();
        if is_counted {
            offer.counted += count;
        } else {
            offer.others += count;
        }
    }
    expired_offers(tx, turn, kind, &mut offers)?;
    let Some(quota) = quota else {
        return Ok(offers.values().map(|offer| offer.others).sum());
    };
    let counted = counted(tx)?;
    Ok(offers
        .iter()
        .map(|(category, offer)| {
            let used = counted.get(category).copied().unwrap_or(0) - offer.freed;
            offer.counted + offer.others.min((quota - used).max(0))
        })
        .sum())
}

/// Adds the tasks whose expired leases the next claim of a user would end.
fn expired_offers(
    tx: &mut dyn Tx,
    turn: &Turn,
    kind: TaskKind,
    offers: &mut BTreeMap<Option<String>, Offer>,
) -> Result<()> {
    let by_category = quota(turn, kind).is_some();
    let sql = format!(
        "SELECT {LEASE}, l.purpose, l.blind, CASE WHEN t.claimable = 0
             AND NOT EXISTS (SELECT 1 FROM revision r WHERE r.task = t.id AND r.author = ?2 AND r.state NOT IN ('draft', 'returned'))
             AND NOT EXISTS (SELECT 1 FROM skip s WHERE s.task = t.id AND s.usr = ?2 AND s.postponed = 0)
             AND NOT EXISTS (SELECT 1 FROM lease m WHERE m.task = t.id AND m.usr = ?2) THEN 1 ELSE 0 END,
           CASE WHEN EXISTS (SELECT 1 FROM revision r WHERE r.task = t.id AND r.state = 'submitted' AND r.verdict = 'keep')
             OR EXISTS (SELECT 1 FROM lease m WHERE m.task = t.id AND m.purpose <> 'review' AND (m.expires > ?1 OR m.usr = ?2))
             THEN 1 ELSE 0 END, t.category
         FROM lease l JOIN task t ON t.id = l.task
         WHERE l.expires <= ?1 AND l.usr <> ?2 AND l.purpose <> 'review' AND t.kind = ?3 AND t.gold IS NULL"
    );
    let mut seen = BTreeSet::new();
    let expired: Vec<(LeaseRow, bool, bool, Option<String>)> =
        tx.list(&sql, params![turn.now, turn.user, kind])?;
    for (held, for_me, counts, category) in expired {
        let reserved = reserved_after(tx, &held, ReleaseReason::Expired, turn.now)?.is_some();
        if reserved || !seen.insert(held.lease.task) {
            continue;
        }
        let offer = offers.entry(category.filter(|_| by_category)).or_default();
        if by_category && counts {
            offer.counted += i64::from(for_me);
        } else {
            offer.others += i64::from(for_me);
            offer.freed += 1;
        }
    }
    Ok(())
}

/// The next task of a user, or why there is none.
fn claim(tx: &mut dyn Tx, turn: &Turn, kind: TaskKind) -> Result<Result<i64, Empty>> {
    if let Some(task) = due(tx, turn, kind)? {
        return Ok(Ok(task));
    }
    let (first, bundle, room) = loop {
        let room = room(tx, turn, kind)?;
        if let Some((first, bundle)) = candidate(tx, turn, kind, room.as_ref())? {
            break (first, bundle, room);
        }
        // One request ends only some of the expired leases, so try again.
        if expire(tx, turn.user, turn.now)? == 0 {
            let mut empty = empty(tx, turn.user, kind)?;
            if let Some(room) = &room {
                empty.quota_full = room.values().map(|category| category.held_back).sum();
            }
            return Ok(Err(empty));
        }
    };
    let places = match bundle {
        None => vec![(first, None)],
        Some(bundle) => places(tx, turn.user, first, bundle, room)?,
    };
    let golds = gold_tasks(tx, turn, kind, places.len())?;
    let mut taken = Vec::with_capacity(places.len());
    for ((task, place), gold) in places.into_iter().zip(golds) {
        // A gold task replaces one of the tasks, which is left for a later claim.
        let (task, place) = gold.map_or((task, None), |gold| (gold, place));
        turn.take(tx, task, Purpose::Annotate, place)?;
        taken.push(task);
    }
    Ok(Ok(taken.first().copied().unwrap_or(first)))
}

/// A task that precedes new ones: one that the user holds, one reserved for them, or practice.
fn due(tx: &mut dyn Tx, turn: &Turn, kind: TaskKind) -> Result<Option<i64>> {
    let from = format!(
        "{PLACED} WHERE l.usr = ?1 AND l.purpose = 'annotate' AND t.kind = ?2 ORDER BY {IN_BUNDLES} LIMIT 1"
    );
    if let Some(held) = rows::leases(tx, &from, params![turn.user, kind])?.pop() {
        return turn.resume(tx, &held).map(Some);
    }
    let sql = format!(
        "SELECT t.id FROM lease l JOIN task t ON t.id = l.task
         WHERE l.usr = ?1 AND l.purpose IN ('returned', 'assigned') AND t.kind = ?2 AND {HERE} ORDER BY l.id LIMIT 1"
    );
    let back = tx.find(&sql, params![turn.user, kind])?;
    let task = match back {
        Some(task) => Some(task),
        None => next_practice(tx, turn, kind)?,
    };
    if let Some(task) = task {
        turn.take(tx, task, Purpose::Annotate, None)?;
    }
    Ok(task)
}

/// The tasks that a user gets together with `first` of the same bundle, in order.
fn places(
    tx: &mut dyn Tx,
    user: i64,
    first: i64,
    bundle: i64,
    mut room: Option<Room>,
) -> Result<Vec<(i64, Option<Place>)>> {
    let sql = format!(
        "SELECT t.id, t.bundle_index, t.category, t.counted FROM task t WHERE t.bundle = ?1 AND {FOR_ME}
                   AND NOT EXISTS (SELECT 1 FROM skip s WHERE s.task = t.id AND s.usr = ?2 AND s.postponed = 0)
                 ORDER BY t.bundle_index, t.id"
    );
    let mut found: Vec<(i64, i64, Option<String>, bool)> = tx.list(&sql, params![bundle, user])?;
    // The first task uses the quota before the others do.
    found.sort_by_key(|(task, ..)| *task != first);
    let mut places = Vec::new();
    for (task, index, category, counted) in found {
        let category = room.as_mut().and_then(|room| room.get_mut(&category));
        if counted || category.is_none_or(Category::use_one) {
            places.push((task, Some(Place { bundle, index })));
        }
    }
    places.sort_by_key(|(task, place)| (place.as_ref().map(|place| place.index), *task));
    Ok(places)
}

/// State of the quota of a category of pairs.
struct Category {
    /// Number of pairs that count toward the quota.
    counted: i64,
    /// Pairs that may still be given out.
    room: i64,
    /// Pairs that are not given out because the quota is reached.
    held_back: i64,
}

impl Category {
    /// Uses up the quota for one more pair. Returns whether there was room.
    fn use_one(&mut self) -> bool {
        let has_room = self.room > 0;
        self.room -= i64::from(has_room);
        has_room
    }
}

/// Categories of pairs that can be claimed. Pairs without a category form one of their own.
type Room = BTreeMap<Option<String>, Category>;

/// Number of pairs of each category that count toward its quota or wait for review. Waiting pairs are included, because
/// they may still be kept or returned to their authors.
fn counted(tx: &mut dyn Tx) -> Result<BTreeMap<Option<String>, i64>> {
    let sql = "SELECT p.category, COUNT(*) FROM (
         SELECT category FROM task WHERE kind = 'pair' AND counted = 1
         UNION ALL SELECT category FROM task WHERE kind = 'pair' AND counted = 0 AND state IN ('submitted', 'in_review')
       ) p GROUP BY p.category";
    counts(tx, sql)
}

/// Runs a query whose rows are a name and its count.
fn counts(tx: &mut dyn Tx, sql: &str) -> Result<BTreeMap<Option<String>, i64>> {
    let counts: Vec<(Option<String>, i64)> = tx.list(sql, &[])?;
    Ok(BTreeMap::from_iter(counts))
}

/// Number of pairs wanted of each category, if the project has a quota for tasks of this kind.
fn quota(turn: &Turn, kind: TaskKind) -> Option<i64> {
    let wanted = i64::from(turn.settings.category_quota);
    (kind == TaskKind::Pair && wanted > 0).then_some(wanted)
}

/// Open quota of each category, if there are quotas.
fn room(tx: &mut dyn Tx, turn: &Turn, kind: TaskKind) -> Result<Option<Room>> {
    let Some(quota) = quota(turn, kind) else {
        return Ok(None);
    };
    let counted = counted(tx)?;
    let sql = "SELECT category, CAST(SUM(1 - counted) AS BIGINT) FROM task WHERE kind = 'pair' AND claimable = 1 GROUP BY category";
    let room = counts(tx, sql)?.into_iter().map(|(name, others)| {
        let counted = counted.get(&name).copied().unwrap_or(0);
        let room = (quota - counted).max(0);
        let category = Category {
            counted,
            room,
            held_back: if room == 0 { others } else { 0 },
        };
        (name, category)
    });
    Ok(Some(room.collect()))
}

/// SQL conditions for claiming, in the order in which they are tried, each with its category: the category with the
/// fewest pairs first. In a category whose quota is reached, only pairs that count already and need another answer.
fn category_limits(room: Option<&Room>) -> Vec<(&'static str, Option<&String>)> {
    let Some(room) = room else {
        return vec![("", None)];
    };
    let mut categories: Vec<_> = room.iter().collect();
    categories.sort_by_key(|(name, category)| (category.room == 0, category.counted, *name));
    categories
        .into_iter()
        .map(|(name, category)| {
            let limit = match (name, category.room > 0) {
                (Some(_), true) => "AND t.category = ?3",
                (Some(_), false) => "AND t.category = ?3 AND t.counted = 1",
                (None, true) => "AND t.category IS NULL",
                (None, false) => "AND t.category IS NULL AND t.counted = 1",
            };
            (limit, name.as_ref())
        })
        .collect()
}

/// SQL conditions for claiming pairs within a category, in the order in which they are tried: first pairs whose stated
/// edit type is furthest behind its quota, then all types except those with enough pairs, then the rest. Nothing is
/// withheld. Without quotas, the only condition is empty.
fn type_limits(tx: &mut dyn Tx, turn: &Turn, kind: TaskKind) -> Result<Vec<String>> {
    let quotas = turn.settings.edit_type_quota.iter();
    let quotas: Vec<(EditType, i64)> = quotas
        .map(|(edit_type, wanted)| (*edit_type, i64::from(*wanted)))
        .filter(|(_, wanted)| *wanted > 0)
        .collect();
    if kind != TaskKind::Pair || quotas.is_empty() {
        return Ok(vec![String::new()]);
    }
    // A pair that is not kept yet counts with its stated type.
    let sql = "SELECT COALESCE(kept_type, stated_type), COUNT(*) FROM task WHERE kind = 'pair' AND counted = 1
         GROUP BY COALESCE(kept_type, stated_type)";
    let counted_as = counts(tx, sql)?;
    let counted = |edit_type: EditType| {
        let name = Some(edit_type.as_str().to_owned());
        counted_as.get(&name).copied().unwrap_or(0)
    };
    let (mut behind, full): (Vec<_>, Vec<_>) = quotas
        .into_iter()
        .map(|(edit_type, wanted)| (edit_type, counted(edit_type), wanted))
        .partition(|(_, counted, wanted)| counted < wanted);
    // Sort by the share of the quota that is filled.
    behind.sort_by(|(_, a, of_a), (_, b, of_b)| (a * of_b).cmp(&(b * of_a)));
    let mut limits: Vec<String> = behind
        .iter()
        .map(|(edit_type, ..)| format!("AND t.stated_type = '{edit_type}'"))
        .collect();
    if !full.is_empty() {
        let full = full.iter().map(|(edit_type, ..)| format!("'{edit_type}'"));
        limits.push(format!(
            "AND (t.stated_type IS NULL OR t.stated_type NOT IN ({}))",
            Vec::from_iter(full).join(", ")
        ));
    }
    limits.push(String::new());
    Ok(limits)
}

/// The next task of a user with its bundle: a new task, or otherwise a postponed one. With quotas, tasks are tried in
/// the order of [`category_limits`], and within a category in that of [`type_limits`].
fn candidate(
    tx: &mut dyn Tx,
    turn: &Turn,
    kind: TaskKind,
    room: Option<&Room>,
) -> Result<Option<(i64, Option<i64>)>> {
    let (categories, types) = (category_limits(room), type_limits(tx, turn, kind)?);
    let fresh = |limit: &str| {
        format!(
            "SELECT t.id, t.bundle FROM task t WHERE t.kind = ?1 AND {FOR_ME} {limit}
               AND NOT EXISTS (SELECT 1 FROM skip s WHERE s.task = t.id AND s.usr = ?2)
             ORDER BY t.priority DESC, t.id LIMIT 1"
        )
    };
    let postponed = |limit: &str| {
        format!(
            "SELECT t.id, t.bundle FROM skip s JOIN task t ON t.id = s.task
             WHERE t.kind = ?1 AND s.usr = ?2 AND s.postponed = 1 AND {FOR_ME} {limit}
             ORDER BY s.at, t.id LIMIT 1"
        )
    };
    let sorts: [&dyn Fn(&str) -> String; 2] = [&fresh, &postponed];
    for sql in sorts {
        for (of_category, category) in &categories {
            for of_type in &types {
                let mut values: Vec<&dyn ToSql> = vec![&kind, &turn.user];
                values.extend(category.map(|category| category as &dyn ToSql));
                let sql = sql(&format!("{of_category} {of_type}"));
                if let Some(found) = tx.find(&sql, &values)? {
                    return Ok(Some(found));
                }
            }
        }
    }
    Ok(None)
}

/// Hashes of the motions of the next tasks: the held ones, the next gold task and new ones. Without prefetching, the
/// motions of gold tasks would load later than others, which would mark gold tasks.
fn upcoming(
    tx: &mut dyn Tx,
    turn: &Turn,
    kind: TaskKind,
    present: i64,
    limit: usize,
) -> Result<Vec<String>> {
    let held = format!(
        "SELECT t.source, t.target, t.id FROM {PLACED} WHERE t.kind = ?1 AND l.usr = ?2 AND l.purpose = 'annotate'
         ORDER BY {IN_BUNDLES} LIMIT ?3"
    );
    let new = format!(
        "SELECT t.source, t.target, t.id FROM task t WHERE t.kind = ?1 AND {FOR_ME}
           AND NOT EXISTS (SELECT 1 FROM skip s WHERE s.task = t.id AND s.usr = ?2)
         ORDER BY t.priority DESC, t.id LIMIT ?3"
    );
    let params = params![kind, turn.user, limit as i64 + 1];
    let mut tasks: Vec<(String, Option<String>, i64)> = tx.list(&held, params)?;
    if turn.settings.gold_percent > 0 {
        for gold in known_tasks(tx, turn.user, kind, 1)? {
            let sql = "SELECT source, target, id FROM task WHERE id = ?1";
            tasks.push(tx.get(sql, params![gold])?);
        }
    }
    if tasks.len() <= limit {
        tasks.append(&mut tx.list(&new, params)?);
    }
    tasks.retain(|(.., task)| *task != present);
    tasks.truncate(limit);
    let hashes = tasks.into_iter();
    let hashes = hashes.flat_map(|(source, target, _)| std::iter::once(source).chain(target));
    Ok(hashes.collect())
}

/// For each of the next `count` answers of a user: the gold task that takes its place, if one is due. Each draw depends
/// on the user and the number of the answer, so that repeated requests have the same result.
fn gold_tasks(
    tx: &mut dyn Tx,
    turn: &Turn,
    kind: TaskKind,
    count: usize,
) -> Result<Vec<Option<i64>>> {
    let (user, share) = (turn.user, turn.settings.gold_percent);
    let mut places = vec![None; count];
    if share == 0 {
        return Ok(places);
    }
    let done = tx.number(
        "SELECT (SELECT COUNT(*) FROM revision WHERE author = ?1 AND state <> 'draft')
           + (SELECT COUNT(*) FROM skip WHERE usr = ?1)",
        params![user],
    )?;
    let is_due = |index: usize| {
        let number = (done + index as i64).to_string();
        percent(&["gold", &user.to_string(), &number]) < share
    };
    let due: Vec<usize> = (0..count).filter(|&index| is_due(index)).collect();
    if due.is_empty() {
        return Ok(places);
    }
    let golds = known_tasks(tx, user, kind, due.len())?;
    for (index, gold) in due.into_iter().zip(golds) {
        places[index] = Some(gold);
    }
    Ok(places)
}

/// The next gold tasks of a user. Excludes tasks that the user answered, reviewed or began before they became gold, and
/// tasks whose answer is no longer accepted, or is about earlier content of the clip.
fn known_tasks(tx: &mut dyn Tx, user: i64, kind: TaskKind, count: usize) -> Result<Vec<i64>> {
    let prefix = GOLD_KEY.len() as i64 + 1;
    let sql = format!(
        "SELECT t.id FROM task t WHERE t.gold IS NOT NULL AND t.practice = 0 AND t.kind = ?1 AND t.state IN ('open', 'leased')
           AND NOT EXISTS (SELECT 1 FROM revision r WHERE r.task = t.id AND r.author = ?2 AND r.state <> 'draft')
           AND NOT EXISTS (SELECT 1 FROM skip s WHERE s.task = t.id AND s.usr = ?2)
           AND NOT EXISTS (SELECT 1 FROM lease l WHERE l.task = t.id AND l.usr = ?2)
           AND NOT EXISTS (SELECT 1 FROM task o WHERE o.key = substr(t.key, CAST(?3 AS INTEGER)) AND (o.state <> 'accepted' OR o.changed = 1
             OR EXISTS (SELECT 1 FROM revision r WHERE r.task = o.id AND r.author = ?2)
             OR EXISTS (SELECT 1 FROM review v WHERE v.task = o.id AND v.reviewer = ?2)
             OR EXISTS (SELECT 1 FROM accepted a WHERE a.task = o.id AND a.author = ?2)))
           AND {HERE} ORDER BY t.shuffle, t.id LIMIT ?4"
    );
    tx.list(&sql, params![kind, user, prefix, count as i64])
}

fn empty(tx: &mut dyn Tx, user: i64, kind: TaskKind) -> Result<Empty> {
    let mut empty = Empty::default();
    let sql = "SELECT state, COUNT(*) FROM task WHERE kind = ?1 AND gold IS NULL GROUP BY state";
    for (state, count) in tx.list::<(TaskState, i64)>(sql, params![kind])? {
        empty.total += count;
        match state {
            TaskState::Submitted | TaskState::InReview | TaskState::Accepted => empty.done += count,
            TaskState::Dropped => empty.dropped += count,
            TaskState::Open | TaskState::Leased | TaskState::Returned => {}
        }
    }
    (
        empty.leased_by_others,
        empty.soonest_expiry,
        empty.waiting_for_others,
        empty.skipped_by_me,
    ) = tx.get(
        "SELECT COUNT(DISTINCT l.task), MIN(l.expires),
           (SELECT COUNT(*) FROM revision r JOIN task t ON t.id = r.task
            WHERE r.author = ?2 AND r.state <> 'draft' AND t.kind = ?1 AND t.gold IS NULL
              AND t.state IN ('open', 'leased', 'returned')),
           (SELECT COUNT(*) FROM skip s JOIN task t ON t.id = s.task
            WHERE s.usr = ?2 AND t.kind = ?1 AND t.state IN ('open', 'leased', 'returned'))
         FROM lease l JOIN task t ON t.id = l.task
         WHERE l.usr <> ?2 AND l.purpose <> 'review' AND t.kind = ?1 AND t.gold IS NULL",
        params![kind, user],
    )?;
    let sql = format!(
        "SELECT COUNT(*) FROM task t WHERE t.kind = ?1 AND t.gold IS NULL AND t.claimable = 1 AND NOT ({HERE})"
    );
    empty.clip_gone = tx.number(&sql, params![kind])?;
    Ok(empty)
}

fn claim_task(tx: &mut dyn Tx, turn: &Turn, id: i64) -> Result<()> {
    let user = turn.user;
    let task = rows::task(tx, id)?;
    match rows::lease_of(tx, id, user)? {
        Some(held) if held.purpose == Purpose::Annotate => {
            return turn.prolong(tx, &held).map(|_| ());
        }
        Some(held) if matches!(held.purpose, Purpose::Returned | Purpose::Assigned) => {
            return turn.take(tx, id, Purpose::Annotate, None);
        }
        Some(_) => return Err(Error::wrong_state(task.state, "answered by its reviewer")),
        None => {}
    }
    // Only users who have held the task may open it by number.
    let known = "SELECT 1 FROM event WHERE task = ?1 AND +actor = ?2 AND kind = 'claimed' LIMIT 1";
    if !tx.has(known, params![id, user])? {
        return Err(Error::not_found("task"));
    }
    if let Some(mine) = rows::revision(tx, id, user)?
        && mine.state != RevisionState::Draft
        && mine.state != RevisionState::Returned
    {
        let problem = "taken again: your answer is handed in";
        return Err(Error::wrong_state(task.state, problem));
    }
    apply::check_move(task.state, LogKind::Claimed, "taken")?;
    let is_here = format!("SELECT 1 FROM task t WHERE t.id = ?1 AND {HERE}");
    if !tx.has(&is_here, params![id])? {
        let problem = "taken: its clip is no longer in the dataset";
        return Err(Error::wrong_state(task.state, problem));
    }
    let sql = "SELECT claimable, counted FROM task WHERE id = ?1";
    let (claimable, counted): (bool, bool) = tx.get(sql, params![id])?;
    if !claimable && task.gold.is_none() {
        let problem = "the task has enough annotators by now; your text is kept as a draft";
        return Err(Error::refused(Code::TaskFull, problem));
    }
    let room = room(tx, turn, task.kind)?;
    let category = room.as_ref().and_then(|room| room.get(&task.category));
    let is_full = category.is_some_and(|category| category.room == 0);
    if is_full && !counted && task.gold.is_none() {
        let problem =
            "its category has as many pairs as the project wants; your text is kept as a draft";
        return Err(Error::refused(Code::TaskFull, problem));
    }
    turn.take(tx, id, Purpose::Annotate, None)
}

/// A user's progress in the practice tasks of a kind. Reviewers and admins need no practice.
pub(super) fn standing(tx: &mut dyn Tx, turn: &Turn, kind: TaskKind) -> Result<Practice> {
    let (user, settings) = (turn.user, &turn.settings);
    let sql = format!("SELECT COUNT(*) FROM task t WHERE {PRACTICE}");
    let there = tx.number(&sql, params![kind])?;
    let needed = there.min(settings.practice_tasks.into());
    let scores: Vec<f64> = tx.list(
        "SELECT g.score FROM gold_score g JOIN task t ON t.id = g.task
         WHERE g.usr = ?1 AND t.practice = 1 AND t.kind = ?2 ORDER BY g.at DESC, g.task DESC LIMIT ?3",
        params![user, kind, needed],
    )?;
    let (done, score) = (scores.len() as i64, mean(&scores));
    let threshold = f64::from(settings.practice_percent) / 100.0;
    let sql = "SELECT 1 FROM usr WHERE id = ?1 AND role = 'annotator'";
    let annotates = tx.has(sql, params![user])?;
    Ok(Practice {
        kind,
        needed,
        done,
        score,
        threshold,
        passed: !annotates
            || done >= needed && (needed == 0 || score.is_some_and(|score| score >= threshold)),
    })
}

/// The next practice task of a user who has not passed the practice of a kind. New tasks come first, then the one
/// answered longest ago.
fn next_practice(tx: &mut dyn Tx, turn: &Turn, kind: TaskKind) -> Result<Option<i64>> {
    if turn.settings.practice_tasks == 0 || standing(tx, turn, kind)?.passed {
        return Ok(None);
    }
    let sql = format!(
        "SELECT t.id FROM task t LEFT JOIN gold_score g ON g.task = t.id AND g.usr = ?2 WHERE {PRACTICE}
         ORDER BY CASE WHEN g.at IS NULL THEN 0 ELSE 1 END,
           (SELECT COUNT(*) FROM skip s WHERE s.task = t.id AND s.usr = ?2), g.at, t.shuffle, t.id LIMIT 1"
    );
    tx.find(&sql, params![kind, turn.user])
}
