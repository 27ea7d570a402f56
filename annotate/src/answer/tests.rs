use serde_json::{Value, json};

use super::*;
use crate::wire::{JointChoice, JointWeight};

/// Frames of the clip.
const FRAMES: i64 = 40;
const ARM: (&[&str], &str) = (&["LEFT_ARM"], "waving");

fn said(json: Value) -> Answer {
    serde_json::from_value(json).expect("an answer")
}

fn masks(list: &[(&[&str], &str)]) -> Answer {
    let masks = list.iter();
    let masks = masks.map(|(parts, text)| json!({ "parts": parts, "text": text }));
    said(json!({ "kind": "mask_text", "masks": Vec::from_iter(masks) }))
}

fn pair(verdict: &str) -> Answer {
    said(json!({ "kind": "pair", "verdict": verdict }))
}

fn code(answer: &Answer) -> Option<Code> {
    match check_submission(answer, answer.kind(), &Settings::default(), (FRAMES, 20.0)) {
        Ok(()) => None,
        Err(error) => Some(error.problem().code),
    }
}

#[test]
fn two_to_four_masks_are_asked_for_and_a_reason_excuses() {
    let arm = json!([{ "parts": ["LEFT_ARM"], "text": "waving" }]);
    let excused = json!({ "kind": "mask_text", "masks": arm, "count_reason": "single_action" });
    for (answer, expected) in [
        (masks(&[ARM, (&["LOWER_BODY"], "walking")]), None),
        (masks(&[ARM]), Some(Code::MaskCount)),
        (masks(&[]), Some(Code::MaskCount)),
        (said(excused), None),
    ] {
        assert_eq!(code(&answer), expected);
    }
    let long = "x".repeat(MAX_TEXT_CHARS + 1);
    let others: [(&[&str], &str); 7] = [
        ARM,
        (&[], "walking"),
        (&["LOWER_BODY"], " "),
        (&["TAIL"], "wagging"),
        (&["HEAD", "HEAD"], "x"),
        (&["HEAD"], &long),
        (&["HEAD"], "a\u{0}b"),
    ];
    for other in others {
        assert_eq!(code(&masks(&[ARM, other])), Some(Code::Invalid));
    }
}

/// An answer with two equal masks of the left arm, to which `change` is applied.
fn two_arms(change: impl FnOnce(&mut [MaskAnswer])) -> Answer {
    let mut answer = masks(&[ARM, ARM]);
    if let Answer::MaskText { masks, .. } = &mut answer {
        change(masks);
    }
    answer
}

fn collar(weight: JointWeight) -> Vec<JointChoice> {
    let joint = "left_collar".to_owned();
    vec![JointChoice { joint, weight }]
}

#[test]
fn masks_of_other_frames_or_joints_are_no_doubles() {
    let hard = || collar(JointWeight::Hard);
    let later = two_arms(|masks| masks[1].range = Some([9, 40]));
    assert_eq!(code(&later), None);
    assert_eq!(code(&two_arms(|masks| masks[1].joints = hard())), None);
    for doubled in [
        two_arms(|masks| masks.iter_mut().for_each(|mask| mask.range = Some([0, 31]))),
        two_arms(|masks| masks[1].range = Some([0, 40])),
        two_arms(|masks| masks.iter_mut().for_each(|mask| mask.joints = hard())),
    ] {
        assert_eq!(code(&doubled), Some(Code::Invalid));
    }
    // The mask from frame 9 on has 31 of the 40 frames of its nearest mask; each of the other three has an equal
    // one.
    let apart = distance(&later, &two_arms(|_| ()), FRAMES);
    assert!((apart - 9.0 / 160.0).abs() < 1e-12, "{apart}");
}

#[test]
fn an_imported_answer_says_the_same_where_its_layout_has_no_place() {
    let plain = two_arms(|_| ());
    let ours = two_arms(|masks| {
        masks[0].range = Some([0, 20]);
        masks[1].soft = false;
    });
    assert!(says(&ours, &plain) && !says(&plain, &ours));
    // The order of masks does not count. The first imported mask agrees with both of ours, the second with the first alone.
    let turned = two_arms(|masks| masks[1].range = Some([0, 20]));
    assert!(says(&ours, &turned));
    let ranges = |masks: &mut [MaskAnswer]| {
        masks.iter_mut().for_each(|mask| mask.range = Some([0, 20]));
    };
    assert!(!says(&ours, &two_arms(ranges)));
    let longer = two_arms(|masks| masks[0].range = Some([0, 21]));
    assert!(!says(&ours, &longer));
    // Without its soft ring, a mask equals one whose ring joints are all excluded.
    let chosen = two_arms(|masks| masks[1].joints = collar(JointWeight::None));
    assert!(says(&ours, &chosen) && says(&chosen, &two_arms(|masks| masks[1].soft = false)));
}

