//! Numbers printed in the paper and its successors, for comparison with measured ones.
//!
//! Their authors measured them with their own encoders and test sets, so they show only the order of magnitude to
//! expect; every row built from them is marked. The papers do not state the number of items n, but the printed recalls
//! are multiples of 1/n and determine it.

use std::cmp::Reverse;
use std::collections::BTreeMap;

use crate::metric::diversity::DIVERSITY;
use crate::metric::fid::FID;
use crate::metric::foot_score::FOOT_SCORE;
use crate::metric::{self, Metric, Part};
use crate::protocol::{Gallery, PAPER_GALLERY};
use crate::table::{Cell, Row, RowGroup, Table};

/// A printed value, with the half width of its interval if one is printed.
type Value = Option<(f64, Option<f64>)>;

/// Number of columns of the paper's Table 1.
const NUM_COLUMNS: usize = 11;

/// The printed columns, in order.
fn columns() -> Vec<&'static Metric> {
    metric::of_part(Part::Paper)
}

/// The rows of one task in a table of the paper.
#[derive(Clone, Copy, Debug)]
struct Published {
    table: PaperTable,
    /// Name of the task in this project.
    task: &'static str,
    rows: &'static [Printed],
}

/// A row as printed.
#[derive(Clone, Copy, Debug)]
struct Printed {
    system: &'static str,
    /// Number of items in the galleries, if the printed recalls determine it.
    n: Option<u32>,
    values: [Value; NUM_COLUMNS],
}

impl Published {
    /// The rows of the table with the given columns, all marked as published.
    fn rows(&self, metrics: &[&Metric]) -> Vec<Row> {
        self.rows
            .iter()
            .map(|printed| Row {
                system: printed.system.to_owned(),
                group: RowGroup::Published,
                takes: 0,
                cells: metrics
                    .iter()
                    .map(|metric| {
                        let place = columns().iter().position(|known| known == metric)?;
                        let (mean, ci95) = printed.values[place]?;
                        let best = false;
                        Some(Cell { mean, ci95, best })
                    })
                    .collect(),
            })
            .collect()
    }

    /// Sentences that state the number of items behind each published row and behind the measured rows (`num_items`),
    /// and whether published rows are comparable with each other.
    fn note(&self, num_items: u32) -> String {
        // Descending numbers; rows whose shares fit no number come last.
        let mut counts: BTreeMap<Reverse<Option<u32>>, Vec<&str>> = BTreeMap::new();
        for printed in self.rows {
            let systems = counts.entry(Reverse(printed.n)).or_default();
            systems.push(printed.system);
        }
        let known = counts.keys().filter(|n| n.0.is_some()).count();
        let parts: Vec<String> = counts
            .into_iter()
            .map(|(Reverse(n), systems)| {
                let systems = systems.join(", ");
                match n {
                    Some(n) => format!("{n} items ({systems})"),
                    None => format!("an unknown number of items ({systems})"),
                }
            })
            .collect();
        let differ = match self.table.gallery() {
            _ if known == 0 => "",
            Gallery::Full => {
                " A rank among fewer items is a better one, so rows of different numbers are not \
                 comparable."
            }
            Gallery::Batches(_) if known > 1 => {
                " Rows of different numbers are not of the same test items."
            }
            Gallery::Batches(_) => "",
        };
        format!(
            "Published rows were measured on {}; the rows above on {num_items}.{differ}",
            parts.join(", ")
        )
    }
}

/// A result table of the paper.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum PaperTable {
    /// Body part replacement and style transfer.
    One,
    /// MotionFix in galleries of 32.
    Two,
    /// Fine-grained adjustment.
    A1,
    /// Ablations of fine-grained adjustment.
    A2,
    /// MotionFix in one gallery of the whole test set.
    A3,
}

