//! Drawings as SVG: motions as strips of figures, and plots. A drawing is self-contained, and its text
//! uses `currentColor`, so it suits light and dark pages.

pub mod plot;
pub mod raster;
pub mod strip;

use glam::DVec2;

/// Font family of drawings, preferred fonts first.
const FONT: &str = "system-ui, -apple-system, 'Segoe UI', Roboto, 'Helvetica Neue', sans-serif";

/// Style of secondary text, such as the numbers of an axis.
const FAINT: &str = r#"opacity="0.65""#;

/// Opens a drawing of the given size, which shrinks on a narrower page.
fn open(width: f64, height: f64, title: &str) -> String {
    format!(
        r#"<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {width:.0} {height:.0}" width="{width:.0}" height="{height:.0}" role="img" font-family="{FONT}" fill="currentColor" style="max-width:100%;height:auto"><title>{}</title>"#,
        escaped(title)
    )
}

/// Adds a line of text. `anchor` is `start`, `middle` or `end`; `attributes` are written as given.
fn text(svg: &mut String, at: DVec2, anchor: &str, size: f64, attributes: &str, content: &str) {
    svg.push_str(&format!(
        r#"<text x="{:.1}" y="{:.1}" text-anchor="{anchor}" font-size="{size}" {attributes}>{}</text>"#,
        at.x,
        at.y,
        escaped(content)
    ));
}

/// Adds a faint line.
fn line(svg: &mut String, from: DVec2, to: DVec2) {
    svg.push_str(&format!(
        r#"<path d="M{:.1} {:.1}L{:.1} {:.1}" stroke="currentColor" stroke-opacity="0.22" fill="none"/>"#,
        from.x, from.y, to.x, to.y
    ));
}

/// Adds a faint horizontal line.
fn level_line(svg: &mut String, left: f64, right: f64, y: f64) {
    line(svg, DVec2::new(left, y), DVec2::new(right, y));
}

/// Escapes text for XML and HTML, inside and outside of attributes. Line breaks and tabs become spaces; other control
/// characters are dropped.
pub fn escaped(text: &str) -> String {
    let mut result = String::with_capacity(text.len());
    for c in text.chars() {
        match c {
            '&' => result.push_str("&amp;"),
            '<' => result.push_str("&lt;"),
            '>' => result.push_str("&gt;"),
            '"' => result.push_str("&quot;"),
            '\'' => result.push_str("&#39;"),
            '\n' | '\t' => result.push(' '),
            c if c.is_control() => {}
            c => result.push(c),
        }
    }
    result
}

/// A colour with red, green and blue in 0..=255.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Rgb(pub [f64; 3]);

impl Rgb {
    /// Mixes this colour with another one; `share` is that of the other.
    pub fn towards(self, other: Self, share: f64) -> Self {
        Self(std::array::from_fn(|i| {
            self.0[i] + share * (other.0[i] - self.0[i])
        }))
    }

    /// The colour in hexadecimal SVG notation.
    pub fn hex(self) -> String {
        let [r, g, b] = self
            .0
            .map(|channel| channel.clamp(0.0, 255.0).round() as u8);
        format!("#{r:02X}{g:02X}{b:02X}")
    }
}

#[cfg(test)]
pub(crate) mod tests {
    use super::*;

    /// Fails unless every tag of a drawing or page is closed in order and no attribute is left open. It catches
    /// mistakes in string building.
    pub(crate) fn check_nesting(markup: &str) {
        const VOID: [&str; 3] = ["meta", "br", "!doctype"];
        let mut open: Vec<&str> = Vec::new();
        let mut rest = markup;
        while let Some(start) = rest.find('<') {
            let between = &rest[..start];
            assert!(!between.contains('>'), "stray > in {between:?}");
            let end = start + rest[start..].find('>').expect("a tag ends");
            let tag = &rest[start + 1..end];
            assert!(!tag.contains('<'), "a tag inside <{tag}>");
            let quotes = tag.matches('"').count();
            assert_eq!(quotes % 2, 0, "an open attribute in <{tag}>");
            rest = &rest[end + 1..];
            if let Some(name) = tag.strip_prefix('/') {
                assert_eq!(open.pop(), Some(name), "before {:.60}", rest);
            } else if !tag.ends_with('/') {
                let name = tag.split_whitespace().next().expect("a name");
                if name == "style" {
                    // Skips style sheets, which have another grammar.
                    rest = &rest[rest.find("</style>").expect("a closed style")..];
                }
                if !VOID.contains(&name) {
                    open.push(name);
                }
            }
        }
        assert!(open.is_empty(), "unclosed: {open:?}");
    }

    #[test]
    fn markup_in_a_text_is_harmless() {
        let text = escaped("<script>\"a\" & 'b'\u{0}</script>\n");
        let expected = "&lt;script&gt;&quot;a&quot; &amp; &#39;b&#39;&lt;/script&gt; ";
        assert_eq!(text, expected);
    }

    #[test]
    fn colours_mix_linearly() {
        let mixed = Rgb([0.0, 100.0, 255.0]).towards(Rgb([255.0, 200.0, 255.0]), 0.5);
        assert_eq!(mixed.hex(), "#8096FF");
    }
}
