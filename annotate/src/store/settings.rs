//! Checks of new settings.

use super::db::Result;
use super::pictures;
use crate::Error;
use crate::wire::{
    MAX_GUIDELINE_CHARS, MAX_NAME_CHARS, MAX_TEXT_CHARS, Rule, RuleKind, Settings, Style,
};

/// Maximum number of phrases in a list, and of pictures in a guide.
const MAX_NAMES: usize = 200;
/// Maximum quota of an edit type.
const MAX_QUOTA: u32 = 10_000_000;
/// Minutes of a week.
const WEEK: u32 = 7 * 24 * 60;
/// Maximum number of styles: datasets of a hundred are published.
const MAX_STYLES: usize = 2_000;

/// Checks new settings.
pub(super) fn check(settings: &Settings) -> Result<()> {
    check_numbers(settings)?;
    check_names(settings)?;
    if !crate::clock::is_zone(&settings.time_zone) {
        return Err(Error::invalid(
            "time_zone",
            format!(
                "{:?} is no time zone; write a name such as Europe/Berlin or UTC",
                settings.time_zone
            ),
        ));
    }
    check_rules(&settings.rules)?;
    check_guides(settings)
}

fn check_numbers(settings: &Settings) -> Result<()> {
    let ranges = [
        ("overlap_percent", settings.overlap_percent, 0, 100),
        ("gold_percent", settings.gold_percent, 0, 100),
        ("blind_percent", settings.blind_percent, 0, 100),
        ("review_percent", settings.review_percent, 0, 100),
        ("practice_percent", settings.practice_percent, 0, 100),
        ("answers_per_task", settings.answers_per_task, 1, 50),
        ("lease_minutes", settings.lease_minutes, 1, 24 * 60),
        ("returned_days", settings.returned_days, 1, 365),
        ("take_back_minutes", settings.take_back_minutes, 0, WEEK),
        ("practice_tasks", settings.practice_tasks, 0, 100),
    ];
    for (field, value, least, most) in ranges {
        if !(least..=most).contains(&value) {
            let problem = format!("{value} is out of range; use {least} to {most}");
            return Err(Error::invalid(field, problem));
        }
    }
    if let Some((edit_type, wanted)) = settings
        .edit_type_quota
        .iter()
        .find(|(_, wanted)| **wanted > MAX_QUOTA)
    {
        return Err(Error::invalid(
            "edit_type_quota",
            format!("{wanted} pairs of {edit_type} are out of range; use 0 to {MAX_QUOTA}"),
        ));
    }
    if settings.min_masks > settings.max_masks || settings.max_masks > crate::wire::MAX_MASKS {
        return Err(Error::invalid(
            "max_masks",
            format!(
                "use at least min_masks and at most {}",
                crate::wire::MAX_MASKS
            ),
        ));
    }
    Ok(())
}

fn check_names(settings: &Settings) -> Result<()> {
    if !is_name(&settings.name) {
        return Err(Error::invalid(
            "name",
            format!("the project needs a name of up to {MAX_NAME_CHARS} characters"),
        ));
    }
    check_styles(&settings.styles)?;
    for (field, names) in [
        ("templates", &settings.templates),
        ("mask_templates", &settings.mask_templates),
        ("style_templates", &settings.style_templates),
    ] {
        if names.len() > MAX_NAMES || !names.iter().all(|name| is_name(name)) {
            return Err(Error::invalid(
                field,
                format!("use up to {MAX_NAMES} names of up to {MAX_NAME_CHARS} characters"),
            ));
        }
    }
    Ok(())
}

/// Whether a text can be a name: it is not blank, and short enough for a button.
pub(super) fn is_name(text: &str) -> bool {
    !text.trim().is_empty() && text.chars().count() <= MAX_NAME_CHARS
}

fn check_styles(styles: &[Style]) -> Result<()> {
    let refuse = |problem: String| Err(Error::invalid("styles", problem));
    if styles.len() > MAX_STYLES {
        return refuse(format!("use up to {MAX_STYLES} styles"));
    }
    for (index, style) in styles.iter().enumerate() {
        let name = &style.name;
        if !is_name(name) {
            return refuse(format!(
                "name each style in up to {MAX_NAME_CHARS} characters"
            ));
        }
        if styles[..index].iter().any(|other| other.name == *name) {
            return refuse(format!("two styles are called {name:?}"));
        }
        if style.text.chars().count() > MAX_TEXT_CHARS {
            return refuse(format!(
                "the text of {name:?} has more than {MAX_TEXT_CHARS} characters"
            ));
        }
        if style.guideline.chars().count() > MAX_GUIDELINE_CHARS {
            return refuse(format!(
                "the guideline of {name:?} has more than {MAX_GUIDELINE_CHARS} characters"
            ));
        }
        let is_colour = |text: &String| {
            text.strip_prefix('#').is_some_and(|digits| {
                digits.len() == 6 && digits.bytes().all(|byte| byte.is_ascii_hexdigit())
            })
        };
        if !style.colour.as_ref().is_none_or(is_colour) {
            return refuse(format!("the colour of {name:?} is not written as #rrggbb"));
        }
    }
    Ok(())
}