impl PaperTable {
    /// The columns, in the paper's order.
    pub fn columns(self) -> Vec<&'static Metric> {
        let left_out: &[&Metric] = match self {
            Self::One | Self::A1 => &[],
            Self::Two => &[&FID, &DIVERSITY, &FOOT_SCORE],
            Self::A2 => &[&DIVERSITY, &FOOT_SCORE],
            Self::A3 => &[&DIVERSITY],
        };
        columns()
            .into_iter()
            .filter(|metric| !left_out.contains(metric))
            .collect()
    }

    /// Size of a retrieval gallery.
    pub fn gallery(self) -> Gallery {
        match self {
            Self::A3 => Gallery::Full,
            Self::One | Self::Two | Self::A1 | Self::A2 => Gallery::Batches(PAPER_GALLERY),
        }
    }

    /// The tasks of the table.
    pub fn tasks(self) -> Vec<&'static str> {
        let parts = TABLES.iter().filter(|part| part.table == self);
        parts.map(|part| part.task).collect()
    }

    /// Title of the table in the paper.
    pub fn title(self) -> &'static str {
        match self {
            Self::One => "Table 1",
            Self::Two => "Table 2",
            Self::A1 => "Table A1",
            Self::A2 => "Table A2",
            Self::A3 => "Table A3",
        }
    }
}

impl Table {
    /// Appends the published rows for the same task, and a note about the data that they were measured on. Returns
    /// whether there are such rows.
    pub fn append_published(&mut self, table: PaperTable) -> bool {
        let is_of = |part: &&Published| part.table == table && part.task == self.task;
        let Some(published) = TABLES.iter().find(is_of) else {
            return false;
        };
        let metrics: Vec<&Metric> = self.columns.iter().map(|column| column.metric).collect();
        self.rows.extend(published.rows(&metrics));
        self.notes.push(published.note(self.items.count));
        true
    }
}

const NONE: Value = None;

const fn row(system: &'static str, n: Option<u32>, values: [Value; NUM_COLUMNS]) -> Printed {
    Printed { system, n, values }
}

const fn mean(mean: f64) -> Value {
    Some((mean, None))
}

const fn ci(mean: f64, half_width: f64) -> Value {
    Some((mean, Some(half_width)))
}

