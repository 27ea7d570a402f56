//! Import from and export to the released program: weights under its tensor names, and the normaliser.

use std::path::{Path, PathBuf};

use burn::tensor::Device;
use datasets_spec::Skeleton;
use datasets_spec::store::{Disk, Store, if_exists};
use kinematics::normalise::Normalizer;
use pickle::{self, Value, npy};
use safetensors::SafeTensors;
use safetensors::tensor::{Dtype, TensorView};
use serde::de::DeserializeOwned;
use serde::{Deserialize, Serialize};
use work::NewFolder;

use crate::Error;
use crate::checkpoint::{
    self, Files, IMPORTED, Run, RunRecord, SkeletonId, Slot, open_for_use, take, write_atomically,
};
use crate::config::{BertVectors, NetworkConfig, Preset};
use crate::coordinator::{self, CoordinatorConfig, CoordinatorRecord};
use crate::error::json_error;
use crate::features::FeatureStats;
use crate::fit::{self, EditorRecord};
use crate::mdm::{self, MdmConfig, MdmRecord};
use crate::model::coordinator::Coordinator;
use crate::model::denoiser::Denoiser;
use crate::model::position::sinusoid_values;
use crate::model::tmr::SequenceEncoder;
use crate::model::weights::{Networks, from_safetensors, to_safetensors};
use crate::text::FrozenText;
use crate::text::bert::{BertEncoder, BertFiles};
use crate::text::package::unpack;
use crate::tmr::{self, ImportedText, MotionEncoderRecord};

/// Number of rows of the position tables in the released checkpoints.
const TABLE_ROWS: usize = 5_000;

/// Names under which the released checkpoints store copies of the same position table.
const TABLES: [&str; 4] = [
    "positional_encoder.pos_encoding",
    "embed_timestep.sequence_pos_encoder.pos_encoding",
    "positional_encoder_pi.pos_encoding",
    "embed_prog_ind.sequence_pos_encoder.pos_encoding",
];

const RANGE: &str = "range.json";
const SETTINGS: &str = "settings.json";

/// Record of an exported network: what its tensors do not tell.
#[derive(Debug, Serialize, Deserialize)]
pub struct Exported {
    /// The skeleton that it was trained on.
    pub skeleton: SkeletonId,
    /// Its settings, such as the number of heads, the window and the noise schedule, and its normaliser.
    pub network: NetworkRecord,
}

/// Record of a network of one kind.
#[derive(Debug, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum NetworkRecord {
    /// Record of an editor.
    Motionrefit(Box<EditorRecord>),
    /// Record of a coordinator.
    Coordinator(Box<CoordinatorRecord>),
}

impl Exported {
    /// The record that [`export`] wrote beside a file of weights; `None` if there is none.
    ///
    /// # Errors
    /// The file cannot be read, or holds something else.
    pub fn beside(weights: &Path) -> Result<Option<Self>, Error> {
        let path = weights.with_file_name(SETTINGS);
        let text = if_exists(std::fs::read(&path)).map_err(Error::io("read", &path))?;
        let record = text.map(|text| serde_json::from_slice(&text));
        record.transpose().map_err(json_error(&path))
    }
}

impl NetworkRecord {
    /// The normaliser of the network's windows.
    pub fn normalizer(&self) -> &Normalizer {
        match self {
            Self::Motionrefit(record) => &record.normalizer,
            Self::Coordinator(record) => &record.normalizer,
        }
    }
}

/// Makes a run folder of an editor trained elsewhere.
///
/// `weights` is a safetensors file under the released names; tensors that the network does not have, such as position
/// tables, are ignored.
///
/// # Errors
/// The folder holds another run, a tensor is missing or of another shape, or a file cannot be
/// written.
pub fn import_editor(
    run_dir: &Path,
    record: &EditorRecord,
    skeleton: impl Into<SkeletonId>,
    weights: Vec<u8>,
    path: &Path,
    device: &Device,
) -> Result<(), Error> {
    record.check()?;
    let fit::TextRecord::Frozen { width, .. } = &record.text else {
        return Err(Error::config(
            "text.encoder",
            "a model trained elsewhere listens to a frozen encoder",
        ));
    };
    let config = &record.train;
    let mut network = Denoiser::new(
        &config.model,
        config.diffusion.previous,
        *width,
        3 * config.keypoints,
        device,
    );
    from_safetensors(&mut network, weights, "", path)?;
    write_imported(run_dir, skeleton, (fit::KIND, record.clone()), &network)
}

