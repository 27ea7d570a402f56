//! What the command says of itself.

use crate::util::stance;

/// The verbs of this version; scripts rely on them.
const VERBS: [&str; 23] = [
    "demo", "run", "build", "corpus", "doctor", "ingest", "inspect", "verify", "stats", "export",
    "annotate", "masks", "pairs", "triplets", "items", "train", "model", "edit", "edits", "eval",
    "sweep", "report", "render",
];

#[test]
fn every_verb_explains_itself_and_its_options() {
    let help = stance(&["--help"]).expect_code(0).stdout;
    for verb in VERBS {
        assert!(help.contains(&format!("\n  {verb}")), "{verb} is listed");
        let help = stance(&[verb, "--help"]).expect_code(0).stdout;
        assert!(help.lines().count() > 10, "{verb}: {help}");
        for option in ["--threads", "--seed", "--json", "--quiet", "--no-progress"] {
            assert!(help.contains(option), "{verb} lacks {option}");
        }
    }
}

#[test]
fn usage_errors_exit_with_2() {
    stance(&["ingest"]).expect_code(2);
    stance(&["no-such-verb"]).expect_code(2);
    stance(&["ingest", "x", "--out", "y", "--fps", "-1"]).expect_code(2);
    stance(&["ingest", "x", "--out", "y", "--allow-quarantine", "200%"]).expect_code(2);
}
