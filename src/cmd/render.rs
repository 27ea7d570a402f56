//! `stance render`

use std::path::{Path, PathBuf};

use anyhow::bail;
use datasets_spec::record::{EditRow, ItemRow, MotionRow};
use datasets_spec::table::Row as _;
use datasets_spec::{Dataset, Motion, Skeleton};
use eval::draw::raster;
use eval::draw::strip::{Row, Style, sheet, strip};
use pipeline::clips::Clips;
use pipeline::open::{stored_clip, stored_item};
use tables::Condition;

use crate::exit::Exit;
use crate::global::Global;
use crate::local;

/// Draw clips as strips of figures, coloured from start (orange) to end (blue).
///
/// Below its instruction, an item has a row for its source, its target and each answer in a folder of edits; --edits
/// adds the answers of other systems. The extension of --out chooses the format: svg or png for strips below each
/// other, gif for figures that move side by side.
#[derive(clap::Args, Debug)]
pub(crate) struct Args {
    /// Motion files, FILE#NAME for one motion of a file with several, or ids of clips or items of --dataset
    #[arg(required_unless_present = "condition")]
    clips: Vec<String>,
    /// Dataset the ids belong to
    #[arg(long)]
    dataset: Option<PathBuf>,
    /// Also draw the clips of --dataset that meet an SQL condition, such as "flags.poor_fit"; see `stance query --help`
    #[arg(long = "where", value_name = "CONDITION", requires = "dataset")]
    condition: Option<Condition>,
    /// Further folders of edits whose answers to the items are drawn too, such as those without a coordinator
    #[arg(long, num_args = 1.., requires = "dataset", value_name = "EDITS")]
    edits: Vec<PathBuf>,
    /// File to write: .svg, .png or .gif
    #[arg(long, value_parser = crate::local::path())]
    out: PathBuf,
    /// Figures per row
    #[arg(long, default_value_t = Style::default().num_figures)]
    figures: usize,
    /// Pixels of a png or gif per pixel of the drawing
    #[arg(long, default_value_t = 2.0, value_parser = parse_zoom)]
    zoom: f32,
}

fn parse_zoom(text: &str) -> Result<f32, String> {
    match text.parse() {
        Ok(zoom) if (0.1..=10.0).contains(&zoom) => Ok(zoom),
        _ => Err("expected a number from 0.1 to 10".to_owned()),
    }
}

/// Writes a drawing as SVG or PNG, chosen by the extension of the path.
pub(crate) fn write_picture(path: &Path, svg: &str, zoom: f32) -> anyhow::Result<()> {
    let bytes = match path.extension().and_then(|extension| extension.to_str()) {
        Some("svg") => svg.as_bytes().to_vec(),
        Some("png") => raster::png(svg, zoom)?,
        _ => bail!("{} must end in .svg or .png", path.display()),
    };
    local::write(path, &bytes)
}

/// Whether a folder holds items or edits rather than motions.
pub(crate) fn holds_items(dataset: &Dataset) -> bool {
    let tables = &dataset.manifest().tables;
    tables.contains_key(ItemRow::TABLE) && !tables.contains_key(MotionRow::TABLE)
}

/// Opens a dataset to read single clips. Clips are verified when they are read; the files of items are verified here.
pub(crate) fn open_for_clips(path: &Path) -> anyhow::Result<Dataset> {
    let dataset = Dataset::open_unverified(path)?;
    Ok(match holds_items(&dataset) {
        true => Dataset::open(path)?,
        false => dataset,
    })
}

const LABEL_CHARS: usize = 15;