/// Makes a run folder of a coordinator trained elsewhere, like [`import_editor`].
///
/// # Errors
/// As [`import_editor`].
pub fn import_coordinator(
    run_dir: &Path,
    record: &CoordinatorRecord,
    skeleton: impl Into<SkeletonId>,
    weights: Vec<u8>,
    path: &Path,
    device: &Device,
) -> Result<(), Error> {
    record.check()?;
    let config: &CoordinatorConfig = &record.train;
    let mut network = Coordinator::new(&config.model, 3 * config.keypoints, device);
    from_safetensors(&mut network, weights, "", path)?;
    let record = (coordinator::KIND, record.clone());
    write_imported(run_dir, skeleton, record, &network)
}

/// Makes a run folder from the record of a kind of model, with `network` as its best checkpoint.
pub(crate) fn write_imported<C: Serialize + DeserializeOwned>(
    run_dir: &Path,
    skeleton: impl Into<SkeletonId>,
    (kind, record): (&str, C),
    network: &impl Networks,
) -> Result<(), Error> {
    let files = network.to_files(run_dir)?;
    let record = RunRecord::new(kind, IMPORTED, skeleton, record);
    write_weights(&Run::open(run_dir, &record)?, &files)
}

/// Writes the weights of an imported run, unless it has them. A run with other weights is refused.
fn write_weights(run: &Run, files: &Files) -> Result<(), Error> {
    match checkpoint::read(run.dir(), Slot::Best)? {
        Some(known) if known == *files => Ok(()),
        Some(_) => Err(other_import(run.dir())),
        None => run.write(Slot::Best, files),
    }
}

fn other_import(run_dir: &Path) -> Error {
    Error::Refused(format!(
        "{} holds the import of another file; choose another folder",
        run_dir.display()
    ))
}

/// Notes in the record of an imported run which file it was imported from.
///
/// # Errors
/// The run was imported from another file, or a file cannot be read or written.
pub fn note_source(run_dir: &Path, file: &Path) -> Result<(), Error> {
    let hash = Disk.hash(file).map_err(Error::io("read", file))?;
    let mut record = checkpoint::read_any(run_dir)?;
    match &record.imported {
        Some(known) if *known == hash => return Ok(()),
        Some(_) => return Err(other_import(run_dir)),
        None => record.imported = Some(hash),
    }
    let path = run_dir.join(checkpoint::CONFIG);
    let text = serde_json::to_string_pretty(&record).map_err(json_error(&path))?;
    write_atomically(&path, text.as_bytes())
}

/// The text encoder of a TMR trained elsewhere.
#[derive(Clone, Debug)]
pub struct TextSide<'a> {
    /// Contents of a safetensors file with the released tensor names.
    pub weights: Vec<u8>,
    /// Name of the file in errors.
    pub path: &'a Path,
    /// Folder of the network whose last hidden states the encoder reads; DistilBERT for the released TMR. The run keeps
    /// a copy.
    pub folder: &'a Path,
}

/// Makes a run folder of a motion encoder trained elsewhere: that of the released TMR, or the evaluator of MotionFix.
/// The text encoder is included if it is given. Sizes are read from the tensors.
///
/// # Errors
/// The folder holds another run, a tensor is missing or does not fit the recipe or the states of the text network, the
/// statistics are of another width, or a file cannot be read or written.
///
/// # Source
/// `formats` section 7.
pub fn import_motion_encoder(
    run_dir: &Path,
    num_heads: usize,
    features: FeatureStats,
    weights: Vec<u8>,
    path: &Path,
    texts: Option<TextSide<'_>>,
    device: &Device,
) -> Result<(), Error> {
    let recipe = features.recipe;
    check_stats(&features)?;
    let (network, model, num_features) =
        sequence_encoder(weights, "motion_encoder.", num_heads, path, device)?;
    if num_features != recipe.width() {
        let (name, width) = (recipe.name(), recipe.width());
        return Err(Error::encoder(format!(
            "takes {num_features} numbers a frame, and features {name} have {width}"
        )));
    }
    let bytes = to_safetensors(&network, run_dir)?;
    let mut files = Files::from([(tmr::MOTION_WEIGHTS.to_owned(), bytes)]);
    let folder = texts.as_ref().map(|side| side.folder);
    let mut text = None;
    if let Some(side) = texts {
        let (network, record) = text_side(side, num_heads, model.width, device)?;
        let bytes = to_safetensors(&network, run_dir)?;
        files.insert(tmr::TEXT_WEIGHTS.to_owned(), bytes);
        text = Some(record);
    }
    let record = MotionEncoderRecord {
        model,
        features,
        text,
    };
    // The features do not depend on the skeleton.
    let skeleton = Skeleton::smplx_neutral();
    let record = RunRecord::new(checkpoint::MOTION_KIND, IMPORTED, &skeleton, record);
    let run = Run::open(run_dir, &record)?;
    let copy = run_dir.join(tmr::TEXT_FOLDER);
    if let Some(folder) = folder.filter(|_| !copy.exists()) {
        unpack(folder, &copy, device)?;
    }
    write_weights(&run, &files)
}

