//! Draws motions as rows of stick figures, one row per clip; time runs to the right.

use datasets_spec::{Joint, JointSet, Keypoints, Motion, Skeleton};
use glam::{DVec2, DVec3};
use kinematics::skeleton::{KEYPOINT_PARENTS, NUM_KEYPOINTS};

use super::{FAINT, Rgb, level_line, open, text};
use crate::format::text::lines_of;

/// A clip of a strip.
#[derive(Clone, Debug, PartialEq)]
pub struct Row {
    /// Label of the clip, such as `original`.
    pub label: String,
    /// The clip.
    pub keypoints: Keypoints,
    /// Joints drawn with a halo, such as those of an edit's mask.
    pub highlighted: JointSet,
}

impl Row {
    /// Seconds from the first to the last frame.
    pub fn secs(&self) -> f64 {
        let last = self.keypoints.points.len().saturating_sub(1);
        self.keypoints.fps.secs_at(last)
    }

    /// Height in metres of the lowest keypoint of all frames.
    fn floor(&self) -> f64 {
        let points = self.keypoints.points.iter().flatten();
        points.fold(f64::INFINITY, |low, point| low.min(point.y))
    }

    /// A row of a motion without highlighted joints.
    pub fn new(label: impl Into<String>, motion: &Motion, skeleton: &Skeleton) -> Self {
        Self {
            label: label.into(),
            keypoints: skeleton.motion_keypoints(motion),
            highlighted: JointSet::EMPTY,
        }
    }
}

/// How a strip is laid out.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Style {
    /// Width in pixels.
    pub width: f64,
    /// Figures in each row. A clip with fewer frames has one figure per frame.
    pub num_figures: usize,
}

impl Default for Style {
    fn default() -> Self {
        Self {
            width: 960.0,
            num_figures: 10,
        }
    }
}

/// Angle of the camera in degrees, measured from the front of the first clip's first frame towards its right. The
/// figure then faces right, the direction of time.
const TO_THE_RIGHT: f64 = 40.0;
/// Angle of the camera above the horizon in degrees.
const ELEVATION: f64 = 12.0;
/// Colour of the first figure.
const START: Rgb = Rgb([232.0, 131.0, 58.0]);
/// Colour of the middle figure. Without it, mixing orange and blue would give grey.
const MIDDLE: Rgb = Rgb([181.0, 84.0, 140.0]);
/// Colour of the last figure.
const END: Rgb = Rgb([47.0, 111.0, 208.0]);
/// Halo of highlighted joints: its hue is far from both ends of the gradient, and it is readable on light and dark
/// pages.
pub(crate) const HALO: &str = "#1BAA78";
/// Opacity of the halo, of the left limbs and of the trunk's area.
const HALO_OPACITY: f64 = 0.4;
const LEFT_OPACITY: f64 = 0.5;
const TRUNK_OPACITY: f64 = 0.22;

/// Space for the row labels in pixels.
const LABEL_WIDTH: f64 = 126.0;
/// Characters per line that fit into the space for labels.
const LABEL_CHARS: usize = 15;
/// Pixels from one line of a label to the next.
const LABEL_LINE: f64 = 15.0;
/// Height of the lines below a label, with duration and distance, in pixels.
const FACTS_HEIGHT: f64 = 34.0;
/// Space around the drawing in pixels.
const MARGIN: f64 = 8.0;
/// Height in pixels between the ground line and the next row, for the time labels.
const TIME_HEIGHT: f64 = 30.0;
/// Pixels per metre if the space allows: a standing figure is about 115 pixels high.
const PIXELS_PER_M: f64 = 68.0;
/// Least distance between figures in metres; figures are scaled down to keep it. It is less than the arm span but more
/// than a walking body needs.
const MIN_SLOT_M: f64 = 1.0;
/// Radius of the drawn head in metres, and how far its centre lies behind the eyes.
const HEAD_RADIUS_M: f64 = 0.1;
const EYE_DEPTH_M: f64 = 0.07;
/// Length of the nose from the centre of the head in metres; it shows where the figure looks.
const NOSE_M: f64 = 0.15;
/// Radius of the shadow on the ground in metres.
const SHADOW_RADIUS_M: f64 = 0.26;
/// Width of the halo in metres.
const HALO_WIDTH_M: f64 = 0.15;
/// Width of the nose's line in metres.
const NOSE_WIDTH_M: f64 = 0.05;

