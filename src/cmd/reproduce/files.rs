//! Files of results.

use std::path::Path;

use anyhow::Context;
use eval::draw::raster::png;

use crate::local;

/// PNG pixels per SVG unit.
const PNG_ZOOM: f32 = 2.0;

/// Writes a result.
pub(super) fn write(path: &Path, bytes: &[u8]) -> anyhow::Result<()> {
    if let Some(folder) = path.parent() {
        std::fs::create_dir_all(folder)
            .with_context(|| format!("cannot create {}", folder.display()))?;
    }
    local::write(path, bytes)
}

/// Writes a drawing as SVG, and as PNG beside it.
pub(super) fn write_drawing(path: &Path, svg: &str) -> anyhow::Result<()> {
    write(path, svg.as_bytes())?;
    write(&path.with_extension("png"), &png(svg, PNG_ZOOM)?)
}

pub(super) fn file_name(text: &str) -> String {
    let name: String = text
        .chars()
        .map(|c| if c.is_alphanumeric() { c } else { '-' })
        .collect();
    name.to_lowercase()
}
