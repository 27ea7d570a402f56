//! Styles of the dataset, and new styles.

use annotate::transfer::from_dataset;
use annotate::wire::{
    Answer, Audit, BulkDone, Code, Decision, Me, ReviewNext, Rule, RuleKind, Settings, Style,
    TaskKind,
};
use datasets_spec::record::PairRow;
use serde_json::json;

use crate::support::{Client, START, Site, commit, from_json, read, rule, submit};

fn styled(name: &str) -> Answer {
    from_json(json!({
        "kind": "style", "verdict": "keep", "style": name, "extent": "whole", "text": "Walk like this.",
    }))
}

fn names(person: &Client) -> Vec<String> {
    let me: Me = person.get("me").ok();
    let styles = me.project.styles.into_iter();
    styles.map(|style| style.name).collect()
}

/// Adds style pairs with these labels to the dataset of a site, and imports them as the server does at its start.
fn label(site: &Site, labels: &[&str]) {
    let mut pairs: Vec<PairRow> = read(&site.dataset);
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
    let plan = format!("pairs of {labels:?}");
    commit(&site.dataset, &pairs, |row| row.split, &plan);
    let store = site.store.as_ref();
    let taken = from_dataset(store, &site.dataset, None, START, &mut |_, _| {});
    taken.expect("imports");
}

#[test]
fn every_label_of_the_dataset_can_be_chosen() {
    let site = Site::new();
    let ann = site.person("ann");
    let before = names(&ann);
    label(&site, &["masculine", "chimpira", "proud", "chimpira"]);
    let expected = [&before[..], &["masculine".into(), "chimpira".into()]].concat();
    assert_eq!(names(&ann), expected, "new ones come last, each once");
    label(&site, &[]);
    assert_eq!(names(&ann), expected);
    for style in ["chimpira", "masculine", "proud"] {
        ann.answer(styled(style));
    }
    site.whole();
}

#[test]
fn a_new_style_is_proposed_with_an_answer_and_taken_by_who_accepts_it() {
    let site = Site::new();
    label(&site, &["masculine", "chimpira"]);
    let [ann, bob, eve] = site.people(["ann", "bob", "eve"]);
    let all = Rule {
        max_distance: 1.0,
        ..rule("all", RuleKind::Sampled)
    };
    site.set(|settings| settings.rules = vec![all]);
    let known = names(&ann);

    // A name that is nearly a known one is refused to its author.
    let view = ann.claim(TaskKind::Style);
    let refused = ann.tell(&view, submit(&view, styled("PROUD")));
    let problem = refused.problem.expect("a refusal");
    assert_eq!(problem.field.as_deref(), Some("answer.style"));
    assert!(problem.detail.contains("\"proud\""), "{}", problem.detail);
    assert!(eve.review().is_none());

    // A rule accepts answers with a style of the project, and leaves the others to reviewers.
    ann.answer(styled("masculine"));
    let first = ann.answer(styled("limping"));
    let second = bob.answer(styled("Limping"));
    assert_eq!(names(&ann), known);
    let all = json!({ "filter": {}, "action": "accept" });
    let all: BulkDone = eve.post("bulk", &all).ok();
    assert_eq!((all.done, all.left_alone["new_style"]), (0, 2));

    let accept = |task: i64, author: i64| {
        let request = json!({ "queue": "sample", "task": task });
        let opened: ReviewNext = eve.post("review/next", &request).ok();
        let epoch = opened.review.expect("a review").lease.epoch;
        eve.decide(task, epoch, Decision::Accept, json!({ "author": author }))
    };
    assert_eq!(accept(first, ann.user.id).status, 200);
    assert_eq!(names(&bob), [&known[..], &["limping".to_owned()]].concat());
    let boss = site.person("boss");
    let changes: Audit = boss.get("audit?kind=settings_changed").ok();
    assert_eq!(changes.entries[0].actor, Some(eve.user.id));

    // The other spelling would become another style.
    let refused = accept(second, bob.user.id).problem();
    assert_eq!(refused.code, Code::Invalid);
    assert!(refused.detail.contains("\"limping\""), "{}", refused.detail);
    site.whole();
}

#[test]
fn guidelines_reach_annotators_and_may_be_long() {
    let site = Site::new();
    let [ann, boss] = site.people(["ann", "boss"]);
    let was: Settings = boss.get("settings").ok();
    let mut settings = was.clone();
    settings.styles.extend((0..40).map(|number| Style {
        guideline: "Bend the knees, and keep them bent.\n\nDo not limp.".repeat(150),
        ..Style::named(&format!("style {number}"))
    }));
    let body = serde_json::to_vec(&settings).expect("JSON");
    assert!(body.len() > annotate::wire::MAX_BODY_BYTES);
    let saved: Settings = boss.put_settings(&was, &settings).ok();
    assert_eq!(saved, settings);
    let me: Me = ann.get("me").ok();
    assert_eq!(me.project.styles, settings.styles);
    settings.styles[0].guideline = "x".repeat(annotate::wire::MAX_GUIDELINE_CHARS + 1);
    let refused = boss.put_settings(&saved, &settings).problem();
    assert!(refused.detail.contains("guideline"), "{}", refused.detail);
}