/// Keypoints of the left and the right eye.
const EYES: [usize; 2] = [22, 23];
/// Keypoints at the corners of the trunk: shoulders and hips.
const TRUNK: [usize; 4] = [16, 17, 2, 1];

/// A limb, drawn as a whole. Limbs farther from the camera are drawn first.
struct Limb {
    /// Keypoints in drawing order.
    chains: &'static [&'static [usize]],
    left: bool,
    width_m: f64,
}

const fn limb(chains: &'static [&'static [usize]], left: bool, width_m: f64) -> Limb {
    Limb {
        chains,
        left,
        width_m,
    }
}

/// The trunk comes first, and the head is drawn with it.
const LIMBS: [Limb; 5] = [
    limb(
        &[&[0, 3, 6, 9, 12, 15], &[16, 13, 9, 14, 17], &[1, 0, 2]],
        false,
        0.06,
    ),
    limb(&[&[1, 4, 7, 10]], true, 0.068),
    limb(&[&[2, 5, 8, 11]], false, 0.068),
    limb(&[&[16, 18, 20, 24], &[20, 25]], true, 0.052),
    limb(&[&[17, 19, 21, 26], &[21, 27]], false, 0.052),
];

/// Draws clips below each other as one SVG document.
///
/// Figures stand at equal distances and are sampled at equal times. Height is to scale; the distance walked is written
/// under the label. Colours run from orange at the start to blue at the end. The right limbs are in full colour, the
/// left ones pale. All rows share one camera, so a clip that faces another way is seen from another side.
pub fn strip(rows: &[Row], style: &Style) -> String {
    let camera = Camera::facing(rows);
    let num_figures = style.num_figures.max(1);
    let slot = (style.width - LABEL_WIDTH - 2.0 * MARGIN) / num_figures as f64;
    let scale = PIXELS_PER_M.min(slot / MIN_SLOT_M);
    let drawn: Vec<Drawn<'_>> = rows
        .iter()
        .map(|row| Drawn::new(row, num_figures, &camera))
        .collect();
    let heights: Vec<f64> = drawn
        .iter()
        .map(|drawn| MARGIN + (drawn.rise_m * scale).max(drawn.label_height()) + TIME_HEIGHT)
        .collect();

    let title = format!("Motion strip: {}", names(rows));
    let mut svg = open(style.width, heights.iter().sum(), &title);
    let mut top = 0.0;
    for (drawn, height) in drawn.iter().zip(&heights) {
        let ground = top + height - TIME_HEIGHT;
        drawn.label(&mut svg, top + (MARGIN + ground - top) / 2.0);
        level_line(&mut svg, LABEL_WIDTH + MARGIN, style.width - MARGIN, ground);
        for (place, figure) in drawn.figures.iter().enumerate() {
            let middle = LABEL_WIDTH + MARGIN + (place as f64 + 0.5) * slot;
            let share = place as f64 / (drawn.figures.len() - 1).max(1) as f64;
            let pen = Pen {
                origin: DVec2::new(middle, ground),
                scale,
                colour: colour_at(share).hex(),
            };
            figure.draw(&mut svg, &pen, drawn.row.highlighted);
            let at = DVec2::new(middle, ground + TIME_HEIGHT / 2.0 + 3.0);
            let secs = format!("{:.1} s", figure.secs);
            text(&mut svg, at, "middle", 11.0, FAINT, &secs);
        }
        top += height;
    }
    svg + "</svg>"
}

