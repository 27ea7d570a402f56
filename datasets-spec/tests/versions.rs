//! Datasets of every released schema version stay readable.

use std::path::Path;

use datasets_spec::record::{MotionRow, QuarantineRow};
use datasets_spec::{Dataset, Skeleton};

/// Opens a small dataset that was committed in the first version of the format.
#[test]
fn a_dataset_of_version_1_0_0_opens_and_its_missing_columns_are_empty() {
    let root = Path::new(env!("CARGO_MANIFEST_DIR")).join("../tests/data/datasets/1.0.0");
    let dataset = Dataset::open(&root).expect("every hash is as recorded");
    assert_eq!(dataset.manifest().schema_version, "1.0.0");
    let skeleton = dataset.skeleton().expect("built in");
    assert_eq!(skeleton, Skeleton::smplx_neutral());
    let motions: Vec<MotionRow> = dataset.read(None).expect("reads");
    assert_eq!(motions.len(), 3);
    for row in &motions {
        let motion = row.motion().expect("valid");
        assert_eq!(motion.content_hash(), row.content_hash);
        assert!(row.notes.is_empty() && !row.captions.is_empty());
    }
    let quarantine: Vec<QuarantineRow> = dataset.read(None).expect("reads");
    assert!(quarantine.is_empty());
}
