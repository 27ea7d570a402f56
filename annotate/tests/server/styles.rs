//! Styles of the dataset's own, and new ones.

use annotate::wire::{
    Answer, Audit, BulkAction, BulkDone, BulkRequest, Code, EventResults, Extent, Me, ReviewNext,
    Role, Rule, RuleKind, Settings, Style, TaskFilter, TaskKind, Verdict,
};
use datasets_spec::dataset::commit_rows;
use datasets_spec::record::PairRow;
use datasets_spec::{Dataset, Skeleton};
use serde_json::json;

use crate::support::{Client, START, Site, key, submit};

fn styled(name: &str) -> Answer {
    Answer::Style {
        verdict: Verdict::Keep,
        parts: Vec::new(),
        style: Some(name.to_owned()),
        extent: Some(Extent::Whole),
        text: "Walk like this.".to_owned(),
        suggestion: None,
        note: String::new(),
    }
}

/// Names that a person can choose from.
fn names(person: &Client) -> Vec<String> {
    let me: Me = person.get("me").ok();
    let styles = me.project.styles.into_iter();
    styles.map(|style| style.name).collect()
}

/// Adds style pairs of these labels to the dataset of a site, and imports them as the server does at its start.
pub(crate) fn label(site: &Site, labels: &[&str]) {
    let mut pairs: Vec<PairRow> = Dataset::open(&site.dataset)
        .expect("a dataset")
        .read(None)
        .expect("pairs");
    let one = pairs.iter().find(|pair| pair.kind == "style");
    let one = one.expect("a style pair").clone();
    let sources: Vec<_> = pairs.iter().map(|pair| pair.source_id.clone()).collect();
    pairs.extend(labels.iter().enumerate().map(|(at, label)| PairRow {
        id: format!("own{at}"),
        source_id: one.target_id.clone(),
        target_id: sources[at].clone(),
        style: Some((*label).to_owned()),
        ..one.clone()
    }));
    commit_rows(
        &site.dataset,
        &pairs,
        Some(|row: &PairRow| row.split),
        &Skeleton::smplx_neutral(),
        &format!("pairs of {labels:?}"),
        "test",
    )
    .expect("pairs");
    annotate::transfer::from_dataset(
        site.store.as_ref(),
        &site.dataset,
        None,
        START,
        &mut |_, _| {},
    )
    .expect("imports");
}

#[test]
fn every_label_of_the_dataset_can_be_chosen() {
    let site = Site::new();
    let ann = site.person("ann", Role::Annotator);
    let before = names(&ann);
    label(&site, &["masculine", "chimpira", "proud", "chimpira"]);
    let expected = [&before[..], &["masculine".into(), "chimpira".into()]].concat();
    assert_eq!(names(&ann), expected, "new ones come last, each once");
    label(&site, &[]);
    assert_eq!(names(&ann), expected);
    for style in ["chimpira", "masculine", "proud"] {
        ann.answer(TaskKind::Style, styled(style));
    }
    assert_eq!(site.store.verify().expect("checks"), Vec::<String>::new());
}