/// Arranges drawings with titles in columns of equal width, in pixels.
pub fn sheet(panels: &[(String, String)], columns: usize, width: f64) -> String {
    const TITLE_HEIGHT: f64 = 30.0;
    /// Maximum width of a title's character in pixels.
    const TITLE_CHAR: f64 = 7.5;
    let columns = columns.max(1);
    let title_chars = ((width - 2.0 * MARGIN) / TITLE_CHAR) as usize;
    let title_height =
        |title: &str| TITLE_HEIGHT + LABEL_LINE * (lines(title, title_chars).len() - 1) as f64;
    let height_of = |svg: &str| -> f64 {
        let stated = svg.split_once("height=\"").map_or("", |(_, rest)| rest);
        let number = stated.split_once('"').map_or("", |(number, _)| number);
        number.parse().unwrap_or(0.0)
    };
    // The height of the titles and of the panels of each row.
    let heights = panels.chunks(columns).map(|row| {
        let titles = row.iter().map(|(title, _)| title_height(title));
        let panels = row.iter().map(|(_, svg)| height_of(svg));
        [titles.fold(0.0, f64::max), panels.fold(0.0, f64::max)]
    });
    let heights: Vec<[f64; 2]> = heights.collect();
    let height = heights.iter().map(|[titles, panels]| titles + panels).sum();
    let title = format!("{} motion strips", panels.len());
    let mut svg = open(width * columns as f64, height, &title);
    let mut top = 0.0;
    for (row, [title_height, panel_height]) in panels.chunks(columns).zip(heights) {
        for (column, (title, panel)) in row.iter().enumerate() {
            let left = column as f64 * width;
            for (line, title) in lines(title, title_chars).iter().enumerate() {
                let below = TITLE_HEIGHT - 10.0 + LABEL_LINE * line as f64;
                let at = DVec2::new(left + MARGIN, top + below);
                text(&mut svg, at, "start", 13.0, "", title);
            }
            let place = format!("<svg x=\"{left}\" y=\"{}\" ", top + title_height);
            svg.push_str(&panel.replacen("<svg ", &place, 1));
        }
        top += title_height + panel_height;
    }
    svg + "</svg>"
}

/// Size of one panel of [`moment`] in pixels, with a label of one line.
const PANEL: DVec2 = DVec2::new(240.0, 250.0);
/// Characters per line of a panel's label.
const PANEL_CHARS: usize = 34;
/// Pixels per metre in a panel: a standing figure with raised arms fits.
const PANEL_PIXELS_PER_M: f64 = 92.0;

/// Draws the poses of several clips at one time side by side, as one frame of an animation. The colour
/// follows the time within the longest clip; a clip that has ended keeps its last pose.
pub fn moment(rows: &[Row], secs: f64) -> String {
    let camera = Camera::facing(rows);
    let longest = rows.iter().map(Row::secs).fold(0.0, f64::max);
    let share = if longest > 0.0 { secs / longest } else { 0.0 };
    let width = PANEL.x * rows.len() as f64;
    let title = format!("{} at {secs:.2} s", names(rows));
    let labels: Vec<Vec<String>> = rows
        .iter()
        .map(|row| lines(&format!("{} {secs:.1} s", row.label), PANEL_CHARS))
        .collect();
    let tallest = labels.iter().map(Vec::len).max().unwrap_or(1);
    let height = PANEL.y + LABEL_LINE * (tallest.max(1) - 1) as f64;
    let mut svg = open(width, height, &title);
    for (place, row) in rows.iter().enumerate() {
        let Some(last) = row.keypoints.points.len().checked_sub(1) else {
            continue;
        };
        let frame = ((secs * row.keypoints.fps.get()).round() as usize).min(last);
        let figure = Figure::new(&row.keypoints.points[frame], row.floor(), secs, &camera);
        let left = PANEL.x * place as f64;
        let ground = PANEL.y - TIME_HEIGHT;
        level_line(&mut svg, left + MARGIN, left + PANEL.x - MARGIN, ground);
        let middle = left + PANEL.x / 2.0;
        let pen = Pen {
            origin: DVec2::new(middle, ground),
            scale: PANEL_PIXELS_PER_M,
            colour: colour_at(share).hex(),
        };
        figure.draw(&mut svg, &pen, row.highlighted);
        for (line, label) in labels[place].iter().enumerate() {
            let below = TIME_HEIGHT / 2.0 + 4.0 + LABEL_LINE * line as f64;
            let at = DVec2::new(middle, ground + below);
            text(&mut svg, at, "middle", 11.0, FAINT, label);
        }
    }
    svg + "</svg>"
}

