//! Line plots and bar charts.

use glam::DVec2;

use super::{FAINT, Rgb, level_line, line, open, text};

/// A named line.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Curve {
    /// Name in the legend.
    pub name: String,
    /// Abscissa and ordinate of each point, from left to right. A point that is not finite, or not
    /// positive on a logarithmic axis, interrupts the line.
    pub points: Vec<(f64, f64)>,
    /// Half width of each point's interval, drawn as an error bar; empty for a line without error bars. Values that are
    /// 0 or not finite are not drawn.
    pub intervals: Vec<f64>,
}

/// How ordinates are spaced.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Scale {
    /// Equal distances for equal differences.
    #[default]
    Linear,
    /// Equal distances for equal ratios; suits losses.
    Log,
}

/// Curves on common axes.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Plot {
    /// Title above the axes; empty for none.
    pub title: String,
    /// Label of the x axis.
    pub x_label: String,
    /// Names of the abscissas 0, 1, 2 and so on on a categorical axis; empty on a numeric one.
    pub x_names: Vec<String>,
    /// Label of the y axis.
    pub y_label: String,
    /// How ordinates are spaced.
    pub y_scale: Scale,
    /// The lines.
    pub curves: Vec<Curve>,
}

/// Named counts.
#[derive(Clone, Debug, PartialEq)]
pub struct Bars {
    /// Title above the bars.
    pub title: String,
    /// Label of the axis.
    pub x_label: String,
    /// Label and height of each bar, from left to right.
    pub bars: Vec<(String, f64)>,
}

/// A value for every pair of settings.
#[derive(Clone, Debug, PartialEq)]
pub struct HeatMap {
    /// Title above the cells; empty for none.
    pub title: String,
    /// Label of the horizontal axis, and its values.
    pub x: (String, Vec<String>),
    /// Label of the vertical axis, and its values from top to bottom.
    pub y: (String, Vec<String>),
    /// Values, row after row; one that is not finite is left blank.
    pub values: Vec<f64>,
}

/// Colours of the lowest and the highest value of a heat map, both pale enough for dark text.
const COLD: Rgb = Rgb([214.0, 230.0, 244.0]);
const HOT: Rgb = Rgb([244.0, 178.0, 110.0]);