/// One of TMR's encoders, its sizes, and its input width. Lightning's checkpoints put `name` before the tensor names;
/// extracted files do not.
fn sequence_encoder(
    weights: Vec<u8>,
    name: &str,
    num_heads: usize,
    path: &Path,
    device: &Device,
) -> Result<(SequenceEncoder, NetworkConfig, usize), Error> {
    let file = SafeTensors::deserialize(&weights).map_err(|e| Error::weights(path, e))?;
    let is_named = file.names().iter().any(|tensor| tensor.starts_with(name));
    let prefix = if is_named { name } else { "" };
    let input = format!("{prefix}projection.weight");
    let encoder = format!("{prefix}seqTransEncoder");
    let (model, num_features) = encoder_sizes(&weights, &input, &encoder, num_heads, path)?;
    let mut network = SequenceEncoder::new(num_features, &model, device);
    from_safetensors(&mut network, weights, prefix, path)?;
    Ok((network, model, num_features))
}

/// Loads TMR's text encoder, and makes its record. `latent` is the output width of the motion encoder.
fn text_side(
    side: TextSide<'_>,
    num_heads: usize,
    latent: usize,
    device: &Device,
) -> Result<(SequenceEncoder, ImportedText), Error> {
    let encoder = BertEncoder::load(&BertFiles::in_folder(side.folder)?, device)?;
    let (network, model, width) =
        sequence_encoder(side.weights, "text_encoder.", num_heads, side.path, device)?;
    let states = encoder.width(BertVectors::States);
    if width != states || model.width != latent {
        return Err(Error::encoder(format!(
            "has a text side that takes {width} numbers a token and gives {}; the states of {} have {}, and its \
             motion side gives {latent}",
            model.width,
            side.folder.display(),
            states
        )));
    }
    let record = ImportedText {
        model,
        encoder_hash: encoder.identity(BertVectors::States),
        width,
    };
    Ok((network, record))
}

fn check_stats(features: &FeatureStats) -> Result<(), Error> {
    let recipe = features.recipe;
    for (name, values) in [("mean", &features.mean), ("spread", &features.std)] {
        if values.len() != recipe.width() || values.iter().any(|value| !value.is_finite()) {
            let (width, of, found) = (recipe.width(), recipe.name(), values.len());
            return Err(Error::encoder(format!(
                "needs a {name} of {width} finite numbers for features {of}, and has {found}"
            )));
        }
    }
    Ok(())
}

/// Sizes of a `nn.TransformerEncoder`, and the input width of the layer before it, read from the tensors. The tensors
/// do not determine the number of heads.
pub(crate) fn encoder_sizes(
    weights: &[u8],
    input: &str,
    encoder: &str,
    num_heads: usize,
    path: &Path,
) -> Result<(NetworkConfig, usize), Error> {
    let file = SafeTensors::deserialize(weights).map_err(|e| Error::weights(path, e))?;
    let [width, num_inputs] = matrix_shape(&file, input, path)?;
    let layer = |k: usize| format!("{encoder}.layers.{k}.linear1.weight");
    let [feed_forward, _] = matrix_shape(&file, &layer(0), path)?;
    let model = NetworkConfig {
        width,
        num_layers: (0..)
            .take_while(|&k| file.tensor(&layer(k)).is_ok())
            .count(),
        num_heads,
        feed_forward,
        dropout: 0.0,
    };
    model.check()?;
    Ok((model, num_inputs))
}

fn matrix_shape(file: &SafeTensors<'_>, name: &str, path: &Path) -> Result<[usize; 2], Error> {
    let tensor = file.tensor(name);
    let tensor = tensor.map_err(|problem| Error::weights(path, problem))?;
    <[usize; 2]>::try_from(tensor.shape())
        .map_err(|_| Error::weights(path, format!("{name} is no matrix")))
}