/// Labels of clips, made from their names. If a name is longer than [`LABEL_CHARS`], the common beginning of all names,
/// up to its last separator, is left out; of a single name, its folder is.
fn labels(names: &[String]) -> Vec<String> {
    let [first, others @ ..] = names else {
        return Vec::new();
    };
    let long = names.iter().any(|name| name.chars().count() > LABEL_CHARS);
    let mut shared = match (long, others) {
        (false, _) => 0,
        (true, []) => first.rfind('/').map_or(0, |slash| slash + 1),
        (true, _) => first.len(),
    };
    for name in others {
        let same = first.bytes().zip(name.bytes()).take_while(|(a, b)| a == b);
        shared = shared.min(same.count());
    }
    let separator = |byte: &u8| b"/_-# .@".contains(byte);
    let cut = first.as_bytes()[..shared].iter().rposition(separator);
    let cut = cut.map_or(0, |at| at + 1);
    names
        .iter()
        .map(|name| match name.get(cut..) {
            Some(rest) if !rest.is_empty() => rest.to_owned(),
            _ => name.clone(),
        })
        .collect()
}

/// Path of a motion file without its extension, followed by `#` and the name of the motion if one is given.
fn name_of_file(path: &Path) -> String {
    let text = path.to_string_lossy();
    let (file, key) = text.rsplit_once('#').unwrap_or((&text, ""));
    let stem = Path::new(file).with_extension("");
    match key {
        "" => stem.to_string_lossy().into_owned(),
        key => format!("{}#{key}", stem.display()),
    }
}

const MOST_CLIPS: usize = 200;

fn chosen(dataset: &Dataset, condition: &Condition) -> anyhow::Result<Vec<String>> {
    anyhow::ensure!(
        !holds_items(dataset),
        "{} holds items; --where is of the clips of a dataset",
        dataset.root().display()
    );
    let mut ids = Vec::new();
    for shard in Clips::chosen(dataset, condition)?.shards(None) {
        ids.extend(shard.column::<String>("id")?);
    }
    anyhow::ensure!(
        ids.len() <= MOST_CLIPS,
        "{} clips fulfil the condition, and a picture shows {MOST_CLIPS} at most; add to --where",
        ids.len()
    );
    Ok(ids)
}

pub(crate) fn run(args: &Args, global: &Global) -> anyhow::Result<Exit> {
    let dataset = args.dataset.as_deref().map(open_for_clips).transpose()?;
    let skeleton = match &dataset {
        Some(dataset) => dataset.skeleton()?,
        None => Skeleton::smplx_neutral(),
    };
    let others = further_edits(args, dataset.as_ref())?;
    let mut clips = args.clips.clone();
    if let (Some(condition), Some(dataset)) = (&args.condition, &dataset) {
        clips.extend(chosen(dataset, condition)?);
    }
    let names: Vec<String> = match dataset {
        Some(_) => clips.clone(),
        None => {
            let files = clips.iter();
            files.map(|file| name_of_file(Path::new(file))).collect()
        }
    };
    let mut picture = Picture::default();
    for (clip, label) in clips.iter().zip(labels(&names)) {
        let motion = match &dataset {
            Some(dataset) if holds_items(dataset) => {
                picture.add_item(dataset, clip, &others, &skeleton)?;
                continue;
            }
            Some(dataset) => stored_clip(dataset, clip)?.motion()?,
            None => local::motion_of_file(Path::new(clip), &skeleton)?,
        };
        picture.rows.push(Row::new(label, &motion, &skeleton));
    }
    local::write(&args.out, &picture.encoded(args)?)?;
    let count = picture.rows.len();
    global.say(
        &serde_json::json!({ "out": args.out, "clips": count }),
        &format!("{count} clips drawn in {}", args.out.display()),
    )
}

type Edits<'a> = (&'a PathBuf, Vec<EditRow>);

fn further_edits<'a>(args: &'a Args, dataset: Option<&Dataset>) -> anyhow::Result<Vec<Edits<'a>>> {
    let others: Vec<Edits<'a>> = (args.edits.iter())
        .map(|folder| Ok((folder, Dataset::open(folder)?.read(None)?)))
        .collect::<anyhow::Result<_>>()?;
    if let Some(dataset) = dataset.filter(|_| !others.is_empty()) {
        let root = dataset.root().display();
        anyhow::ensure!(
            holds_items(dataset),
            "--edits adds answers to items, and {root} holds motions; name a folder of items or edits with --dataset"
        );
    }
    Ok(others)
}

