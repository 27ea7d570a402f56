//! Rasterises drawings: PNG of one drawing, GIF of an animation.
//!
//! The font is embedded, so a picture is the same on every machine.

use std::sync::Arc;

use gif::{Encoder, Frame, Repeat};
use resvg::tiny_skia::{Color, Pixmap, Transform};
use resvg::usvg::{Options, Tree, fontdb};

use super::strip::{Row, moment};

/// Frame rate of a GIF. Delays are stored in hundredths of a second, and many viewers slow down delays shorter than
/// 0.02 s.
const GIF_FPS: f64 = 20.0;
/// Maximum number of frames of a GIF: half a minute.
const MAX_FRAMES: usize = 600;
/// Colour quantisation speed, from 1 (best) to 30 (fastest).
const QUANTISER_SPEED: i32 = 10;

/// Why a drawing cannot be rasterised.
#[derive(Debug, thiserror::Error)]
pub enum RasterError {
    /// The drawing is not valid SVG: a bug in the code that made it.
    #[error("the drawing is no valid SVG")]
    Svg(#[from] resvg::usvg::Error),
    /// The picture would have no pixel, or too many: its width and height.
    #[error("a picture of {0} x {1} pixels cannot be made")]
    Size(u32, u32),
    /// The PNG could not be encoded, for the reason that the encoder gives.
    #[error("the picture cannot be encoded as PNG: {0}")]
    Png(String),
    /// The GIF could not be encoded.
    #[error("the picture cannot be encoded as GIF")]
    Gif(#[from] gif::EncodingError),
}

/// Options with the embedded font, the same for every picture.
fn options() -> Options<'static> {
    let mut fonts = fontdb::Database::new();
    fonts.load_font_data(dejavu::sans::regular().to_vec());
    fonts.load_font_data(dejavu::sans::bold().to_vec());
    for set in [
        fontdb::Database::set_sans_serif_family,
        fontdb::Database::set_serif_family,
        fontdb::Database::set_monospace_family,
    ] {
        set(&mut fonts, "DejaVu Sans");
    }
    Options {
        font_family: "DejaVu Sans".to_owned(),
        fontdb: Arc::new(fonts),
        ..Options::default()
    }
}

/// Rasterises an SVG document on a white background.
fn pixels(svg: &str, options: &Options, zoom: f32) -> Result<Pixmap, RasterError> {
    let tree = Tree::from_str(svg, options)?;
    let size = tree.size();
    let [width, height] = [size.width(), size.height()].map(|side| (side * zoom).ceil() as u32);
    let mut pixmap = Pixmap::new(width, height).ok_or(RasterError::Size(width, height))?;
    pixmap.fill(Color::WHITE);
    let scale = Transform::from_scale(zoom, zoom);
    resvg::render(&tree, scale, &mut pixmap.as_mut());
    Ok(pixmap)
}

/// Renders an SVG document as PNG with `zoom` pixels per unit.
///
/// # Errors
/// The document is not SVG, or the picture has no pixel.
pub fn png(svg: &str, zoom: f32) -> Result<Vec<u8>, RasterError> {
    let encoded = pixels(svg, &options(), zoom)?.encode_png();
    encoded.map_err(|error| RasterError::Png(error.to_string()))
}

/// Draws clips side by side as an endlessly repeating GIF with `zoom` pixels per unit. It lasts at most half a minute.
///
/// # Errors
/// There is no clip, or the picture is too large.
pub fn gif(rows: &[Row], zoom: f32) -> Result<Vec<u8>, RasterError> {
    let longest = rows.iter().map(Row::secs).fold(0.0, f64::max);
    let count = ((longest * GIF_FPS).floor() as usize + 1).min(MAX_FRAMES);
    let options = options();
    let mut encoder: Option<Encoder<Vec<u8>>> = None;
    for index in 0..count {
        let svg = moment(rows, index as f64 / GIF_FPS);
        let mut pixmap = pixels(&svg, &options, zoom)?;
        let (width, height) = (pixmap.width(), pixmap.height());
        let size = RasterError::Size(width, height);
        let (Ok(width), Ok(height)) = (u16::try_from(width), u16::try_from(height)) else {
            return Err(size);
        };
        let encoder = match &mut encoder {
            Some(begun) => begun,
            None => {
                let mut begun = Encoder::new(Vec::new(), width, height, &[])?;
                begun.set_repeat(Repeat::Infinite)?;
                encoder.insert(begun)
            }
        };
        let mut frame = Frame::from_rgba_speed(width, height, pixmap.data_mut(), QUANTISER_SPEED);
        frame.delay = (100.0 / GIF_FPS) as u16;
        encoder.write_frame(&frame)?;
    }
    Ok(encoder.expect("at least one frame").into_inner()?)
}

#[cfg(test)]
mod tests {
    use datasets_spec::{Fps, Motion, Pose, Skeleton};

    use super::*;

    fn rows() -> Vec<Row> {
        let poses: Vec<Pose> = (0..11)
            .map(|frame| {
                let mut pose = Pose::REST;
                pose.rotations[16] =
                    kinematics::rotation::from_axis_angle(glam::DVec3::Z * 0.1 * f64::from(frame));
                pose
            })
            .collect();
        let motion = Motion::from_poses(Fps::STORE, &poses).expect("valid");
        vec![Row::new("waving", &motion, &Skeleton::smplx_neutral())]
    }

    #[test]
    fn a_png_is_as_large_as_asked_and_not_blank() {
        let svg = moment(&rows(), 0.0);
        let small = pixels(&svg, &options(), 1.0).expect("drawn");
        let large = pixels(&svg, &options(), 2.0).expect("drawn");
        assert_eq!(2 * small.width(), large.width());
        assert_eq!(2 * small.height(), large.height());
        let dark = small.pixels().iter().filter(|p| p.red() < 128).count();
        assert!(dark > 50, "{dark} dark pixels: the figure and its label");
        assert!(png(&svg, 1.0).expect("encoded").starts_with(b"\x89PNG"));
    }

    #[test]
    fn a_gif_has_a_picture_for_each_moment_and_they_differ() {
        let bytes = gif(&rows(), 0.5).expect("encoded");
        let mut decoder = gif::DecodeOptions::new()
            .read_info(bytes.as_slice())
            .expect("a GIF");
        let mut frames = Vec::new();
        while let Some(frame) = decoder.read_next_frame().expect("a frame") {
            frames.push((frame.delay, frame.buffer.to_vec()));
        }
        assert_eq!(frames.len(), 11);
        assert!(frames.iter().all(|(delay, _)| *delay == 5));
        assert_ne!(frames[0].1, frames[10].1);
    }

    #[test]
    fn text_is_drawn_with_the_font_the_program_carries() {
        let plain = r#"<svg xmlns="http://www.w3.org/2000/svg" width="60" height="20"></svg>"#;
        let said = plain.replace("></svg>", r#"><text x="2" y="15">Hips</text></svg>"#);
        let [plain, said] = [plain, &said].map(|svg| png(svg, 1.0).expect("drawn"));
        assert_ne!(plain, said);
        assert!(png("<svg", 1.0).is_err());
    }
}