/// The labels of clips, for the title of their drawing.
fn names(rows: &[Row]) -> String {
    let labels: Vec<&str> = rows.iter().map(|row| row.label.as_str()).collect();
    labels.join(", ")
}

/// The colour at a share (0 to 1) of the clip's duration.
fn colour_at(share: f64) -> Rgb {
    if share < 0.5 {
        START.towards(MIDDLE, 2.0 * share)
    } else {
        MIDDLE.towards(END, 2.0 * share - 1.0)
    }
}

/// Projection axes, of unit length.
struct Camera {
    right: DVec3,
    up: DVec3,
    towards: DVec3,
}

impl Camera {
    fn facing(rows: &[Row]) -> Self {
        let left = rows
            .iter()
            .find_map(|row| row.keypoints.points.first())
            .map(|frame| {
                let across = frame[Joint::LeftHip.index()] - frame[Joint::RightHip.index()];
                DVec3::new(across.x, 0.0, across.z)
            })
            .and_then(DVec3::try_normalize)
            .unwrap_or(DVec3::X);
        let forward = left.cross(DVec3::Y);
        let [to_the_right, above] = [TO_THE_RIGHT, ELEVATION].map(f64::to_radians);
        let level = to_the_right.cos() * forward - to_the_right.sin() * left;
        let towards = above.cos() * level + above.sin() * DVec3::Y;
        let right = DVec3::Y.cross(level);
        Self {
            right,
            up: towards.cross(right),
            towards,
        }
    }

    /// Right, up and depth coordinates of a point; depth grows towards the camera.
    fn project(&self, point: DVec3) -> DVec3 {
        DVec3::new(
            point.dot(self.right),
            point.dot(self.up),
            point.dot(self.towards),
        )
    }
}

/// A row with its figures projected.
struct Drawn<'a> {
    row: &'a Row,
    figures: Vec<Figure>,
    /// Height of the tallest figure above the ground in metres.
    rise_m: f64,
}

/// One frame: projected keypoints relative to the ground under the pelvis.
struct Figure {
    secs: f64,
    points: [DVec3; NUM_KEYPOINTS],
    head: DVec3,
    nose: DVec3,
}

/// Heights of the lowest keypoint up to this one count as the ground, in metres: toes and ankles lie up to 0.13 m above it in
/// walks of the built-in corpus.
const FLOOR_TOLERANCE_M: f64 = 0.2;

impl<'a> Drawn<'a> {
    fn new(row: &'a Row, num_figures: usize, camera: &Camera) -> Self {
        let frames = &row.keypoints.points;
        let floor = row.floor();
        let count = num_figures.min(frames.len());
        let figures: Vec<Figure> = (0..count)
            .map(|place| {
                let last = frames.len() - 1;
                // The nearest frame, in integer arithmetic.
                let frame = if count > 1 {
                    (2 * place * last + count - 1) / (2 * (count - 1))
                } else {
                    0
                };
                let secs = row.keypoints.fps.secs_at(frame);
                Figure::new(&frames[frame], floor, secs, camera)
            })
            .collect();
        let rise_m = figures.iter().map(Figure::rise_m).fold(0.0, f64::max);
        Self {
            row,
            figures,
            rise_m,
        }
    }