#[derive(Default)]
struct Picture {
    rows: Vec<Row>,
    /// Instruction of each item, and the index of its first row.
    instructions: Vec<(String, usize)>,
}

impl Picture {
    /// Adds the source of an item, its target, and each answer in its own folder and in `others`.
    fn add_item(
        &mut self,
        dataset: &Dataset,
        id: &str,
        others: &[Edits<'_>],
        skeleton: &Skeleton,
    ) -> anyhow::Result<()> {
        let item = stored_item(dataset, id)?;
        let edited = item.edited_joints()?;
        let row = |label: String, motion: &Motion| Row {
            highlighted: edited,
            ..Row::new(label, motion, skeleton)
        };
        let first = self.rows.len();
        self.instructions.push((item.instruction.clone(), first));
        self.rows
            .push(Row::new("source", &item.source()?, skeleton));
        if item.target_frames > 0 {
            self.rows.push(row("target".to_owned(), &item.target()?));
        }
        let own = dataset.read::<EditRow>(None)?;
        let mut answers: Vec<&EditRow> = own.iter().filter(|edit| edit.id == item.id).collect();
        for (folder, edits) in others {
            let before = answers.len();
            answers.extend(edits.iter().filter(|edit| edit.id == item.id));
            if answers.len() == before {
                bail!("{} has no answer to item {}", folder.display(), item.id);
            }
        }
        for edit in answers {
            let label = format!("{}, seed {}", edit.system, edit.seed);
            self.rows.push(row(label, &edit.motion()?));
        }
        Ok(())
    }

    fn encoded(&self, args: &Args) -> anyhow::Result<Vec<u8>> {
        let style = Style {
            num_figures: args.figures,
            ..Style::default()
        };
        let extension = args.out.extension();
        Ok(match extension.and_then(|extension| extension.to_str()) {
            Some("svg") => self.svg(&style).into_bytes(),
            Some("png") => raster::png(&self.svg(&style), args.zoom)?,
            Some("gif") => raster::gif(&self.rows, args.zoom / 2.0)?,
            _ => bail!("{} must end in .svg, .png or .gif", args.out.display()),
        })
    }

    /// Draws strips below each other; the strips of an item have its instruction above them.
    fn svg(&self, style: &Style) -> String {
        if self.instructions.is_empty() {
            return strip(&self.rows, style);
        }
        let ends = self.instructions.iter().skip(1).map(|(_, first)| *first);
        let panels: Vec<(String, String)> = self
            .instructions
            .iter()
            .zip(ends.chain([self.rows.len()]))
            .map(|((text, first), end)| (text.clone(), strip(&self.rows[*first..end], style)))
            .collect();
        sheet(&panels, 1, style.width)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn labels_differ_where_the_clips_do() {
        let of = |names: &[&str]| {
            let names: Vec<String> = names.iter().map(|&name| name.to_owned()).collect();
            labels(&names)
        };
        let names = ["captures/monday/walk_old", "captures/monday/walk_neutral"];
        assert_eq!(of(&names), ["old", "neutral"]);
        let names = ["robot#Walking_A", "robot#Walking_B"];
        assert_eq!(of(&names), names);
        let names = ["a/session/walk", "a/session/walk_2"];
        assert_eq!(of(&names), ["walk", "walk_2"]);
        assert_eq!(of(&["walk_a", "walk_b"]), ["walk_a", "walk_b"]);
        assert_eq!(of(&["a/very/long/name/of/one_clip"]), ["one_clip"]);
        assert_eq!(of(&["a/very/long/name"; 2]), ["name", "name"]);
        let of_file = |path: &str| name_of_file(Path::new(path));
        assert_eq!(of_file("a/robot.glb#Walking_A"), "a/robot#Walking_A");
        assert_eq!(of_file("a/walk.bvh"), "a/walk");
    }
}