/// Settings in the `args.json` beside a released checkpoint of MDM. Missing keys get the released defaults.
#[derive(Clone, Debug, Default, Deserialize)]
#[serde(default)]
pub struct MdmArgs {
    arch: Option<String>,
    text_encoder_type: Option<String>,
    noise_schedule: Option<String>,
    diffusion_steps: Option<usize>,
    mask_frames: bool,
}

/// Makes a run folder of an MDM trained elsewhere: the encoder variant, with any size and number of diffusion steps.
///
/// # Errors
/// The checkpoint is of another variant, the folder holds another run, a tensor is missing or does not fit the features
/// or the text encoder, the statistics are of another width, or a file cannot be written.
pub fn import_mdm(
    run_dir: &Path,
    args: &MdmArgs,
    num_heads: usize,
    (features, text): (FeatureStats, fit::TextRecord),
    weights: Vec<u8>,
    path: &Path,
    device: &Device,
) -> Result<(), Error> {
    for (field, value, known) in [
        ("arch", &args.arch, "trans_enc"),
        ("text_encoder_type", &args.text_encoder_type, "clip"),
        ("noise_schedule", &args.noise_schedule, "cosine"),
    ] {
        if let Some(value) = value.as_deref().filter(|value| *value != known) {
            let problem = format!("its args.json says {field} {value}; only {known} is known here");
            return Err(Error::weights(path, problem));
        }
    }
    check_stats(&features)?;
    let input = "input_process.poseEmbedding.weight";
    let (model, num_features) = encoder_sizes(&weights, input, "seqTransEncoder", num_heads, path)?;
    if num_features != features.recipe.width() {
        let problem = format!("it takes {num_features} numbers a frame, not those of HumanML3D");
        return Err(Error::weights(path, problem));
    }
    let record = MdmRecord {
        train: MdmConfig {
            model,
            diffusion_steps: args.diffusion_steps.unwrap_or(1_000),
            mask_frames: args.mask_frames,
            ..MdmConfig::preset(Preset::Official)
        },
        features,
        text,
    };
    record.train.check()?;
    let mut network = record.network(device).network;
    from_safetensors(&mut network, weights, "", path)?;
    // The features do not depend on the skeleton.
    let skeleton = Skeleton::smplx_neutral();
    write_imported(run_dir, &skeleton, (mdm::KIND, record), &network)
}

/// Reads the numbers of a file of `torch.save` that holds one tensor, such as `mean.pt`.
///
/// # Errors
/// The file is malformed, or holds something else.
pub fn read_torch_numbers(bytes: &[u8], path: &Path) -> Result<Vec<f32>, Error> {
    let value = pickle::torch::read(bytes).map_err(no_pickle(path))?;
    value
        .as_array()
        .and_then(pickle::Array::to_f64)
        .map(|values| values.into_iter().map(|value| value as f32).collect())
        .ok_or_else(|| Error::weights(path, format!("it holds {}, no tensor", value.describe())))
}

/// Reads the numbers of a NumPy file (`numpy.save`), such as `Mean.npy`.
///
/// # Errors
/// The file is malformed, or holds no numbers.
pub fn read_npy_numbers(bytes: &[u8], path: &Path) -> Result<Vec<f32>, Error> {
    let name = path.display().to_string();
    let array = npy::read_numbers(&name, bytes).map_err(|error| Error::weights(path, error))?;
    Ok(array.values.iter().map(|&value| value as f32).collect())
}