#[test]
fn a_new_style_is_proposed_with_an_answer_and_taken_by_who_accepts_it() {
    let site = Site::new();
    label(&site, &["masculine", "chimpira"]);
    let people = [("ann", Role::Annotator), ("bob", Role::Annotator)];
    let [ann, bob] = people.map(|(name, role)| site.person(name, role));
    let eve = site.person("eve", Role::Reviewer);
    let rule = Rule {
        name: "all".to_owned(),
        enabled: true,
        accepts: RuleKind::Sampled,
        kinds: Vec::new(),
        people: Vec::new(),
        min_answers: 1,
        max_distance: 1.0,
        review_percent: 0,
    };
    let settings = Settings {
        rules: vec![rule],
        ..site.store.settings().expect("settings")
    };
    site.store.put_settings(1, settings, START).expect("a rule");
    let known = names(&ann);

    // A rule accepts what names a style of the project, and leaves the others to reviewers.
    ann.answer(TaskKind::Style, styled("masculine"));
    let first = ann.answer(TaskKind::Style, styled("limping"));
    let second = bob.answer(TaskKind::Style, styled("Limping"));
    assert_eq!(names(&ann), known);
    let all: BulkDone = eve
        .post(
            "bulk",
            &BulkRequest {
                filter: TaskFilter::default(),
                action: BulkAction::Accept,
                comment: String::new(),
                person: None,
                after: None,
            },
        )
        .ok();
    assert_eq!((all.done, all.left_alone["new_style"]), (0, 2));

    let accept = |task: i64, author: i64| {
        let opened: ReviewNext = eve
            .post("review/next", &json!({ "queue": "sample", "task": task }))
            .ok();
        let lease = opened.review.expect("a review").lease;
        eve.post(
            "reviews",
            &json!({ "idem_key": key(), "task": task, "decision": "accept", "author": author,
                     "lease_epoch": lease.epoch }),
        )
    };
    assert_eq!(accept(first, ann.user.id).status, 200);
    assert_eq!(names(&bob), [&known[..], &["limping".to_owned()]].concat());
    let changes: Audit = site
        .person("root2", Role::Admin)
        .get("audit?kind=settings_changed")
        .ok();
    assert_eq!(changes.entries[0].actor, Some(eve.user.id));

    // The other spelling would be another style.
    let refused = accept(second, bob.user.id).problem();
    assert_eq!(refused.code, Code::Invalid);
    assert!(refused.detail.contains("\"limping\""), "{}", refused.detail);
    assert_eq!(site.store.verify().expect("checks"), Vec::<String>::new());
}

#[test]
fn a_name_that_is_nearly_a_known_one_is_refused_to_its_author() {
    let site = Site::new();
    let ann = site.person("ann", Role::Annotator);
    let view = ann.claim(TaskKind::Style);
    let sent: EventResults = ann
        .post(
            &format!("tasks/{}/events", view.task.id),
            &json!({ "events": [submit(&view, styled("PROUD"))] }),
        )
        .ok();
    let problem = sent.results[0].problem.as_ref().expect("a refusal");
    assert_eq!(problem.field.as_deref(), Some("answer.style"));
    assert!(problem.detail.contains("\"proud\""), "{}", problem.detail);
    let empty: ReviewNext = site
        .person("eve", Role::Reviewer)
        .post("review/next", &json!({ "queue": "sample" }))
        .ok();
    assert!(empty.review.is_none());
}

#[test]
fn settings_of_older_stores_have_names_alone() {
    let mut stored = serde_json::to_value(Settings::default()).expect("JSON");
    stored["styles"] = json!(["proud", { "name": "old", "text": "Short steps." }]);
    let read: Settings = serde_json::from_value(stored).expect("settings");
    let old = Style {
        text: "Short steps.".to_owned(),
        ..Style::named("old")
    };
    assert_eq!(read.styles, [Style::named("proud"), old]);
}

#[test]
fn guidelines_reach_annotators_and_may_be_long() {
    let site = Site::new();
    let people = [("ann", Role::Annotator), ("boss", Role::Admin)];
    let [ann, boss] = people.map(|(name, role)| site.person(name, role));
    let mut settings: Settings = boss.get("settings").ok();
    settings.styles.extend((0..40).map(|number| Style {
        guideline: "Bend the knees, and keep them bent.\n\nDo not limp.".repeat(150),
        ..Style::named(&format!("style {number}"))
    }));
    let body = serde_json::to_vec(&settings).expect("JSON");
    assert!(body.len() > annotate::wire::MAX_BODY_BYTES);
    let saved: Settings = boss.call("PUT", "settings", Some(&body)).ok();
    assert_eq!(saved, settings);
    let me: Me = ann.get("me").ok();
    assert_eq!(me.project.styles, settings.styles);
    settings.styles[0].guideline = "x".repeat(annotate::wire::MAX_GUIDELINE_CHARS + 1);
    let body = serde_json::to_vec(&settings).expect("JSON");
    let refused = boss.call("PUT", "settings", Some(&body)).problem();
    assert!(refused.detail.contains("guideline"), "{}", refused.detail);
}

#[test]
fn a_style_without_a_guideline_is_written_as_before_there_were_any() {
    let stored = r##"{"name":"old","text":"Short steps.","colour":"#8f6b00"}"##;
    let style: Style = serde_json::from_str(stored).expect("a style");
    assert_eq!(style.guideline, "");
    assert_eq!(serde_json::to_string(&style).expect("JSON"), stored);
}