    /// Height of the label in pixels.
    fn label_height(&self) -> f64 {
        let names = lines(&self.row.label, LABEL_CHARS).len();
        let more = usize::from(self.lowest().is_some());
        LABEL_LINE * (names + more) as f64 + FACTS_HEIGHT
    }

    /// The height of the lowest keypoint, if that is not the ground. Each row stands on its own ground, so a motion that
    /// floats or sinks must say so.
    fn lowest(&self) -> Option<String> {
        let floor = self.row.floor();
        (floor.abs() > FLOOR_TOLERANCE_M).then(|| format!("lowest {floor:+.2} m"))
    }

    /// Writes the row's name (wrapped), its duration, the distance that the body moves over the ground, and how far it is
    /// above or below it.
    fn label(&self, svg: &mut String, middle: f64) {
        let frames = &self.row.keypoints.points;
        let path_m: f64 = frames
            .windows(2)
            .map(|pair| {
                let step = pair[1][0] - pair[0][0];
                step.x.hypot(step.z)
            })
            .sum();
        let secs = self.row.secs();
        let mut base = middle - self.label_height() / 2.0 + LABEL_LINE - 3.0;
        let mut write = |size: f64, attributes: &str, content: &str| {
            let at = DVec2::new(MARGIN, base);
            text(svg, at, "start", size, attributes, content);
            base += LABEL_LINE;
        };
        for name in lines(&self.row.label, LABEL_CHARS) {
            write(13.0, r#"font-weight="600""#, &name);
        }
        let length = format!("{secs:.1} s at {} ", self.row.keypoints.fps);
        write(11.0, FAINT, length.trim_end());
        write(11.0, FAINT, &format!("moves {path_m:.2} m"));
        if let Some(lowest) = self.lowest() {
            write(11.0, FAINT, &lowest);
        }
    }
}

/// Wraps a text at spaces into lines of at most `max_chars` characters. A word is split only if it is longer than a
/// line.
fn lines(text: &str, max_chars: usize) -> Vec<String> {
    let parts = |word: &str| -> Vec<String> {
        let letters: Vec<char> = word.chars().collect();
        let parts = letters.chunks(max_chars.max(1));
        parts.map(String::from_iter).collect()
    };
    lines_of(text.split_whitespace().flat_map(parts), max_chars)
}

/// Position and scale of a figure on the page.
struct Pen {
    /// Position of the ground under the pelvis in pixels.
    origin: DVec2,
    /// Pixels per metre.
    scale: f64,
    colour: String,
}

impl Pen {
    fn place(&self, point: DVec3) -> DVec2 {
        self.origin + self.scale * DVec2::new(point.x, -point.y)
    }

    /// SVG path through chains of points.
    fn path(&self, chains: impl IntoIterator<Item = Vec<DVec3>>) -> String {
        let mut path = String::new();
        for chain in chains {
            for (index, point) in chain.into_iter().enumerate() {
                let at = self.place(point);
                path.push(if index == 0 { 'M' } else { 'L' });
                path.push_str(&format!("{:.1} {:.1}", at.x, at.y));
            }
        }
        path
    }
}

impl Figure {
    fn new(frame: &[DVec3; NUM_KEYPOINTS], floor: f64, secs: f64, camera: &Camera) -> Self {
        let under_pelvis = DVec3::new(frame[0].x, floor, frame[0].z);
        let rise = (frame[Joint::Head.index()] - frame[Joint::Neck.index()])
            .try_normalize()
            .unwrap_or(DVec3::Y);
        let [left_eye, right_eye] = EYES.map(|eye| frame[eye]);
        let gaze = (left_eye - right_eye)
            .cross(rise)
            .try_normalize()
            .unwrap_or(DVec3::Z);
        let head = left_eye.midpoint(right_eye) - EYE_DEPTH_M * gaze;
        let place = |point: DVec3| camera.project(point - under_pelvis);
        Self {
            secs,
            points: frame.map(place),
            head: place(head),
            nose: place(head + NOSE_M * gaze),
        }
    }

