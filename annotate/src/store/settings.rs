//! Checks of new settings.

use super::db::Result;
use crate::answer::check_text;
use crate::error::require;
use crate::wire::{
    MAX_GUIDELINE_CHARS, MAX_MASKS, MAX_NAME_CHARS, MAX_TEXT_CHARS, Rule, RuleKind, Settings, Style,
};

/// Maximum number of phrases in a list, and of pictures in a guide.
const MAX_NAMES: usize = 200;
/// Maximum quota of an edit type.
const MAX_QUOTA: u32 = 10_000_000;
/// Minutes of a week.
const WEEK: u32 = 7 * 24 * 60;
/// Maximum number of styles. Published datasets have about a hundred.
const MAX_STYLES: usize = 2_000;

/// Checks the numbers, names, time zone, rules and guides of new settings.
pub(super) fn check(settings: &Settings) -> Result<()> {
    let zone = &settings.time_zone;
    check_numbers(settings)?;
    check_names(settings)?;
    let problem = format!("{zone:?} is no time zone; write a name such as Europe/Berlin or UTC");
    require(crate::clock::is_zone(zone), "time_zone", problem)?;
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
        let problem = format!("{value} is out of range; use {least} to {most}");
        require((least..=most).contains(&value), field, problem)?;
    }
    for (edit_type, wanted) in &settings.edit_type_quota {
        let problem =
            format!("{wanted} pairs of {edit_type} are out of range; use 0 to {MAX_QUOTA}");
        require(*wanted <= MAX_QUOTA, "edit_type_quota", problem)?;
    }
    require(
        settings.min_masks <= settings.max_masks && settings.max_masks <= MAX_MASKS,
        "max_masks",
        format!("use at least min_masks and at most {MAX_MASKS}"),
    )
}

fn check_names(settings: &Settings) -> Result<()> {
    let problem = format!(
        "the project needs a name of up to {MAX_NAME_CHARS} characters, without control characters"
    );
    require(is_name(&settings.name), "name", problem)?;
    check_styles(&settings.styles)?;
    for (field, names) in [
        ("templates", &settings.templates),
        ("mask_templates", &settings.mask_templates),
        ("style_templates", &settings.style_templates),
    ] {
        let are_names = names.len() <= MAX_NAMES && names.iter().all(|name| is_name(name));
        let problem = format!(
            "use up to {MAX_NAMES} names of up to {MAX_NAME_CHARS} characters, without control characters"
        );
        require(are_names, field, problem)?;
    }
    Ok(())
}

/// Whether a text can be a name: it is a valid text, not blank, and short enough for a button.
pub(super) fn is_name(text: &str) -> bool {
    let is_short = has_up_to(text, MAX_NAME_CHARS);
    is_short && !text.trim().is_empty() && check_text("name", text).is_ok()
}

/// Whether a text has at most `most` characters.
pub(super) fn has_up_to(text: &str, most: usize) -> bool {
    text.chars().count() <= most
}

/// Whether a text has only ASCII letters, digits and dashes, and a length within `lengths`.
pub(super) fn is_word(text: &str, lengths: std::ops::RangeInclusive<usize>) -> bool {
    let allowed = |c: char| c.is_ascii_alphanumeric() || c == '-';
    lengths.contains(&text.len()) && text.chars().all(allowed)
}

fn check_styles(styles: &[Style]) -> Result<()> {
    let require = |holds: bool, problem: String| require(holds, "styles", problem);
    let most = format!("use up to {MAX_STYLES} styles");
    require(styles.len() <= MAX_STYLES, most)?;
    for (index, style) in styles.iter().enumerate() {
        let name = &style.name;
        let problem = format!(
            "name each style in up to {MAX_NAME_CHARS} characters, without control characters"
        );
        require(is_name(name), problem)?;
        let is_first = styles[..index].iter().all(|other| other.name != *name);
        require(is_first, format!("two styles are called {name:?}"))?;
        for (what, text, most) in [
            ("text", &style.text, MAX_TEXT_CHARS),
            ("guideline", &style.guideline, MAX_GUIDELINE_CHARS),
        ] {
            let problem = format!("the {what} of {name:?} has more than {most} characters");
            require(has_up_to(text, most), problem)?;
        }
        let is_colour = |text: &String| {
            text.strip_prefix('#').is_some_and(|digits| {
                digits.len() == 6 && digits.bytes().all(|byte| byte.is_ascii_hexdigit())
            })
        };
        let problem = format!("the colour of {name:?} is not written as #rrggbb");
        require(style.colour.as_ref().is_none_or(is_colour), problem)?;
    }
    Ok(())
}

