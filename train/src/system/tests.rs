use super::*;

#[test]
fn a_warning_names_some_of_many_unknown_words() {
    let check = |count: usize, expected: &str| {
        let unknown_words = (0..count).map(|word| format!("w{word:02}")).collect();
        let remarks = Remarks {
            unknown_words,
            ..Remarks::default()
        };
        let line = remarks.lines().concat();
        assert!(line.contains(expected), "{line}");
    };
    check(12, "w10, w11: it cannot");
    check(15, "w11 and 3 more words: it");
}

#[test]
fn numbers_that_make_no_motion_are_refused() {
    let check = |guidance, temperature, prior| {
        let config = EditConfig {
            guidance,
            temperature,
            prior,
            ..EditConfig::default()
        };
        config.check().map_err(|error| error.to_string())
    };
    assert_eq!(check(None, None, None), Ok(()));
    assert_eq!(check(Some(-1.0), Some(0.0), Some(0.0)), Ok(()));
    for (refused, field) in [
        (check(Some(f64::NAN), None, None), "guidance"),
        (check(None, Some(-1.0), None), "temperature"),
        (check(None, None, Some(f64::INFINITY)), "prior"),
    ] {
        let error = refused.expect_err("not usable");
        assert!(error.contains(field), "{error}");
    }
    let ignored = EditConfig {
        fit: FitMethod::Paper,
        prior: Some(0.1),
        ..EditConfig::default()
    };
    let error = ignored.check().expect_err("not used").to_string();
    assert!(error.contains("prior"), "{error}");
}

#[test]
fn settings_that_differ_stand_in_the_name() {
    let named = |slot, guidance: f64, steps: usize, from_source: bool| {
        let settings = [
            changed("guidance", guidance, 1.0),
            changed("steps", steps, 20),
            from_source.then(|| "from source".to_owned()),
        ];
        named_with("MotionReFit tiny".to_owned(), slot, settings)
    };
    assert_eq!(named(Slot::Best, 1.0, 20, false), "MotionReFit tiny");
    assert_eq!(
        named(Slot::Epoch(5), 3.0, 10, true),
        "MotionReFit tiny (checkpoint epoch-5, guidance 3, steps 10, from source)"
    );
    let name = named(Slot::Best, 0.25, 20, false);
    assert_eq!(name, "MotionReFit tiny (guidance 0.25)");
}