fn check_guides(settings: &Settings) -> Result<()> {
    const MAX_GUIDE: usize = 100_000;
    for (kind, guide) in &settings.guides {
        if guide.text.chars().count() > MAX_GUIDE || guide.pictures.len() > MAX_NAMES {
            return Err(Error::invalid(
                &format!("guides.{kind}"),
                format!("use up to {MAX_GUIDE} characters and {MAX_NAMES} pictures"),
            ));
        }
        for picture in &guide.pictures {
            pictures::check_name(&picture.name)?;
        }
    }
    if settings.guide.chars().count() > MAX_GUIDE {
        return Err(Error::invalid(
            "guide",
            format!("use up to {MAX_GUIDE} characters"),
        ));
    }
    Ok(())
}

fn check_rules(rules: &[Rule]) -> Result<()> {
    const MAX_RULES: usize = 20;
    if rules.len() > MAX_RULES {
        return Err(Error::invalid(
            "rules",
            format!("use up to {MAX_RULES} rules"),
        ));
    }
    for (index, rule) in rules.iter().enumerate() {
        if let Some((field, problem)) = problem_of(rule, &rules[..index]) {
            return Err(Error::invalid(&format!("rules.{index}.{field}"), problem));
        }
    }
    Ok(())
}

/// What is wrong with a rule after others: the field, and the problem.
fn problem_of(rule: &Rule, before: &[Rule]) -> Option<(&'static str, String)> {
    let allowed = |c: char| c.is_ascii_alphanumeric() || c == '-';
    let (name, trusts) = (&rule.name, rule.accepts == RuleKind::Trusted);
    if !(1..=40).contains(&name.len()) || !name.chars().all(allowed) {
        let problem =
            format!("{name:?} is no name of a rule; use 1 to 40 letters, digits and dashes");
        return Some(("name", problem));
    }
    if before.iter().any(|other| other.name == *name) {
        return Some(("name", format!("two rules are called {name}")));
    }
    if trusts && rule.people.is_empty() {
        return Some(("people", "name the people to trust".to_owned()));
    }
    if !trusts && !rule.people.is_empty() {
        let kind = rule.accepts;
        let problem = format!("a rule that accepts {kind} has no people; leave them out");
        return Some(("people", problem));
    }
    if !(1..=50).contains(&rule.min_answers) {
        return Some(("min_answers", "use 1 to 50".to_owned()));
    }
    if !(0.0..=1.0).contains(&rule.max_distance) {
        return Some(("max_distance", "use 0 to 1".to_owned()));
    }
    let in_range = rule.review_percent <= 100;
    (!in_range).then(|| ("review_percent", "use 0 to 100".to_owned()))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::wire::EditType;

    #[test]
    fn settings_are_bounded() {
        assert!(check(&Settings::default()).is_ok());
        let styles = |styles| Settings {
            styles,
            ..Settings::default()
        };
        assert!(
            check(&styles(vec![Style {
                name: "old".to_owned(),
                text: "Short steps.".to_owned(),
                guideline: "Bend the knees.\n\nDo not limp.".to_owned(),
                colour: Some("#8f6B00".to_owned()),
            }]))
            .is_ok()
        );
        for broken in [
            Settings {
                gold_percent: 101,
                ..Settings::default()
            },
            Settings {
                answers_per_task: 0,
                ..Settings::default()
            },
            Settings {
                lease_minutes: 0,
                ..Settings::default()
            },
            Settings {
                min_masks: 5,
                ..Settings::default()
            },
            Settings {
                edit_type_quota: [(EditType::Speed, MAX_QUOTA + 1)].into(),
                ..Settings::default()
            },
            styles(vec![Style::default()]),
            styles(vec![Style::named("old"), Style::named("old")]),
            styles(vec![Style {
                colour: Some("red".to_owned()),
                ..Style::named("old")
            }]),
            styles(vec![Style {
                guideline: "x".repeat(MAX_GUIDELINE_CHARS + 1),
                ..Style::named("old")
            }]),
            Settings {
                name: " ".to_owned(),
                ..Settings::default()
            },
        ] {
            assert!(check(&broken).is_err());
        }
    }
}