/// Draws a heat map as one SVG document.
///
/// # Panics
/// If there is not exactly one value for every pair.
pub fn heat_map(map: &HeatMap) -> String {
    let (columns, rows) = (&map.x.1, &map.y.1);
    assert_eq!(
        map.values.len(),
        columns.len() * rows.len(),
        "a value for every pair"
    );
    let mut svg = begin(SIZE, &map.title);
    let Some((low, high)) = extent(map.values.iter().copied().filter(|v| v.is_finite())) else {
        return without_values(svg);
    };
    let (start, end) = (MARGIN_START, SIZE - MARGIN_END);
    let cell = (end - start) / DVec2::new(columns.len() as f64, rows.len() as f64);
    for (row, label) in rows.iter().enumerate() {
        let middle = start.y + cell.y * (row as f64 + 0.5);
        let at = DVec2::new(start.x - 8.0, middle + 4.0);
        text(&mut svg, at, "end", 11.0, FAINT, label);
        for column in 0..columns.len() {
            let value = map.values[row * columns.len() + column];
            if !value.is_finite() {
                continue;
            }
            let share = if high > low {
                (value - low) / (high - low)
            } else {
                0.5
            };
            let corner = start + cell * DVec2::new(column as f64, row as f64);
            let style = format!(r#"rx="3" fill="{}""#, COLD.towards(HOT, share).hex());
            rect(&mut svg, corner + 1.5, cell - 3.0, &style);
            let at = DVec2::new(corner.x + cell.x / 2.0, middle + 4.0);
            let shown = format!("{value:.2}");
            text(&mut svg, at, "middle", 12.0, r##"fill="#1D1F23""##, &shown);
        }
    }
    for (column, label) in columns.iter().enumerate() {
        let at = DVec2::new(start.x + cell.x * (column as f64 + 0.5), end.y + 16.0);
        text(&mut svg, at, "middle", 11.0, FAINT, label);
    }
    axis_label(&mut svg, SIZE, &map.x.0);
    side_label(&mut svg, 14.0, [start.y, end.y], &map.y.0);
    svg + "</svg>"
}

/// Line colours: six of the colour-blind safe palette of Okabe and Ito, ordered by contrast on light and dark pages.
const COLOURS: [&str; 6] = [
    "#0072B2", "#E69F00", "#009E73", "#D55E00", "#CC79A7", "#56B4E9",
];

/// Size of a drawing in pixels.
const SIZE: DVec2 = DVec2::new(640.0, 300.0);
/// Space around the axes in pixels: left and top, right and bottom.
const MARGIN_START: DVec2 = DVec2::new(64.0, 34.0);
const MARGIN_END: DVec2 = DVec2::new(16.0, 46.0);
/// Target number of ticks on an axis; the actual number varies, so that ticks fall on round numbers.
const NUM_TICKS: f64 = 5.0;
/// On an axis of more than this many decades, only powers of ten have ticks.
const SPARSE_DECADES: f64 = 3.0;
/// Longest curve that is drawn point by point. A longer curve is cut into half as many pieces and drawn by the minimum
/// and maximum of each, which looks the same and keeps the file small.
const MAX_POINTS: usize = 1200;
/// Share of the range that is added below and above the curves.
const PADDING: f64 = 0.04;
/// Width of a character in the legend, and space added to each entry, in pixels.
const LEGEND_CHAR: f64 = 6.6;
const LEGEND_GAP: f64 = 34.0;
/// Height of a row of a legend below the axes in pixels.
const LEGEND_ROW: f64 = 18.0;
/// Width of a character of a title in pixels.
const TITLE_CHAR: f64 = 7.6;
/// Baseline of titles and of legends beside them in pixels.
const HEADING_Y: f64 = 16.0;

/// Draws curves as one SVG document.
pub fn plot(plot: &Plot) -> String {
    let title = if plot.title.is_empty() {
        format!("{} over {}", plot.y_label, plot.x_label)
    } else {
        plot.title.clone()
    };
    let rows = legend_rows(&plot.curves);
    let below = match rows.len() {
        0 | 1 => 0.0,
        count => LEGEND_ROW * count as f64,
    };
    let mut svg = open(SIZE.x, SIZE.y + below, &title);
    heading(&mut svg, &plot.title);
    let Some(axes) = Axes::around(plot) else {
        return without_values(svg);
    };
    axes.draw(&mut svg, plot);
    for (index, curve) in plot.curves.iter().enumerate() {
        let path = axes.path(&curve.points);
        if !path.is_empty() {
            svg.push_str(&format!(
                r#"<path d="{path}" fill="none" stroke="{}"{} stroke-width="1.8" stroke-linejoin="round" stroke-linecap="round"/>"#,
                colour(index),
                dashes(index)
            ));
        }
        axes.intervals(&mut svg, curve, colour(index));
    }
    match rows.as_slice() {
        [_] => legend(&mut svg, &plot.title, &plot.curves),
        rows => legend_below(&mut svg, &plot.curves, rows),
    }
    svg + "</svg>"
}

/// Draws counts as bars in one SVG document: vertical bars if all labels fit side by side, else
/// horizontal ones. Negative heights are drawn as 0.
pub fn bar_chart(chart: &Bars) -> String {
    let bars = &chart.bars;
    let heights = bars.iter().map(|(_, value)| bar_height(*value));
    let highest = heights.fold(0.0, f64::max);
    if highest == 0.0 {
        return without_values(begin(SIZE, &chart.title));
    }
    let longest = bars.iter().map(|(label, _)| label.chars().count()).max();
    let label_width = LEGEND_CHAR * longest.unwrap_or(0) as f64;
    let slot = (SIZE.x - MARGIN_START.x - MARGIN_END.x) / bars.len() as f64;
    let svg = match label_width + LEGEND_CHAR <= slot {
        true => standing_bars(chart, highest, slot),
        false => lying_bars(chart, highest, label_width),
    };
    svg + "</svg>"
}

/// Adds a rectangle; `attributes` are written as given.
fn rect(svg: &mut String, corner: DVec2, size: DVec2, attributes: &str) {
    svg.push_str(&format!(
        r#"<rect x="{:.1}" y="{:.1}" width="{:.1}" height="{:.1}" {attributes}/>"#,
        corner.x, corner.y, size.x, size.y
    ));
}

fn bar(svg: &mut String, corner: DVec2, size: DVec2) {
    let style = format!(r#"rx="1.5" fill="{}" fill-opacity="0.85""#, colour(0));
    rect(svg, corner, size, &style);
}

/// The height of a bar; 0 if the value is negative or not finite.
fn bar_height(value: f64) -> f64 {
    match value.is_finite() {
        true => value.max(0.0),
        false => 0.0,
    }
}

fn standing_bars(chart: &Bars, highest: f64, slot: f64) -> String {
    let mut svg = begin(SIZE, &chart.title);
    let (start, end) = (MARGIN_START, SIZE - MARGIN_END);
    let ticks = linear_ticks(0.0, highest);
    let top = ticks.last().copied().unwrap_or(highest).max(highest);
    let y_of = |value: f64| end.y - (end.y - start.y) * value / top;
    for tick in ticks {
        grid_line(&mut svg, start.x, end.x, y_of(tick), tick, tick.abs());
    }
    for (index, (label, value)) in chart.bars.iter().enumerate() {
        let left = start.x + slot * index as f64;
        let y = y_of(bar_height(*value));
        let corner = DVec2::new(left + 0.1 * slot, y);
        bar(&mut svg, corner, DVec2::new(0.8 * slot, end.y - y));
        let at = DVec2::new(left + slot / 2.0, end.y + 16.0);
        text(&mut svg, at, "middle", 11.0, FAINT, label);
    }
    axis_label(&mut svg, SIZE, &chart.x_label);
    svg
}

/// Distance from one horizontal bar to the next in pixels.
const BAR_ROW: f64 = 15.0;

fn lying_bars(chart: &Bars, highest: f64, label_width: f64) -> String {
    let height = MARGIN_START.y + BAR_ROW * chart.bars.len() as f64 + MARGIN_END.y;
    let size = DVec2::new(SIZE.x.max(2.0 * label_width), height);
    let mut svg = begin(size, &chart.title);
    let start = DVec2::new(label_width + 24.0, MARGIN_START.y);
    let end = size - MARGIN_END;
    let ticks = linear_ticks(0.0, highest);
    let far = ticks.last().copied().unwrap_or(highest).max(highest);
    let x_of = |value: f64| start.x + (end.x - start.x) * value / far;
    for tick in ticks {
        let x = x_of(tick);
        line(&mut svg, DVec2::new(x, start.y), DVec2::new(x, end.y));
        let at = DVec2::new(x, end.y + 16.0);
        let label = tick_text(tick, tick.abs());
        text(&mut svg, at, "middle", 11.0, FAINT, &label);
    }
    for (index, (label, value)) in chart.bars.iter().enumerate() {
        let top = start.y + BAR_ROW * index as f64;
        let corner = DVec2::new(start.x, top + 0.1 * BAR_ROW);
        let width = x_of(bar_height(*value)) - start.x;
        bar(&mut svg, corner, DVec2::new(width, 0.8 * BAR_ROW));
        let at = DVec2::new(start.x - 8.0, top + 0.75 * BAR_ROW);
        text(&mut svg, at, "end", 11.0, FAINT, label);
    }
    side_label(&mut svg, 12.0, [start.y, end.y], &chart.x_label);
    svg
}

/// A histogram with bins of equal, round width, labelled by their lower ends; values that are not
/// finite are left out. There are at most `max_bins + 1` bins.
pub fn histogram(values: &[f64], max_bins: usize) -> Vec<(String, f64)> {
    let finite: Vec<f64> = values.iter().copied().filter(|v| v.is_finite()).collect();
    let Some((low, high)) = extent(finite.iter().copied()) else {
        return Vec::new();
    };
    let width = if high > low {
        round_step((high - low) / max_bins.max(1) as f64)
    } else {
        1.0
    };
    // A value on the edge of a bin belongs above it, also if its quotient is rounded down: 5.8 / 0.1 is 57.99…
    let bin_of = |value: f64| (value / width + 1e-9).floor();
    let first = bin_of(low);
    let num_bins = (bin_of(high) - first) as usize + 1;
    let mut counts = vec![0.0; num_bins];
    for value in finite {
        let bin = (bin_of(value) - first) as usize;
        counts[bin.min(num_bins - 1)] += 1.0;
    }
    let label = |bin: usize| tick_text((first + bin as f64) * width, width);
    let bins = counts.into_iter().enumerate();
    bins.map(|(bin, count)| (label(bin), count)).collect()
}

fn colour(index: usize) -> &'static str {
    COLOURS[index % COLOURS.len()]
}

/// Opens a drawing with its title as heading.
fn begin(size: DVec2, title: &str) -> String {
    let mut svg = open(size.x, size.y, title);
    heading(&mut svg, title);
    svg
}

fn heading(svg: &mut String, title: &str) {
    if !title.is_empty() {
        let at = DVec2::new(MARGIN_START.x, HEADING_Y);
        text(svg, at, "start", 13.0, r#"font-weight="600""#, title);
    }
}

fn axis_label(svg: &mut String, size: DVec2, label: &str) {
    let at = DVec2::new((MARGIN_START.x + size.x - MARGIN_END.x) / 2.0, size.y - 8.0);
    text(svg, at, "middle", 12.0, FAINT, label);
}

/// A label turned by 90 degrees, read upwards, in the middle between two heights.
fn side_label(svg: &mut String, x: f64, [top, bottom]: [f64; 2], label: &str) {
    let middle = DVec2::new(x, f64::midpoint(top, bottom));
    let turned = format!(
        r#"{FAINT} transform="rotate(-90 {} {:.1})""#,
        middle.x, middle.y
    );
    text(svg, middle, "middle", 12.0, &turned, label);
}

/// Writes "no values yet" into an empty plot, and closes it.
fn without_values(mut svg: String) -> String {
    text(&mut svg, SIZE / 2.0, "middle", 13.0, FAINT, "no values yet");
    svg + "</svg>"
}

/// A horizontal line of the grid with its value, written for an axis of this span.
fn grid_line(svg: &mut String, left: f64, right: f64, y: f64, value: f64, span: f64) {
    level_line(svg, left, right, y);
    let at = DVec2::new(left - 8.0, y + 4.0);
    text(svg, at, "end", 11.0, FAINT, &tick_text(value, span));
}

/// Attribute that dashes curves whose colour an earlier curve has already; empty for the others.
fn dashes(index: usize) -> &'static str {
    const DASHES: [&str; 4] = [
        "",
        r#" stroke-dasharray="8 4""#,
        r#" stroke-dasharray="2 4""#,
        r#" stroke-dasharray="10 4 2 4""#,
    ];
    DASHES[index / COLOURS.len() % DASHES.len()]
}

/// Width of an entry of a legend, with the space before it.
fn entry_width(curve: &Curve) -> f64 {
    LEGEND_CHAR * curve.name.chars().count() as f64 + LEGEND_GAP
}

/// The curves of each row of a legend; no row for fewer than two curves.
fn legend_rows(curves: &[Curve]) -> Vec<Vec<usize>> {
    let mut rows: Vec<Vec<usize>> = Vec::new();
    if curves.len() < 2 {
        return rows;
    }
    let room = SIZE.x - MARGIN_START.x - MARGIN_END.x + LEGEND_GAP;
    let mut used = f64::INFINITY;
    for (index, curve) in curves.iter().enumerate() {
        used += entry_width(curve);
        match rows.last_mut() {
            Some(row) if used <= room => row.push(index),
            _ => {
                rows.push(vec![index]);
                used = entry_width(curve);
            }
        }
    }
    rows
}

/// An entry of a legend whose text ends at `right`.
fn entry(svg: &mut String, index: usize, curve: &Curve, right: f64, y: f64) {
    text(svg, DVec2::new(right, y), "end", 12.0, "", &curve.name);
    let swatch = right - entry_width(curve) + LEGEND_GAP - 22.0;
    svg.push_str(&format!(
        r#"<path d="M{swatch:.1} {middle:.1}L{:.1} {middle:.1}" stroke="{}"{} stroke-width="3"/>"#,
        swatch + 14.0,
        colour(index),
        dashes(index),
        middle = y - 4.0,
    ));
}

/// A legend of several rows below the axes.
fn legend_below(svg: &mut String, curves: &[Curve], rows: &[Vec<usize>]) {
    for (number, row) in rows.iter().enumerate() {
        let y = SIZE.y + LEGEND_ROW * (number as f64 + 0.6);
        let mut right = MARGIN_START.x - LEGEND_GAP + 22.0;
        for &index in row {
            right += entry_width(&curves[index]);
            entry(svg, index, &curves[index], right, y);
        }
    }
}

fn legend(svg: &mut String, title: &str, curves: &[Curve]) {
    let width: f64 = curves.iter().map(entry_width).sum();
    let title_end = MARGIN_START.x + TITLE_CHAR * title.chars().count() as f64;
    // Entries are placed from the right edge inwards, the last curve first.
    let mut right = SIZE.x - MARGIN_END.x;
    // Beside the title, or below it if the row is full.
    let y = if title_end + width <= right {
        HEADING_Y
    } else {
        HEADING_Y + 15.0
    };
    for (index, curve) in curves.iter().enumerate().rev() {
        entry(svg, index, curve, right, y);
        right -= entry_width(curve);
    }
}

/// Ranges of a plot's axes. On a logarithmic axis, the y range is one of exponents of ten.
struct Axes {
    x: (f64, f64),
    y: (f64, f64),
    scale: Scale,
}

impl Axes {
    /// Axes that contain all drawable points and intervals; `None` without drawable points.
    fn around(plot: &Plot) -> Option<Self> {
        let (curves, scale) = (&plot.curves, plot.y_scale);
        let drawn = |point| on_scale(point, scale);
        let points = curves.iter().flat_map(|curve| &curve.points);
        let points: Vec<(f64, f64)> = points.copied().filter_map(drawn).collect();
        let ends = curves.iter().flat_map(Curve::interval_ends);
        let all = points.iter().copied().chain(ends.filter_map(drawn));
        let (left, right) = extent(points.iter().map(|point| point.0))?;
        let (low, high) = extent(all.map(|point| point.1))?;
        let (left, right) = match plot.x_names.len() {
            0 => widened(left, right),
            names => (-0.5, names as f64 - 0.5),
        };
        let (low, high) = widened(low, high);
        let padding = PADDING * (high - low);
        Some(Self {
            x: (left, right),
            y: (low - padding, high + padding),
            scale,
        })
    }

    fn place(&self, (x, y): (f64, f64)) -> DVec2 {
        let (start, end) = (MARGIN_START, SIZE - MARGIN_END);
        DVec2::new(
            start.x + (end.x - start.x) * (x - self.x.0) / (self.x.1 - self.x.0),
            end.y - (end.y - start.y) * (y - self.y.0) / (self.y.1 - self.y.0),
        )
    }

    fn draw(&self, svg: &mut String, plot: &Plot) {
        let (start, end) = (MARGIN_START, SIZE - MARGIN_END);
        let ticks = match self.scale {
            Scale::Linear => linear_ticks(self.y.0, self.y.1),
            Scale::Log => log_ticks(self.y.0, self.y.1),
        };
        let ticks = match (self.scale, ticks.len()) {
            // A small range may lie between two such numbers.
            (Scale::Log, 0 | 1) => linear_ticks(10f64.powf(self.y.0), 10f64.powf(self.y.1)),
            _ => ticks,
        };
        for tick in ticks {
            let on_axis = match self.scale {
                Scale::Linear => tick,
                Scale::Log => tick.log10(),
            };
            let y = self.place((self.x.0, on_axis)).y;
            let span = match self.scale {
                Scale::Linear => tick.abs(),
                Scale::Log => tick.abs().min(10f64.powf(self.y.1) - 10f64.powf(self.y.0)),
            };
            grid_line(svg, start.x, end.x, y, tick, span);
        }
        level_line(svg, start.x, end.x, end.y);
        let ticks: Vec<(f64, String)> = if plot.x_names.is_empty() {
            linear_ticks(self.x.0, self.x.1)
                .into_iter()
                .map(|tick| (tick, tick_text(tick, self.x.1 - self.x.0)))
                .collect()
        } else {
            let names = plot.x_names.iter().enumerate();
            names.map(|(at, name)| (at as f64, name.clone())).collect()
        };
        for (tick, label) in ticks {
            let x = self.place((tick, self.y.0)).x;
            line(svg, DVec2::new(x, end.y), DVec2::new(x, end.y + 4.0));
            let at = DVec2::new(x, end.y + 17.0);
            text(svg, at, "middle", 11.0, FAINT, &label);
        }
        axis_label(svg, SIZE, &plot.x_label);
        side_label(svg, 14.0, [start.y, end.y], &plot.y_label);
    }

    /// Draws the intervals of a curve and a dot at each point, if the curve has intervals.
    fn intervals(&self, svg: &mut String, curve: &Curve, colour: &str) {
        /// Half the width of the caps of an error bar, and the radius of a dot, in pixels.
        const CAP: f64 = 4.0;
        const DOT: f64 = 3.0;
        if curve.intervals.is_empty() {
            return;
        }
        for &point in &curve.points {
            let Some(point) = on_scale(point, self.scale) else {
                continue;
            };
            let at = self.place(point);
            svg.push_str(&format!(
                r#"<circle cx="{:.1}" cy="{:.1}" r="{DOT}" fill="{colour}"/>"#,
                at.x, at.y
            ));
        }
        let ends: Vec<(f64, f64)> = curve.interval_ends().collect();
        for pair in ends.chunks_exact(2) {
            let both = [pair[0], pair[1]].map(|end| on_scale(end, self.scale));
            let [Some(low), Some(high)] = both else {
                continue;
            };
            let (low, high) = (self.place(low), self.place(high));
            svg.push_str(&format!(
                r#"<path class="interval" d="M{x:.1} {a:.1}L{x:.1} {b:.1}M{l:.1} {a:.1}L{r:.1} {a:.1}M{l:.1} {b:.1}L{r:.1} {b:.1}" stroke="{colour}" stroke-width="1.2"/>"#,
                x = low.x,
                l = low.x - CAP,
                r = low.x + CAP,
                a = low.y,
                b = high.y,
            ));
        }
    }

    fn path(&self, points: &[(f64, f64)]) -> String {
        let mut path = String::new();
        let mut drawing = false;
        for point in thinned(points) {
            let Some(point) = on_scale(point, self.scale) else {
                drawing = false;
                continue;
            };
            let at = self.place(point);
            path.push_str(&format!(
                "{}{:.1} {:.1}",
                if drawing { 'L' } else { 'M' },
                at.x,
                at.y
            ));
            drawing = true;
        }
        path
    }
}

impl Curve {
    /// The lower and upper ends of the drawn intervals, in turn.
    fn interval_ends(&self) -> impl Iterator<Item = (f64, f64)> + '_ {
        let bars = self.points.iter().zip(&self.intervals);
        bars.filter(|(point, half)| point.1.is_finite() && half.is_finite() && **half > 0.0)
            .flat_map(|(&(x, y), half)| [(x, y - half), (x, y + half)])
    }
}

/// A point with its ordinate on the scale; `None` if it cannot be drawn.
fn on_scale((x, y): (f64, f64), scale: Scale) -> Option<(f64, f64)> {
    let y = match scale {
        Scale::Linear => y,
        Scale::Log if y > 0.0 => y.log10(),
        Scale::Log => return None,
    };
    (x.is_finite() && y.is_finite()).then_some((x, y))
}

fn extent(values: impl Iterator<Item = f64>) -> Option<(f64, f64)> {
    values.fold(None, |extent: Option<(f64, f64)>, value| {
        let (low, high) = extent.unwrap_or((value, value));
        Some((low.min(value), high.max(value)))
    })
}

/// The range, widened if its width is zero.
fn widened(low: f64, high: f64) -> (f64, f64) {
    if high > low {
        (low, high)
    } else {
        let half = (0.5 * low.abs()).max(0.5);
        (low - half, high + half)
    }
}

/// The points of a curve; for a long curve, the lowest and highest point of each piece, in order.
fn thinned(points: &[(f64, f64)]) -> Vec<(f64, f64)> {
    if points.len() <= MAX_POINTS {
        return points.to_vec();
    }
    let piece = points.len().div_ceil(MAX_POINTS / 2);
    points
        .chunks(piece)
        .flat_map(|piece| {
            let by_height = |a: &&(f64, f64), b: &&(f64, f64)| a.1.total_cmp(&b.1);
            let low = piece.iter().min_by(by_height);
            let high = piece.iter().max_by(by_height);
            let mut pair: Vec<(f64, f64)> = low.into_iter().chain(high).copied().collect();
            pair.sort_by(|a, b| a.0.total_cmp(&b.0));
            pair
        })
        .collect()
}

/// The smallest number of the form 1, 2, 5 or 10 times a power of ten that is at least the given positive number.
fn round_step(at_least: f64) -> f64 {
    let magnitude = 10f64.powf(at_least.log10().floor());
    [1.0, 2.0, 5.0]
        .into_iter()
        .map(|factor| factor * magnitude)
        .find(|step| *step >= at_least)
        .unwrap_or(10.0 * magnitude)
}

/// Multiples of a round step within a range.
fn linear_ticks(low: f64, high: f64) -> Vec<f64> {
    let step = round_step((high - low) / NUM_TICKS);
    let first = (low / step).ceil() as i64;
    let last = (high / step).floor() as i64;
    (first..=last).map(|index| index as f64 * step).collect()
}

/// Powers of ten within a range of exponents, and in small ranges also 2 and 5 times these.
fn log_ticks(low: f64, high: f64) -> Vec<f64> {
    let factors: &[f64] = if high - low > SPARSE_DECADES {
        &[1.0]
    } else {
        &[1.0, 2.0, 5.0]
    };
    let exponents = low.floor() as i32..=high.ceil() as i32;
    exponents
        .flat_map(|exponent| {
            factors
                .iter()
                .map(move |factor| factor * 10f64.powi(exponent))
        })
        .filter(|tick| (low..=high).contains(&tick.log10()))
        .collect()
}

/// A number with the digits that distinguish ticks on an axis of this span; thousands and millions are abbreviated.
fn tick_text(value: f64, span: f64) -> String {
    const THOUSAND: f64 = 1e3;
    const MILLION: f64 = 1e6;
    /// Numbers below this would need too many digits after the point.
    const SMALL: f64 = 1e-3;
    let trimmed = |value: f64, digits: usize| {
        let text = format!("{value:.digits$}");
        if text.contains('.') {
            text.trim_end_matches('0').trim_end_matches('.').to_owned()
        } else {
            text
        }
    };
    if value == 0.0 {
        "0".to_owned()
    } else if value.abs() >= MILLION {
        format!("{}M", trimmed(value / MILLION, 2))
    } else if value.abs() >= THOUSAND {
        format!("{}k", trimmed(value / THOUSAND, 2))
    } else if value.abs() < SMALL {
        format!("{value:.0e}")
    } else {
        // Two digits beyond the span keep neighbouring ticks distinct.
        let digits = (2.0 - span.log10().floor()).clamp(0.0, 6.0) as usize;
        trimmed(value, digits)
    }
}

#[cfg(test)]
mod tests;