fn check_guides(settings: &Settings) -> Result<()> {
    const MAX_GUIDE: usize = 100_000;
    for (kind, guide) in &settings.guides {
        let is_short = has_up_to(&guide.text, MAX_GUIDE) && guide.pictures.len() <= MAX_NAMES;
        let problem = format!("use up to {MAX_GUIDE} characters and {MAX_NAMES} pictures");
        require(is_short, &format!("guides.{kind}"), problem)?;
        for picture in &guide.pictures {
            check_picture_name(&picture.name)?;
        }
    }
    let problem = format!("use up to {MAX_GUIDE} characters");
    require(has_up_to(&settings.guide, MAX_GUIDE), "guide", problem)
}

fn check_rules(rules: &[Rule]) -> Result<()> {
    const MAX_RULES: usize = 20;
    let problem = format!("use up to {MAX_RULES} rules");
    require(rules.len() <= MAX_RULES, "rules", problem)?;
    for (index, rule) in rules.iter().enumerate() {
        let (name, kind) = (&rule.name, rule.accepts);
        let require = |holds: bool, field: &str, problem: &str| {
            require(holds, &format!("rules.{index}.{field}"), problem)
        };
        let problem =
            format!("{name:?} is no name of a rule; use 1 to 40 letters, digits and dashes");
        require(is_word(name, 1..=40), "name", &problem)?;
        let is_first = rules[..index].iter().all(|other| other.name != *name);
        require(is_first, "name", &format!("two rules are called {name}"))?;
        if kind == RuleKind::Trusted {
            let named = !rule.people.is_empty();
            require(named, "people", "name the people to trust")?;
        } else {
            let problem = format!("a rule that accepts {kind} has no people; leave them out");
            require(rule.people.is_empty(), "people", &problem)?;
        }
        let are_enough = (1..=50).contains(&rule.min_answers);
        let is_distance = (0.0..=1.0).contains(&rule.max_distance);
        let is_percent = rule.review_percent <= 100;
        require(are_enough, "min_answers", "use 1 to 50")?;
        require(is_distance, "max_distance", "use 0 to 1")?;
        require(is_percent, "review_percent", "use 0 to 100")?;
    }
    Ok(())
}

pub(super) fn check_picture_name(name: &str) -> Result<()> {
    let allowed = |c: char| c.is_ascii_alphanumeric() || matches!(c, '-' | '_' | '.');
    let is_allowed = (1..=60).contains(&name.len())
        && name.chars().all(allowed)
        && name.chars().any(|c| c != '.');
    let problem = format!(
        "{name:?} is no name of a picture; use up to 60 letters, digits, dashes, dots and underscores, and not dots alone"
    );
    require(is_allowed, "name", problem)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::wire::EditType;

    #[test]
    fn settings_are_bounded() {
        let rule = r#"{"name":"agreed","enabled":true,"accepts":"sampled"}"#;
        let good = Settings {
            styles: vec![Style {
                name: "old".to_owned(),
                text: "Short steps.".to_owned(),
                guideline: "Bend the knees.\n\nDo not limp.".to_owned(),
                colour: Some("#8f6B00".to_owned()),
            }],
            rules: vec![serde_json::from_str(rule).expect("a rule")],
            ..Settings::default()
        };
        assert!(check(&Settings::default()).is_ok() && check(&good).is_ok());
        let broken: [fn(&mut Settings); 18] = [
            |settings| settings.gold_percent = 101,
            |settings| settings.answers_per_task = 0,
            |settings| settings.lease_minutes = 0,
            |settings| settings.min_masks = 5,
            |settings| settings.edit_type_quota = [(EditType::Speed, MAX_QUOTA + 1)].into(),
            |settings| settings.styles = vec![Style::default()],
            |settings| settings.styles = vec![Style::named("a\u{0}b")],
            |settings| settings.styles.push(Style::named("old")),
            |settings| settings.styles[0].colour = Some("red".to_owned()),
            |settings| settings.styles[0].guideline = "x".repeat(MAX_GUIDELINE_CHARS + 1),
            |settings| settings.name = " ".to_owned(),
            |settings| settings.time_zone = "Mars/Olympus".to_owned(),
            |settings| settings.rules[0].name = "no spaces".to_owned(),
            |settings| settings.rules[0].review_percent = 101,
            |settings| settings.rules[0].max_distance = f64::NAN,
            // A rule `trusted` must name people; the others must not.
            |settings| settings.rules[0].people = vec![1],
            |settings| settings.rules[0].accepts = RuleKind::Trusted,
            |settings| settings.rules.push(settings.rules[0].clone()),
        ];
        for (index, change) in broken.iter().enumerate() {
            let mut broken = good.clone();
            change(&mut broken);
            assert!(check(&broken).is_err(), "{index}");
        }
    }
}