/// The result tables of the paper, with its columns in the order of Table 1.
///
/// Many intervals of Table 1 are misprinted, such as `±.1.286`; they are read as 1.286. The foot
/// score's arrow of Table 1 is a misprint too.
///
/// # Source
/// Paper, Tables 1, 2, A1, A2 and A3. "Ours" is named MotionReFit. Later rows have only the metrics of targets. They
/// are from CIME (arXiv 2608.16008), Tables 1 and 2, and the papers it cites; the code of three of them scores a random
/// half of the test set.
#[rustfmt::skip]
#[expect(clippy::approx_constant, reason = "a printed rank of 6.28 is not a circle")]
const TABLES: &[Published] = &[
    Published { table: PaperTable::One, task: "semantic", rows: &[
        row("Real Data", None, [ci(0.01, 0.001), ci(36.06, 0.436), ci(0.98, 0.0), ci(52.08, 0.371), ci(54.32, 0.314), ci(56.0, 0.365), ci(8.28, 0.045), ci(100.0, 0.0), ci(100.0, 0.0), ci(100.0, 0.0), ci(1.0, 0.0)]),
        row("MDM-BP", None, [ci(0.44, 0.03), ci(36.71, 0.701), ci(0.91, 0.003), ci(69.11, 0.912), ci(79.75, 0.711), ci(85.14, 0.561), ci(2.2, 0.028), ci(39.05, 0.469), ci(46.39, 0.441), ci(50.57, 0.556), ci(8.92, 0.033)]),
        row("TMED", None, [ci(0.52, 0.034), ci(35.37, 0.54), ci(0.9, 0.008), ci(38.59, 0.169), ci(44.1, 0.932), ci(48.67, 0.911), ci(9.31, 0.211), ci(42.7, 1.533), ci(52.89, 1.286), ci(58.32, 1.43), ci(6.47, 0.118)]),
        row("TMED w/ MCM", None, [ci(0.54, 0.028), ci(35.67, 0.482), ci(0.9, 0.006), ci(41.29, 0.631), ci(46.13, 0.881), ci(49.8, 0.945), ci(9.38, 0.095), ci(50.62, 1.612), ci(61.95, 1.421), ci(68.52, 1.484), ci(4.48, 0.119)]),
        row("MotionReFit w/o MCM", None, [ci(0.23, 0.026), ci(36.34, 0.62), ci(0.96, 0.003), ci(93.17, 0.273), ci(96.3, 0.178), ci(97.33, 0.206), ci(1.27, 0.011), ci(51.18, 0.206), ci(53.71, 0.275), ci(55.3, 0.371), ci(8.51, 0.02)]),
        row("MotionReFit w/o BC", None, [ci(0.23, 0.016), ci(36.18, 0.523), ci(0.97, 0.003), ci(52.51, 0.595), ci(56.03, 0.368), ci(58.19, 0.358), ci(7.54, 0.038), ci(60.78, 0.471), ci(67.17, 0.457), ci(71.11, 0.521), ci(4.74, 0.042)]),
        row("MotionReFit", None, [ci(0.2, 0.025), ci(36.01, 0.758), ci(0.97, 0.002), ci(52.48, 0.337), ci(56.13, 0.361), ci(58.59, 0.234), ci(7.46, 0.034), ci(61.37, 0.457), ci(68.35, 0.493), ci(72.2, 0.314), ci(4.65, 0.029)]),
    ] },
    Published { table: PaperTable::One, task: "style", rows: &[
        row("Real Data", None, [ci(0.01, 0.001), ci(33.98, 0.865), ci(0.98, 0.0), ci(50.94, 1.791), ci(62.88, 0.925), ci(67.4, 0.828), ci(6.28, 0.058), ci(100.0, 0.0), ci(100.0, 0.0), ci(100.0, 0.0), ci(1.0, 0.0)]),
        row("MDM-BP", None, [ci(0.39, 0.033), ci(33.64, 0.835), ci(0.89, 0.01), ci(62.4, 1.977), ci(82.78, 1.1), ci(89.62, 1.156), ci(1.96, 0.062), ci(38.89, 2.152), ci(53.51, 1.167), ci(60.24, 1.122), ci(7.14, 0.071)]),
        row("TMED", None, [ci(1.54, 0.093), ci(34.37, 1.111), ci(0.9, 0.01), ci(28.44, 1.156), ci(40.03, 1.173), ci(46.53, 1.28), ci(8.48, 0.104), ci(24.76, 1.44), ci(38.33, 2.067), ci(45.62, 0.934), ci(8.12, 0.099)]),
        row("TMED w/ MCM", None, [ci(0.84, 0.06), ci(34.35, 0.669), ci(0.92, 0.004), ci(39.83, 1.522), ci(55.0, 1.608), ci(62.92, 1.463), ci(5.37, 1.112), ci(33.02, 1.024), ci(47.6, 1.303), ci(56.94, 1.242), ci(6.15, 0.072)]),
        row("MotionReFit w/o MCM", None, [ci(0.23, 0.017), ci(34.05, 1.077), ci(0.93, 0.006), ci(87.05, 1.345), ci(98.33, 0.556), ci(99.41, 0.313), ci(1.16, 0.012), ci(51.39, 1.406), ci(63.58, 1.058), ci(67.88, 0.699), ci(7.15, 0.102)]),
        row("MotionReFit w/o BC", None, [ci(0.16, 0.018), ci(34.51, 0.681), ci(0.95, 0.003), ci(45.52, 1.146), ci(57.05, 1.12), ci(62.29, 0.81), ci(6.57, 0.08), ci(62.26, 1.838), ci(74.69, 0.814), ci(79.9, 1.227), ci(3.51, 0.081)]),
        row("MotionReFit", None, [ci(0.14, 0.015), ci(34.19, 0.865), ci(0.94, 0.004), ci(47.67, 1.099), ci(57.71, 1.039), ci(62.5, 0.439), ci(6.46, 0.086), ci(63.82, 1.551), ci(76.35, 0.988), ci(80.69, 1.009), ci(3.48, 0.062)]),
    ] },
    Published { table: PaperTable::A1, task: "fine-grained", rows: &[
        row("Real Data", None, [mean(0.02), mean(30.57), mean(0.97), mean(39.54), mean(54.65), mean(61.16), mean(5.53), mean(100.0), mean(100.0), mean(100.0), mean(1.0)]),
        row("MDM-BP", None, [mean(0.62), mean(32.7), mean(0.92), mean(28.12), mean(34.38), mean(38.02), mean(10.41), mean(16.45), mean(24.52), mean(30.21), mean(11.6)]),
        row("TMED", Some(384), [mean(0.33), mean(31.13), mean(0.94), mean(60.16), mean(72.66), mean(82.03), mean(2.66), mean(29.69), mean(44.01), mean(52.08), mean(6.97)]),
        row("TMED w/ MCM", None, [mean(0.33), mean(31.42), mean(0.94), mean(62.8), mean(74.78), mean(87.0), mean(2.61), mean(32.22), mean(45.03), mean(54.83), mean(6.56)]),
        row("MotionReFit w/o MCM", Some(384), [mean(0.34), mean(31.08), mean(0.95), mean(81.77), mean(92.45), mean(93.49), mean(1.48), mean(34.11), mean(48.7), mean(57.03), mean(5.77)]),
        row("MotionReFit", Some(384), [mean(0.29), mean(31.29), mean(0.95), mean(85.16), mean(92.97), mean(95.31), mean(1.38), mean(42.45), mean(56.25), mean(62.76), mean(5.12)]),
        row("SimMotionEdit", Some(192), [NONE, NONE, NONE, NONE, NONE, NONE, NONE, mean(36.46), mean(48.96), mean(57.81), mean(5.71)]),
        row("OmniME", Some(192), [NONE, NONE, NONE, NONE, NONE, NONE, NONE, mean(43.75), mean(56.25), mean(66.15), mean(4.66)]),
        row("CIME", Some(192), [NONE, NONE, NONE, NONE, NONE, NONE, NONE, mean(47.92), mean(61.46), mean(71.35), mean(4.34)]),
    ] },
    Published { table: PaperTable::A2, task: "fine-grained", rows: &[
        row("1% MCM", Some(384), [mean(0.34), NONE, NONE, mean(81.77), mean(92.45), mean(93.49), mean(1.48), mean(34.11), mean(48.7), mean(57.03), mean(5.77)]),
        row("5% MCM", Some(384), [mean(0.37), NONE, NONE, mean(86.72), mean(95.57), mean(97.14), mean(1.3), mean(34.17), mean(50.0), mean(57.81), mean(5.65)]),
        row("10% MCM", Some(384), [mean(0.31), NONE, NONE, mean(82.81), mean(92.71), mean(95.31), mean(1.42), mean(37.24), mean(51.3), mean(59.11), mean(5.32)]),
        row("20% MCM", Some(384), [mean(0.29), NONE, NONE, mean(85.68), mean(91.93), mean(94.27), mean(1.45), mean(39.06), mean(52.08), mean(60.68), mean(5.36)]),
        row("12% data", Some(384), [mean(0.32), NONE, NONE, mean(81.51), mean(91.67), mean(94.53), mean(1.56), mean(40.1), mean(58.07), mean(67.71), mean(4.74)]),
        row("24% data", Some(384), [mean(0.31), NONE, NONE, mean(82.03), mean(92.19), mean(95.83), mean(1.42), mean(41.93), mean(59.11), mean(67.45), mean(4.71)]),
        row("60% data", Some(384), [mean(0.3), NONE, NONE, mean(84.9), mean(92.45), mean(96.09), mean(1.38), mean(41.67), mean(55.47), mean(63.54), mean(5.02)]),
        row("MotionReFit", Some(384), [mean(0.29), NONE, NONE, mean(85.16), mean(92.97), mean(95.31), mean(1.38), mean(42.45), mean(56.25), mean(62.76), mean(5.12)]),
    ] },
    Published { table: PaperTable::Two, task: "motionfix", rows: &[
        row("Real Data", None, [NONE, NONE, NONE, mean(74.01), mean(84.52), mean(89.91), mean(2.03), mean(100.0), mean(100.0), mean(100.0), mean(1.0)]),
        row("MDM-BP", Some(992), [NONE, NONE, NONE, mean(61.28), mean(69.55), mean(73.99), mean(4.21), mean(39.1), mean(50.09), mean(54.84), mean(6.46)]),
        row("TMED", Some(992), [NONE, NONE, NONE, mean(71.77), mean(84.07), mean(89.52), mean(1.96), mean(62.9), mean(76.51), mean(83.06), mean(2.71)]),
        row("MotionReFit w/o MCM", Some(992), [NONE, NONE, NONE, mean(83.47), mean(90.42), mean(92.84), mean(1.73), mean(66.33), mean(80.05), mean(84.98), mean(2.64)]),
        row("SimMotionEdit", Some(480), [NONE, NONE, NONE, NONE, NONE, NONE, NONE, mean(70.62), mean(82.92), mean(88.12), mean(2.38)]),
        row("Cross-Axis", Some(480), [NONE, NONE, NONE, NONE, NONE, NONE, NONE, mean(74.38), mean(88.54), mean(92.08), mean(1.92)]),
        row("OmniME", Some(480), [NONE, NONE, NONE, NONE, NONE, NONE, NONE, mean(77.29), mean(88.54), mean(91.88), mean(1.79)]),
        row("CIME", Some(480), [NONE, NONE, NONE, NONE, NONE, NONE, NONE, mean(78.12), mean(88.54), mean(92.5), mean(1.73)]),
    ] },
    Published { table: PaperTable::A3, task: "motionfix", rows: &[
        row("Real Data", Some(1013), [mean(0.01), NONE, mean(0.98), mean(20.83), mean(33.66), mean(40.47), mean(33.13), mean(64.36), mean(88.75), mean(95.56), mean(1.74)]),
        row("MDM-BP", Some(1013), [mean(0.145), NONE, mean(0.9), mean(30.21), mean(36.82), mean(40.47), mean(106.05), mean(8.69), mean(14.71), mean(18.36), mean(180.99)]),
        row("TMED", Some(1013), [mean(0.129), NONE, mean(0.92), mean(22.41), mean(34.45), mean(40.57), mean(31.42), mean(14.51), mean(21.72), mean(28.73), mean(56.63)]),
        row("MotionReFit", Some(1012), [mean(0.12), NONE, mean(0.96), mean(43.77), mean(56.72), mean(64.13), mean(24.09), mean(14.13), mean(23.52), mean(30.53), mean(54.06)]),
        row("SimMotionEdit", Some(506), [NONE, NONE, NONE, NONE, NONE, NONE, NONE, mean(25.49), mean(39.33), mean(49.21), mean(23.49)]),
        row("Cross-Axis", Some(506), [NONE, NONE, NONE, NONE, NONE, NONE, NONE, mean(29.45), mean(45.26), mean(54.55), mean(16.42)]),
        row("OmniME", Some(506), [NONE, NONE, NONE, NONE, NONE, NONE, NONE, mean(32.02), mean(50.2), mean(59.88), mean(13.06)]),
        row("CIME", Some(506), [NONE, NONE, NONE, NONE, NONE, NONE, NONE, mean(33.4), mean(50.29), mean(59.88), mean(12.24)]),
    ] },
];