/// Writes a folder with the network of a run as a safetensors file under the released names, including the position
/// tables that the released program requires, and with its normaliser and its [record](Exported) as JSON. Returns the
/// files.
///
/// # Errors
/// The folder is not a run of the editor or the coordinator, its checkpoint is damaged, it has learned words or layers
/// that the released network lacks, `out` holds files, or a file cannot be written.
pub fn export(run_dir: &Path, slot: Slot, out: &Path) -> Result<Vec<PathBuf>, Error> {
    let kind = checkpoint::read_kind(run_dir)?;
    let mut foreign = Vec::new();
    let (mut files, name, width, exported) = if kind == coordinator::KIND {
        let opened = open_for_use::<CoordinatorRecord>(run_dir, slot, coordinator::KIND)?;
        let skeleton = opened.record.skeleton_id();
        let record = opened.record.config;
        let width = record.train.model.width;
        let network = NetworkRecord::Coordinator(Box::new(record));
        let exported = Exported { skeleton, network };
        (opened.files, Coordinator::FILE, width, exported)
    } else {
        let opened = open_for_use::<EditorRecord>(run_dir, slot, fit::KIND)?;
        let skeleton = opened.record.skeleton_id();
        let record = opened.record.config;
        if matches!(record.text, fit::TextRecord::Learned(_)) {
            foreign.push(("learned words", "text.encoder = \"clip\""));
        }
        if record.train.diffusion.tell_frames {
            foreign.push(("tell_frames", "tell_frames = false"));
        }
        let width = record.train.model.width;
        let network = NetworkRecord::Motionrefit(Box::new(record));
        let exported = Exported { skeleton, network };
        (opened.files, Denoiser::FILE, width, exported)
    };
    let bytes = take(&mut files, name, run_dir)?;
    let bytes = with_tables(&bytes, width, foreign, run_dir)?;
    let Normalizer { min, max } = exported.network.normalizer();
    let range = serde_json::json!({ "min": min, "max": max });
    let settings = out.join(SETTINGS);
    let stated = serde_json::to_vec_pretty(&exported).map_err(json_error(&settings))?;
    let folder = NewFolder::beside(out)?;
    for (name, bytes) in [
        (name, &bytes),
        (RANGE, &range.to_string().into_bytes()),
        (SETTINGS, &stated),
    ] {
        write_atomically(&folder.path().join(name), bytes)?;
    }
    folder.publish()?;
    Ok(vec![out.join(name), out.join(RANGE), settings])
}

/// The network in the released form. `foreign` lists settings that the released network lacks, each with what to train
/// with instead; layers that it lacks are added to the list. If any are listed, the export is refused.
fn with_tables(
    bytes: &[u8],
    width: usize,
    mut foreign: Vec<(&str, &str)>,
    path: &Path,
) -> Result<Vec<u8>, Error> {
    let weights = |problem: safetensors::SafeTensorError| Error::weights(path, problem);
    let file = SafeTensors::deserialize(bytes).map_err(weights)?;
    for (layers, instead) in [
        ("embed_previous", "previous = \"inpainted\""),
        ("project_text", "the text encoder's own width"),
        ("gate", "another prediction than \"gated\""),
    ] {
        if file.names().iter().any(|name| name.starts_with(layers)) {
            foreign.push((layers, instead));
        }
    }
    if !foreign.is_empty() {
        let (found, instead): (Vec<&str>, Vec<&str>) = foreign.into_iter().unzip();
        let (found, instead) = (found.join(" and "), instead.join(" and "));
        return Err(Error::misfit(
            "the model",
            format!("it has {found}, which the released network lacks; train one with {instead}"),
        ));
    }
    let rows: Vec<usize> = (0..TABLE_ROWS).collect();
    let table: Vec<u8> = sinusoid_values(&rows, width)
        .iter()
        .flat_map(|value| value.to_le_bytes())
        .collect();
    let table = TensorView::new(Dtype::F32, vec![TABLE_ROWS, 1, width], &table).map_err(weights)?;
    let tensors = file
        .tensors()
        .into_iter()
        .chain(TABLES.map(|name| (name.to_owned(), table.clone())));
    safetensors::serialize(tensors, None).map_err(weights)
}

pub(crate) fn read_numpy_object(bytes: &[u8], path: &Path) -> Result<Value, Error> {
    let problem = |detail: &str| Error::weights(path, detail);
    let header = match bytes {
        [0x93, b'N', b'U', b'M', b'P', b'Y', 1, _, low, high, ..] => {
            10 + usize::from(u16::from_le_bytes([*low, *high]))
        }
        _ => return Err(problem("it is no array of NumPy, format 1")),
    };
    let pickled = bytes
        .get(header..)
        .ok_or_else(|| problem("it ends in its header"))?;
    pickle::read(pickled).map_err(no_pickle(path))
}

fn no_pickle(path: &Path) -> impl Fn(pickle::Error) -> Error {
    move |error| Error::weights(path, format!("{}: {}", error.code, error.reason))
}

