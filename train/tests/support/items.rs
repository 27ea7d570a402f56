//! Items for tests of editing systems.

use compose::{ItemConfig, ItemCount};
use datasets_spec::record::ItemRow;
use datasets_spec::{Dataset, NoProgress, Seed, Split};
use pipeline::stage::{self, Context};

use crate::support::Data;

/// Two items of the test split.
pub(crate) fn items(data: &Data) -> Vec<ItemRow> {
    let context = Context {
        progress: &NoProgress,
        holder: "a test",
    };
    let config = ItemConfig {
        count: ItemCount::Exactly(2),
        ..ItemConfig::default()
    };
    let dataset = Dataset::open(&data.dataset()).expect("a dataset");
    let place = data.run("items");
    let drawn = stage::items(&dataset, &place, Split::Test, &config, Seed(0), &context);
    drawn.expect("items").dataset.read(None).expect("rows")
}