#[cfg(test)]
mod tests {
    use super::*;
    use crate::metric::{Better, Measure, RankSummary, retrieval};
    use crate::names::REAL_DATA;
    use crate::table::tests::sample_table;

    #[test]
    fn shares_rise_with_k_and_real_data_find_themselves() {
        for table in TABLES {
            for row in table.rows(&columns()) {
                let what = format!("{:?} {}", table.table, row.system);
                let value = |metric: &Metric| {
                    let place = columns().iter().position(|known| *known == metric);
                    let cell = row.cells[place.expect("a column of the paper")];
                    cell.expect("printed").mean
                };
                for family in [3..6, 7..10] {
                    if row.cells[family.start].is_none() {
                        continue;
                    }
                    let shares: Vec<f64> = columns()[family].iter().map(|of| value(of)).collect();
                    assert!(shares.is_sorted(), "{what}: {shares:?}");
                    assert!(shares[2] <= 100.0 && shares[0] > 0.0);
                }
                assert!(value(&retrieval::E2T_AVERAGE_RANK) >= 1.0);
                if row.system == REAL_DATA && table.table != PaperTable::A3 {
                    assert_eq!(value(&retrieval::E2T_RECALL_1), 100.0);
                }
            }
        }
    }

    #[test]
    fn the_papers_full_model_has_the_lowest_published_fid() {
        let full = |part: &&Published| part.task != "motionfix" && part.table != PaperTable::A2;
        for table in TABLES.iter().filter(full) {
            let fid = |row: &Row| row.cells[0].expect("printed").mean;
            let rows = table.rows(&[&FID]);
            assert_eq!((FID.better)(table.task), Better::Lower);
            let best = rows
                .iter()
                .filter(|row| row.system != REAL_DATA && row.cells[0].is_some())
                .min_by(|a, b| fid(a).total_cmp(&fid(b)))
                .expect("rows");
            assert_eq!(best.system, "MotionReFit", "{:?}", table.table);
        }
    }