/// Reads the normaliser of the released program: an array with one object, a dictionary whose value holds the lower and
/// the upper bound. Each bound is one number, or one for each axis.
///
/// # Errors
/// The file holds something else.
///
/// # Source
/// `data/norm_scaled.npy` (`formats` section 5), whose shape is not published.
pub fn read_released_range(bytes: &[u8], path: &Path) -> Result<Normalizer, Error> {
    let problem = |detail: &str| Error::weights(path, detail);
    let value = read_numpy_object(bytes, path)?;
    let inner = match value.as_sequence() {
        Some([inner]) => inner,
        _ => &value,
    };
    let bounds = inner
        .as_dict()
        .and_then(|entries| entries.first())
        .and_then(|(_, bounds)| bounds.as_sequence())
        .ok_or_else(|| problem("it holds no dictionary of bounds"))?;
    let [min, max, ..] = bounds else {
        return Err(problem("it holds fewer than two bounds"));
    };
    match (axes(min), axes(max)) {
        (Some(min), Some(max)) if min.iter().zip(&max).all(|(min, max)| min < max) => {
            Ok(Normalizer { min, max })
        }
        _ => Err(problem(
            "its bounds are neither numbers nor three numbers, the lower below the upper",
        )),
    }
}

fn axes(value: &Value) -> Option<[f64; 3]> {
    let numbers = match (value.as_float(), value.as_array(), value.as_sequence()) {
        (Some(number), ..) => vec![number],
        (None, Some(array), _) => array.to_f64()?,
        (None, None, Some(items)) => items.iter().map(Value::as_float).collect::<Option<_>>()?,
        (None, None, None) => return None,
    };
    match numbers[..] {
        [one] => Some([one; 3]),
        [x, y, z] => Some([x, y, z]),
        _ => None,
    }
    .filter(|axes| axes.iter().all(|axis| axis.is_finite()))
}

#[cfg(test)]
mod tests {
    use pickle::encode;

    use super::*;

    fn array_of(pickled: &[u8]) -> Vec<u8> {
        let text = "{'descr': '|O', 'fortran_order': False, 'shape': (), }\n";
        let mut bytes = b"\x93NUMPY\x01\x00".to_vec();
        bytes.extend((text.len() as u16).to_le_bytes());
        bytes.extend(text.bytes());
        bytes.extend(pickled);
        bytes
    }

    fn range_of(min: Value, max: Value) -> Result<Normalizer, Error> {
        let key = Value::Tuple(vec![Value::Int(16), Value::Int(3)]);
        let dict = Value::Dict(vec![(key, Value::List(vec![min, max]))]);
        read_released_range(&array_of(&encode(&dict)), Path::new("memory"))
    }

    #[test]
    fn ranges_of_one_number_and_of_three_are_read() {
        let one = range_of(Value::Float(-3.25), Value::Float(3.5)).expect("read");
        assert_eq!((one.min, one.max), ([-3.25; 3], [3.5; 3]));
        let list = |axes: [f64; 3]| Value::List(axes.map(Value::Float).to_vec());
        let (min, max) = ([-3.0, 0.0, -2.0], [3.0, 2.0, 2.5]);
        let three = range_of(list(min), list(max)).expect("read");
        assert_eq!((three.min, three.max), (min, max));
    }

    #[test]
    fn what_is_no_range_is_refused() {
        assert!(range_of(Value::Float(1.0), Value::Float(-1.0)).is_err());
        assert!(range_of(Value::Float(f64::NAN), Value::Float(1.0)).is_err());
        assert!(range_of(Value::text("low"), Value::Float(1.0)).is_err());
        let path = Path::new("memory");
        assert!(read_released_range(b"\x93NUMPY", path).is_err());
        assert!(read_released_range(&array_of(&encode(&Value::Int(3))), path).is_err());
    }

    #[test]
    fn an_array_that_numpy_saved_is_read() {
        // Output of np.save for {(16, 3): (-3.25, 3.5)}, NumPy 2.4, without the header.
        let pickled = "800495a3000000000000008c166e756d70792e5f636f72652e6d756c7469617272617\
            9948c0c5f7265636f6e7374727563749493948c056e756d7079948c076e6461727261799493944b00859443\
            01629487945294284b012968038c0564747970659493948c024f3894898887945294284b038c017c944e4e4\
            e4affffffff4affffffff4b3f749462895d947d944b104b03869447c00a00000000000047400c0000000000\
            00869473617494622e";
        let bytes: Vec<u8> = (0..pickled.len() / 2)
            .map(|at| u8::from_str_radix(&pickled[2 * at..2 * at + 2], 16).expect("a byte"))
            .collect();
        let range = read_released_range(&array_of(&bytes), Path::new("memory")).expect("read");
        assert_eq!((range.min, range.max), ([-3.25; 3], [3.5; 3]));
    }
}
