//! Row types with the metadata columns only. Readers that need no frames use them and skip the frame columns.

use crate::table::{Caption, PartCaption, Quality, table};
use crate::{MotionId, Split};

table! {
    /// A clip without its frames. [`crate::table::ShardReader::rows`] reads no other column.
    pub struct ClipFacts = "motions" {
        /// Id of the clip
        pub id: MotionId [""],
        /// Its split
        pub split: Split [""],
        /// Kind of source
        pub source: String [""],
        /// Licence tag
        pub license: Option<String> [""],
        /// Id of the clip this one mirrors
        pub mirrored_of: Option<String> [""],
        /// Stored frame rate
        pub fps: f32 ["1/s"],
        /// Stored frames
        pub n_frames: i32 ["frame"],
        /// native, retargeted or fitted
        pub rotation_source: String [""],
        /// Mean distance between source and stored joints
        pub fit_error_m: Option<f32> ["m"],
        /// Captions
        pub captions: Vec<Caption> ["s"],
        /// Who wrote each of the captions
        pub caption_origins: Vec<String> ["", newer],
        /// Captions of body parts
        pub part_captions: Vec<PartCaption> [""],
        /// Action label
        pub action: Option<String> [""],
        /// Style label
        pub style: Option<String> [""],
        /// Findings of the quality checks
        pub quality: Quality [""],
    }
}

impl ClipFacts {
    /// Length in seconds.
    pub fn secs(&self) -> f64 {
        f64::from(self.n_frames) / f64::from(self.fps)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::record::MotionRow;
    use crate::table::Row;

    #[test]
    fn the_columns_are_those_of_the_table_without_frames() {
        let stored = MotionRow::columns();
        for column in ClipFacts::columns() {
            let same = stored.iter().find(|stored| stored.name == column.name);
            let same = same.expect("a column of the table");
            assert_eq!(
                (&same.data_type, same.nullable),
                (&column.data_type, column.nullable)
            );
            assert!(
                !column.type_name().contains("fixed_size"),
                "{}",
                column.name
            );
        }
    }
}