    /// Whether a share of `n` items rounds to the printed percentage of two decimals; halves may round up or down.
    fn is_share(printed: f64, n: u32) -> bool {
        let count = (printed * f64::from(n) / 100.0).round();
        (100.0 * count / f64::from(n) - printed).abs() <= 0.005 + 1e-9
    }

    #[test]
    fn shares_are_multiples_of_one_over_the_items_they_are_said_to_be_of() {
        for table in TABLES {
            for printed in table.rows {
                let Some(n) = printed.n else {
                    continue;
                };
                let shares: Vec<f64> = (0..NUM_COLUMNS)
                    .filter(|&place| {
                        let measure = columns()[place].measure;
                        matches!(measure, Measure::Rank(_, RankSummary::Recall(_)))
                    })
                    .filter_map(|place| printed.values[place].map(|(mean, _)| mean))
                    .collect();
                let fitting = shares.iter().filter(|share| is_share(**share, n)).count();
                // In three rows, one cell is an average or misprinted. MDM-BP of Table 2 was rounded in each batch, and
                // is assigned the number of items of the other rows.
                let allowed = match (table.table, printed.system) {
                    (PaperTable::Two, "MDM-BP") => 4,
                    (PaperTable::Two, "MotionReFit w/o MCM") => 1,
                    (PaperTable::A2, "5% MCM") => 1,
                    (PaperTable::A3, "CIME") => 1,
                    _ => 0,
                };
                let what = (table.table, printed.system);
                assert_eq!(shares.len() - fitting, allowed, "{what:?}");
            }
        }
    }

