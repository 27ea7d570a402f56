//! The tables that a dataset may have.

use datasets_spec::record::{
    EditRow, HumanMl3dRow, ItemRow, MarkerRow, MaskRow, MotionRow, NormalizerRow, PairRow,
    QuarantineRow, ScoreRow, SkippedRow, TripletRow, WindowRow,
};
use datasets_spec::table::{Column, Row};

/// The tables, with their columns.
pub(crate) fn tables() -> Vec<(&'static str, Vec<Column>)> {
    fn table<R: Row>() -> (&'static str, Vec<Column>) {
        (R::TABLE, R::columns())
    }
    vec![
        table::<MotionRow>(),
        table::<MarkerRow>(),
        table::<HumanMl3dRow>(),
        table::<MaskRow>(),
        table::<PairRow>(),
        table::<TripletRow>(),
        table::<WindowRow>(),
        table::<NormalizerRow>(),
        table::<ItemRow>(),
        table::<EditRow>(),
        table::<ScoreRow>(),
        table::<QuarantineRow>(),
        table::<SkippedRow>(),
    ]
}
