//! The capture plan: which motions are still to be captured in which styles.

use annotate::store::{MotionRecord, NewTask};
use annotate::wire::{Audit, CapturePlan, Captures, Code, Decision, Me, PlannedCapture, TaskKind};
use serde_json::json;

use crate::fixture::each;
use crate::support::{
    Answered, Client, ROOT, START, Site, bare_motion, bare_task, from_json, style,
};

fn cell(motion: &str, style: &str, takes: u32) -> PlannedCapture {
    PlannedCapture {
        motion: motion.to_owned(),
        style: style.to_owned(),
        takes,
    }
}

/// Number of arrived, rejected and missing takes of each cell.
fn counts(captures: &Captures) -> Vec<(u32, u32, u32)> {
    let cells = captures.cells.iter();
    cells
        .map(|cell| (cell.arrived, cell.rejected, cell.missing))
        .collect()
}

/// A style pair whose label is `style`.
fn style_pair(number: usize, source: &str, style: Option<&str>) -> NewTask {
    NewTask {
        source: source.to_owned(),
        target: Some("styled".to_owned()),
        style: style.map(str::to_owned),
        ..bare_task(number, TaskKind::Style)
    }
}

#[test]
fn a_cell_fills_as_pairs_arrive_and_a_rejected_pair_empties_it() {
    let tasks = vec![
        style_pair(0, "hash", Some("proud")),
        style_pair(1, "hash", Some("old")),
        style_pair(2, "hash", None),
    ];
    each("captures", tasks, |site| {
        let store = &site.store;
        let planned = vec![
            cell("motion", "proud", 1),
            cell("motion", "old", 2),
            cell("walk", "old", 1),
        ];
        assert_eq!(store.captures().expect("no plan"), Captures::default());
        store.plan_captures(ROOT, planned, START).expect("a plan");
        let state = || store.captures().expect("captures");
        assert_eq!(counts(&state()), [(1, 0, 0), (1, 0, 1), (0, 0, 1)]);
        assert_eq!(state().unplanned, 1, "the pair without a style");
        assert!(state().cells[0].known && !state().cells[2].known);

        let walk = MotionRecord {
            hash: "hash of walk".to_owned(),
            id: "walk".to_owned(),
            ..bare_motion()
        };
        store.put_motions(vec![walk]).expect("a motion");
        site.import(vec![style_pair(3, "hash of walk", Some("old"))]);
        assert_eq!(counts(&state()), [(1, 0, 0), (1, 0, 1), (1, 0, 0)]);
        assert!(state().cells[2].known);

        // A person's "unnatural" verdict becomes a rejection once a reviewer accepts it.
        let unnatural = json!({ "kind": "style", "verdict": "unnatural" });
        let rejected = site.hand_in(site.ann, from_json(unnatural));
        assert_eq!(counts(&state())[0], (1, 0, 0));
        site.judge(Decision::Accept);
        assert_eq!(counts(&state())[0], (0, 1, 1));
        // A clip that was ingested again is another take, until a reviewer confirms the rejection.
        let anew = MotionRecord {
            hash: "new hash".to_owned(),
            ..bare_motion()
        };
        let changed = store.replace_motions(None, vec![anew], START);
        assert_eq!(changed.expect("replaced"), 3);
        assert_eq!(counts(&state())[0], (1, 0, 0));
        let kept = store.settle_changed(None, &[rejected], true, START);
        kept.expect("the rejection holds");
        assert_eq!(counts(&state())[0], (0, 1, 1));

        // The accepted style differs from the label.
        let seen = |decision: Decision| {
            site.hand_in(site.ann, style());
            site.judge(decision);
        };
        seen(Decision::Accept);
        assert_eq!(counts(&state()), [(1, 1, 0), (0, 0, 2), (1, 0, 0)]);
        seen(Decision::Accept);
        assert_eq!((counts(&state())[0], state().unplanned), ((2, 1, 0), 0));
        seen(Decision::Drop);
        assert_eq!(counts(&state())[2], (0, 1, 1));
    });
}

fn put(client: &Client, cells: Vec<PlannedCapture>) -> Answered {
    client.put("captures", &CapturePlan { cells })
}

#[test]
fn only_an_admin_changes_the_plan_it_brings_styles_and_a_wrong_one_changes_nothing() {
    let site = Site::new();
    let [ann, eve, boss] = site.people(["ann", "eve", "boss"]);
    let plan = || vec![cell("clip10", "proud", 1), cell("clip11", "limping", 1)];
    let planned: Captures = put(&boss, plan()).ok();
    assert_eq!(counts(&planned), [(1, 0, 0), (0, 0, 1)]);
    let me: Me = ann.get("me").ok();
    let mut styles = me.project.styles.iter();
    assert!(styles.any(|style| style.name == "limping"));
    for person in [&ann, &eve] {
        let refused = put(person, vec![cell("clip10", "old", 1)]);
        assert_eq!(refused.code(), Code::Forbidden);
    }
    assert_eq!(ann.get("captures").code(), Code::Forbidden);
    for (wrong, field, word) in [
        (cell("clip10", "proud", 2), "cells.2.motion", "twice"),
        (cell("clip10", "old", 0), "cells.2.takes", "1 to 1000"),
        (cell("clip10", "OLD", 1), "cells.2.style", "\"old\""),
        (cell(" clip10", "old", 1), "cells.2.motion", "space"),
        (cell("clip10", "", 1), "cells.2.style", "missing"),
    ] {
        let problem = put(&boss, [plan(), vec![wrong]].concat()).problem();
        let said = (problem.status, problem.field.as_deref());
        assert_eq!(said, (422, Some(field)));
        assert!(problem.detail.contains(word), "{}", problem.detail);
    }
    assert_eq!(eve.get("captures").ok::<Captures>(), planned);
    let log: Audit = boss.get("audit?kind=captures_planned").ok();
    let [entry] = log.entries.as_slice() else {
        panic!("one plan was taken: {}", log.entries.len());
    };
    assert_eq!(entry.actor, Some(boss.user.id));
    assert_eq!(entry.body["cells"][0]["motion"], "clip10");
    site.whole();
}