#[test]
fn answers_share_their_words_or_contradict_each_other() {
    let raised = |text: &str, note: &str| {
        said(json!({
            "kind": "pair", "verdict": "keep", "parts": ["LEFT_ARM"], "edit_type": "spatial", "text": text,
            "note": note,
        }))
    };
    let (higher, lower) = (raised("raise it", ""), raised("lower it", ""));
    assert!(share_words(&[
        higher.clone(),
        raised(" raise it ", "at the end")
    ]));
    assert!(!share_words(&[higher, lower]));
    assert!(share_words(&[pair("unclear"), pair("unclear")]));
}

#[test]
fn a_pair_that_is_kept_needs_all_and_a_rejected_one_nothing() {
    let kept = json!({
        "kind": "pair", "verdict": "keep", "parts": ["LEFT_ARM"], "edit_type": "speed", "text": "faster",
    });
    assert_eq!(code(&said(kept.clone())), None);
    assert!(check_draft(&said(kept.clone()), TaskKind::Style).is_err());
    for verdict in ["unnatural", "unclear", "identical"] {
        assert_eq!(code(&pair(verdict)), None);
    }
    for field in ["parts", "edit_type"] {
        let mut lacking = kept.clone();
        lacking.as_object_mut().expect("fields").remove(field);
        assert_eq!(code(&said(lacking)), Some(Code::Invalid), "{field}");
    }
}

#[test]
fn a_style_is_one_of_the_project_or_a_clearly_new_one() {
    let style = |name: &str, extent: Option<&str>| {
        said(json!({ "kind": "style", "verdict": "keep", "style": name, "extent": extent }))
    };
    let whole = |name: &str| style(name, Some("whole"));
    let settings = Settings::default();
    for (name, new) in [("proud", None), ("limping", Some("limping"))] {
        assert_eq!(code(&whole(name)), None);
        assert_eq!(whole(name).new_style(&settings), new);
    }
    assert_eq!(code(&style("proud", None)), Some(Code::Invalid));
    for name in ["Proud", " proud", "", &"x".repeat(101)] {
        assert_eq!(code(&whole(name)), Some(Code::Invalid), "{name:?}");
    }
}

#[test]
fn distances_by_hand() {
    let [arm, arms, legs] =
        ["LEFT_ARM", "BOTH_ARMS", "BOTH_LEGS"].map(|part| masks(&[(&[part], "a")]));
    let each_arm = masks(&[(&["LEFT_ARM", "RIGHT_ARM"], "a")]);
    let both = masks(&[(&["LEFT_ARM"], "a"), (&["BOTH_LEGS"], "b")]);
    let unclear = pair("unclear");
    for (a, b, expected) in [
        (&arm, &legs, 1.0),
        // One of two masks has a counterpart, and so does the only mask of the other answer.
        (&arm, &both, 0.25),
        // Half of the joints of both arms.
        (&arm, &arms, 0.5),
        (&each_arm, &arms, 0.0),
        (&masks(&[]), &arm, 1.0),
        (&pair("keep"), &unclear, 1.0),
        (&unclear, &unclear, 0.0),
    ] {
        assert!((distance(a, b, FRAMES) - expected).abs() < 1e-12, "{a:?}");
    }
    assert_eq!(spread(std::slice::from_ref(&arm), FRAMES), None);
    assert_eq!(spread(&[arm.clone(), arm, legs], FRAMES), Some(1.0));
}

#[test]
fn text_distance_by_hand() {
    for (a, b, expected) in [
        ("", "", 0.0),
        ("abc", "abc", 0.0),
        ("kitten", "sitting", 3.0 / 7.0),
        ("", "abcd", 1.0),
        ("größer", "größte", 2.0 / 6.0),
    ] {
        assert!((text_distance(a, b) - expected).abs() < 1e-12, "{a} {b}");
    }
}

#[test]
fn a_description_completes_a_sentence_and_becomes_one_in_the_dataset() {
    for (text, short, whole) in [
        ("waving", "waving", "The person is waving."),
        (" The person is waving. ", "waving", "The person is waving."),
        (
            "slowly waving.",
            "slowly waving.",
            "The person is slowly waving.",
        ),
        ("raise the arm", "raise the arm", "raise the arm"),
        (
            "bring both arms up",
            "bring both arms up",
            "bring both arms up",
        ),
        ("", "", ""),
    ] {
        assert_eq!(completion(text), short);
        assert_eq!(sentence(text), whole);
        assert_eq!(sentence(&sentence(text)), whole, "once is enough");
    }
}
