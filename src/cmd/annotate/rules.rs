//! Rules that accept answers without a reviewer.

use annotate::store::Store;
use annotate::wire::RulesApplied;

use super::args::RulesAction;
use super::shared::now;
use super::users::operator;
use crate::exit::Exit;
use crate::global::Global;

pub(super) fn rules(
    store: &Store,
    action: Option<&RulesAction>,
    global: &Global,
) -> anyhow::Result<Exit> {
    match action {
        None | Some(RulesAction::List) => {
            let states = store.rules()?;
            let mut lines = vec![format!(
                "{:<24} {:<9} {:>9} {:>13} {:>15}",
                "rule", "enabled", "accepted", "would accept", "left to review"
            )];
            lines.extend(states.iter().map(|state| {
                format!(
                    "{:<24} {:<9} {:>9} {:>13} {:>15}",
                    state.rule.name,
                    if state.rule.enabled { "yes" } else { "no" },
                    state.accepted,
                    state.would_accept,
                    state.left_to_review
                )
            }));
            global.say(&states, &lines.join("\n"))
        }
        Some(RulesAction::Apply) => {
            let mut all = RulesApplied::default();
            let mut after = Some(0);
            while let Some(from) = after {
                let some = store.apply_rules(from, now())?;
                all.looked_at += some.looked_at;
                for (name, count) in some.accepted {
                    *all.accepted.entry(name).or_default() += count;
                }
                after = some.next;
            }
            let mut lines = vec![format!("{} tasks waited for review", all.looked_at)];
            lines.extend(
                all.accepted
                    .iter()
                    .map(|(name, count)| format!("  accepted by {name:<24} {count:>8}")),
            );
            global.say(&all, &lines.join("\n"))
        }
        Some(RulesAction::Undo { name }) => {
            let admin = operator(store)?.id;
            let mut all = store.undo_rule(admin, name, now())?;
            while all.left > 0 {
                let more = store.undo_rule(admin, name, now())?;
                all.reopened += more.reopened;
                all.left = more.left;
            }
            let text = format!(
                "rule {name} is disabled; {} of its acceptances were taken back and wait for review",
                all.reopened
            );
            global.say(&all, &text)
        }
    }
}
