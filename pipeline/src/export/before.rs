//! What is said of an export before it begins.

use datasets_spec::record::CAPTION_BY_RULE;
use datasets_spec::table::Caption;

use super::Layout;
use super::paths::is_shortened;
use crate::Error;
use crate::clips::Clips;

/// What a user should know before the clips are written in a layout: that its loaders would find no texts, or that
/// names are shortened. Only columns of labels are read.
///
/// # Errors
/// The dataset cannot be read.
pub fn before(layout: Layout, clips: &Clips) -> Result<Vec<String>, Error> {
    let mut remarks = Vec::new();
    if layout == Layout::HumanMl3d && !has_captions(clips) {
        remarks.push(format!(
            "none of the {} clips has a caption of its source, so texts/ stays empty and the loaders of this layout \
             find no clip; add captions first (captions.csv beside the sources and `stance ingest` again, or `stance \
             annotate`)",
            clips.len()
        ));
    }
    if names_are_ids(layout) {
        let mut shortened = Vec::new();
        for shard in clips.shards(None) {
            let ids = shard.column::<String>("id")?.into_iter();
            shortened.extend(ids.filter(|id| is_shortened(id)));
        }
        if let Some(first) = shortened.first() {
            remarks.push(format!(
                "{} names are too long for file systems and are shortened, with a hash behind them (such as that of \
                 {first})",
                shortened.len()
            ));
        }
    }
    Ok(remarks)
}

/// Other names are members of archives, or running numbers.
fn names_are_ids(layout: Layout) -> bool {
    matches!(
        layout,
        Layout::Amass | Layout::Bvh | Layout::Gltf | Layout::MotionMillion
    )
}

/// Whether any clip has a caption that was not made from its name.
fn has_captions(clips: &Clips) -> bool {
    clips.shards(None).any(|shard| {
        let captions: Vec<Vec<Caption>> = shard.column("captions").unwrap_or_default();
        // Tables older than 1.5.0 have no such column.
        let origins: Vec<Vec<String>> = shard.column("caption_origins").unwrap_or_default();
        captions.iter().enumerate().any(|(clip, captions)| {
            (0..captions.len()).any(|number| {
                let origin = origins.get(clip).and_then(|origins| origins.get(number));
                origin.is_none_or(|origin| origin != CAPTION_BY_RULE)
            })
        })
    })
}