    fn rise_m(&self) -> f64 {
        self.points
            .iter()
            .map(|point| point.y)
            .fold(self.head.y + HEAD_RADIUS_M, f64::max)
    }

    fn draw(&self, svg: &mut String, pen: &Pen, highlighted: JointSet) {
        let colour = &pen.colour;
        let shadow = pen.scale * SHADOW_RADIUS_M;
        svg.push_str(&format!(
            r#"<ellipse cx="{:.1}" cy="{:.1}" rx="{shadow:.1}" ry="{:.1}" opacity="0.1"/>"#,
            pen.origin.x,
            pen.origin.y,
            (shadow * ELEVATION.to_radians().sin()).max(1.0),
        ));
        svg.push_str(&format!(
            r#"<g fill="none" stroke="{colour}" stroke-linecap="round" stroke-linejoin="round">"#
        ));
        // A joint rotates the bones to its children, so these have the halo.
        let turned = KEYPOINT_PARENTS
            .iter()
            .enumerate()
            .filter_map(|(child, &parent)| {
                let parent = usize::try_from(parent).ok()?;
                highlighted
                    .contains(parent)
                    .then(|| vec![self.points[parent], self.points[child]])
            });
        let halo = pen.path(turned);
        if !halo.is_empty() {
            svg.push_str(&format!(
                r#"<path d="{halo}" stroke="{HALO}" stroke-opacity="{HALO_OPACITY}" stroke-width="{:.1}"/>"#,
                HALO_WIDTH_M * pen.scale
            ));
        }
        let depth = |index: usize| self.depth(&LIMBS[index]);
        let mut order: Vec<usize> = (0..LIMBS.len()).collect();
        order.sort_by(|&a, &b| depth(a).total_cmp(&depth(b)));
        for index in order {
            if index == 0 {
                self.draw_trunk(svg, pen);
            }
            let limb = &LIMBS[index];
            let chains = limb.chains.iter();
            let points = |chain: &&[usize]| chain.iter().map(|&point| self.points[point]).collect();
            let path = pen.path(chains.map(points));
            let opacity = if limb.left { LEFT_OPACITY } else { 1.0 };
            svg.push_str(&format!(
                r#"<path d="{path}" stroke-opacity="{opacity}" stroke-width="{:.1}"/>"#,
                limb.width_m * pen.scale
            ));
        }
        svg.push_str("</g>");
    }

    fn draw_trunk(&self, svg: &mut String, pen: &Pen) {
        let outline = pen.path([TRUNK.map(|corner| self.points[corner]).to_vec()]);
        let colour = &pen.colour;
        svg.push_str(&format!(
            r#"<path d="{outline}Z" fill="{colour}" fill-opacity="{TRUNK_OPACITY}" stroke="none"/>"#
        ));
        let head = pen.place(self.head);
        svg.push_str(&format!(
            r#"<circle cx="{:.1}" cy="{:.1}" r="{:.1}" fill="{colour}" stroke="none"/>"#,
            head.x,
            head.y,
            HEAD_RADIUS_M * pen.scale
        ));
        svg.push_str(&format!(
            r#"<path d="{}" stroke-width="{:.1}"/>"#,
            pen.path([vec![self.head, self.nose]]),
            NOSE_WIDTH_M * pen.scale
        ));
    }

    /// Mean depth of a limb's keypoints.
    fn depth(&self, limb: &Limb) -> f64 {
        let points = limb.chains.iter().copied().flatten();
        let depths: Vec<f64> = points.map(|&point| self.points[point].z).collect();
        depths.iter().sum::<f64>() / depths.len() as f64
    }
}

#[cfg(test)]
mod tests;