    #[test]
    fn a_note_says_on_how_many_items_published_rows_were_measured() {
        let mut table = sample_table();
        table.task = "motionfix".to_owned();
        table.notes.clear();
        assert!(table.append_published(PaperTable::A3));
        assert_eq!(
            table.notes,
            [
                "Published rows were measured on 1013 items (Real Data, MDM-BP, TMED), 1012 items \
                 (MotionReFit), 506 items (SimMotionEdit, Cross-Axis, OmniME, CIME); the rows above \
                 on 512. A rank among fewer items is a better one, so rows of different numbers are \
                 not comparable."
            ]
        );
        table.task = "fine-grained".to_owned();
        table.notes.clear();
        assert!(table.append_published(PaperTable::A1));
        let note = &table.notes[0];
        assert!(
            note.contains("384 items (TMED, MotionReFit w/o MCM, MotionReFit), 192 items (")
                && note.contains("an unknown number of items (Real Data, MDM-BP, TMED w/ MCM)")
                && note.ends_with("not of the same test items."),
            "{note}"
        );
    }

    #[test]
    fn columns_are_those_of_the_paper() {
        assert_eq!(PaperTable::One.columns(), metric::of_part(Part::Paper));
        assert_eq!(PaperTable::Two.columns().len(), 8);
        assert_eq!(PaperTable::A2.columns()[0], &FID);
        assert_eq!(PaperTable::A3.columns().len(), 10);
    }

    #[test]
    fn published_rows_join_a_table_without_competing() {
        let mut table = sample_table();
        let measured = table.rows.clone();
        assert!(table.append_published(PaperTable::One));
        assert_eq!(table.rows[..measured.len()], measured);
        for row in &table.rows[measured.len()..] {
            assert_eq!(row.group, RowGroup::Published);
            assert!(row.cells.iter().flatten().all(|cell| !cell.best));
        }
        assert!(!table.append_published(PaperTable::A3));
        table.task = "all".to_owned();
        assert!(!table.append_published(PaperTable::One));
        table.task = "motionfix".to_owned();
        let mut columns = table.columns.iter();
        let place = columns.position(|column| column.metric == &retrieval::E2S_RECALL_1);
        for (paper, value) in [(PaperTable::Two, 71.77), (PaperTable::A3, 22.41)] {
            table.rows.clear();
            assert!(table.append_published(paper));
            let tmed = table.rows.iter().find(|row| row.system == "TMED");
            let cell = tmed.expect("a row").cells[place.expect("a column")];
            assert_eq!(cell.expect("printed").mean, value);
        }
    }
}
