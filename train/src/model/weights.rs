//! Saves and loads weights under PyTorch's names, and initialises them.

use std::collections::BTreeMap;
use std::fmt::Write as _;
use std::path::Path;

use burn::module::{Module, ModuleDisplay, ModuleMapper, Param, ParamId};
use burn::tensor::{Tensor, TensorData};
use burn_store::{BurnToPyTorchAdapter, ModuleStore, PyTorchToBurnAdapter, SafetensorsStore};
use datasets_spec::Seed;
use rand::RngExt;
use rand_distr::StandardNormal;
use safetensors::SafeTensors;

use crate::Error;
use crate::checkpoint::{Files, take};

/// Renaming rules: (pattern in PyTorch's name, our name). The store itself converts layouts of linear layers and names
/// of norms. [`RENAMES_BACK`] has the inverse of each rule.
const RENAMES: [(&str, &str); 10] = [
    (r"in_proj_(weight|bias)$", "in_proj.$1"),
    (r"time_embed\.0\.", "hidden."),
    (r"time_embed\.2\.", "output."),
    (r"^pred\.0\.", "pred.hidden."),
    (r"^pred\.2\.", "pred.output."),
    (r"seqTransEncoder\.", "sequence_encoder."),
    (r"seqTransDecoder\.", "sequence_decoder."),
    (r"^input_process\.poseEmbedding\.", "pose_embedding."),
    (r"^output_process\.poseFinal\.", "pose_final."),
    (r"^emb_proj\.1\.", "text_emb_proj."),
];

/// The inverse of [`RENAMES`]: (pattern in our name, PyTorch's name).
const RENAMES_BACK: [(&str, &str); 10] = [
    (r"in_proj\.(weight|bias)$", "in_proj_$1"),
    (
        r"(embed_timestep|embed_prog_ind)\.hidden\.",
        "$1.time_embed.0.",
    ),
    (
        r"(embed_timestep|embed_prog_ind)\.output\.",
        "$1.time_embed.2.",
    ),
    (r"^pred\.hidden\.", "pred.0."),
    (r"^pred\.output\.", "pred.2."),
    (r"sequence_encoder\.", "seqTransEncoder."),
    (r"sequence_decoder\.", "seqTransDecoder."),
    (r"^pose_embedding\.", "input_process.poseEmbedding."),
    (r"^pose_final\.", "output_process.poseFinal."),
    (r"^text_emb_proj\.", "emb_proj.1."),
];

/// The weights of a network as a safetensors file under PyTorch's names. Equal weights give equal
/// bytes.
///
/// # Errors
/// burn's store refuses a tensor.
pub fn to_safetensors<M: Module>(network: &M, path: &Path) -> Result<Vec<u8>, Error> {
    let mut store = SafetensorsStore::from_bytes(None)
        .clear_metadata()
        .with_to_adapter(BurnToPyTorchAdapter);
    for (ours, theirs) in RENAMES_BACK {
        store = store.with_key_remapping(ours, theirs);
    }
    store
        .collect_from(network)
        .and_then(|()| store.get_bytes())
        .map_err(|problem| Error::weights(path, problem))
}

/// Loads a network from the tensors of a safetensors file whose names start with `prefix`; the rest of the name is
/// PyTorch's. Tensors that the network does not have, such as position tables, are ignored. `path` names the file in
/// errors.
///
/// # Errors
/// The file is malformed, or a tensor is missing or of another shape.
pub fn from_safetensors<M: Module>(
    network: &mut M,
    bytes: Vec<u8>,
    prefix: &str,
    path: &Path,
) -> Result<(), Error> {
    from_safetensors_named(network, bytes, prefix, path, &[])
}

/// Like [`from_safetensors`], for networks with further renaming rules: (pattern in PyTorch's name without the prefix,
/// our name).
///
/// # Errors
/// As [`from_safetensors`].
pub fn from_safetensors_named<M: Module>(
    network: &mut M,
    bytes: Vec<u8>,
    prefix: &str,
    path: &Path,
    names: &[(&str, &str)],
) -> Result<(), Error> {
    let found = shapes(&bytes, prefix, path)?;
    let mut store =
        SafetensorsStore::from_bytes(Some(bytes)).with_from_adapter(PyTorchToBurnAdapter);
    if !prefix.is_empty() {
        store = store.with_key_remapping(format!("^{}", prefix.replace('.', r"\.")), "");
    }
    for (theirs, ours) in RENAMES.iter().chain(names) {
        store = store.with_key_remapping(*theirs, *ours);
    }
    let Err(problem) = store.apply_to(network) else {
        return Ok(());
    };
    // The store reports our names, but errors must name the tensors as the file does. The extra renaming rules work in
    // one direction only, so with them the store's error is returned.
    let expected = if names.is_empty() {
        shapes(&to_safetensors(network, path)?, "", path)?
    } else {
        BTreeMap::new()
    };
    let differences: Vec<String> = expected
        .iter()
        .filter_map(|(name, shape)| match found.get(name) {
            None => Some(format!("{prefix}{name} is missing")),
            Some(other) if other != shape => {
                Some(format!("{prefix}{name} is {other:?}, not {shape:?}"))
            }
            Some(_) => None,
        })
        .collect();
    if differences.is_empty() {
        return Err(Error::weights(path, problem));
    }
    let mut detail = differences[..differences.len().min(LISTED)].join(", ");
    if differences.len() > LISTED {
        let _ = write!(detail, ", and {} more differ", differences.len() - LISTED);
    }
    Err(Error::weights(path, detail))
}

/// Takes a network's file out of the files of a checkpoint, and loads the network.
///
/// # Errors
/// The file is missing, damaged or of another network.
pub(crate) fn load_network<M: Module>(
    network: &mut M,
    files: &mut Files,
    name: &str,
    run_dir: &Path,
) -> Result<(), Error> {
    let bytes = take(files, name, run_dir)?;
    from_safetensors(network, bytes, "", &run_dir.join(name))
}

/// Networks as files of a checkpoint.
pub trait Networks: Module + ModuleDisplay {
    /// Name of the weight file; for several networks, that of the main one.
    const FILE: &'static str;

    /// The networks as files by name.
    ///
    /// # Errors
    /// A network cannot be written.
    fn to_files(&self, run_dir: &Path) -> Result<Files, Error> {
        Ok([(Self::FILE.to_owned(), to_safetensors(self, run_dir)?)].into())
    }

    /// The inverse of [`Networks::to_files`]: takes the needed files out of `files`.
    ///
    /// # Errors
    /// A file is missing, damaged or of another network.
    fn take_files(&mut self, files: &mut Files, run_dir: &Path) -> Result<(), Error> {
        load_network(self, files, Self::FILE, run_dir)
    }
}

/// An optional network: without one, there are no files.
impl<N: Networks> Networks for Option<N> {
    const FILE: &'static str = N::FILE;

    fn to_files(&self, run_dir: &Path) -> Result<Files, Error> {
        self.as_ref()
            .map_or_else(|| Ok(Files::new()), |network| network.to_files(run_dir))
    }

    fn take_files(&mut self, files: &mut Files, run_dir: &Path) -> Result<(), Error> {
        self.as_mut()
            .map_or(Ok(()), |network| network.take_files(files, run_dir))
    }
}

/// The files of a main network and of its companion, if there is one.
///
/// # Errors
/// A network cannot be written.
pub(crate) fn both_files(
    main: &impl Networks,
    other: &impl Networks,
    run_dir: &Path,
) -> Result<Files, Error> {
    let mut files = main.to_files(run_dir)?;
    files.extend(other.to_files(run_dir)?);
    Ok(files)
}

const LISTED: usize = 5;

/// Shapes of the tensors whose names start with `prefix` in a safetensors file, by the rest of the name.
fn shapes(bytes: &[u8], prefix: &str, path: &Path) -> Result<BTreeMap<String, Vec<usize>>, Error> {
    let file = SafeTensors::deserialize(bytes).map_err(|error| Error::weights(path, error))?;
    Ok(file
        .iter()
        .filter_map(|(name, view)| {
            Some((name.strip_prefix(prefix)?.to_owned(), view.shape().to_vec()))
        })
        .collect())
}

/// Initialises every parameter of a network, and derives the parameter's id from its path in the network.
///
/// Values depend only on the seed and the path, so networks can be built in parallel. Ids depend on paths, so that the
/// optimiser finds a parameter's state in another process.
///
/// # Errors
/// The network has a parameter without an initialisation rule.
///
/// # Source
/// The distributions are PyTorch's: linear layers uniform within `1/sqrt(fan_in)`; the joint
/// projection of attention Xavier-uniform and the biases of attention zero; norms one and zero, and
/// the running mean and variance of a batch norm zero and one; embeddings and learned tokens standard
/// normal; in the skip transformers of MLD every matrix Xavier-uniform, and learned positions between 0 and
/// 1.
pub fn draw<M: Module>(network: M, seed: Seed) -> Result<M, Error> {
    let mut draw = Draw {
        seed,
        path: Vec::new(),
        containers: Vec::new(),
        fan_in: 1,
        unknown: None,
    };
    let network = network.map(&mut draw);
    match draw.unknown {
        None => Ok(network),
        Some((parameter, layer)) => Err(Error::Refused(format!(
            "parameter {parameter} of layer {layer} has no rule for its first values; add one to \
             model::weights::draw"
        ))),
    }
}

struct Draw {
    seed: Seed,
    path: Vec<String>,
    containers: Vec<String>,
    /// Number of inputs of the linear layer being visited; its weight is visited before its bias.
    fan_in: usize,
    /// Name and layer of the first parameter without an initialisation rule.
    unknown: Option<(String, String)>,
}

enum Values {
    Constant(f32),
    /// Uniform between minus and plus the bound.
    Uniform(f64),
    /// Uniform between 0 and 1.
    Unit,
    Normal,
}

impl Draw {
    fn values(&mut self, name: &str, shape: &[usize]) -> Values {
        let mut structs = self
            .containers
            .iter()
            .rev()
            .filter_map(|container| container.strip_prefix("Struct:"));
        let layer = structs.clone().next().unwrap_or_default();
        let is_attention = name.contains("in_proj") || name.contains("out_proj");
        let is_xavier = name.contains("in_proj") || structs.any(|name| name == "SkipLayers");
        match (layer, name.rsplit('.').next().unwrap_or_default()) {
            ("LayerNorm" | "BatchNorm", "gamma") | ("BatchNorm", "running_var") => {
                Values::Constant(1.0)
            }
            ("LayerNorm" | "BatchNorm", "beta") | ("BatchNorm", "running_mean") => {
                Values::Constant(0.0)
            }
            ("Linear", "weight") => {
                self.fan_in = shape[0];
                if is_xavier {
                    // Xavier: sqrt(6 / (inputs + outputs)).
                    Values::Uniform((6.0 / (shape[0] + shape[1]) as f64).sqrt())
                } else {
                    Values::Uniform((self.fan_in as f64).sqrt().recip())
                }
            }
            ("Linear", "bias") if is_attention => Values::Constant(0.0),
            ("Linear", "bias") => Values::Uniform((self.fan_in as f64).sqrt().recip()),
            ("Embedding", "weight")
            | ("SequenceEncoder", "tokens")
            | ("MotionVae", "global_motion_token")
            | ("Tmed", "sep_token") => Values::Normal,
            ("LearnedPositions", "pe") => Values::Unit,
            (layer, _) => {
                let layer = layer.to_owned();
                self.unknown.get_or_insert_with(|| (name.to_owned(), layer));
                Values::Constant(f32::NAN)
            }
        }
    }
}

impl ModuleMapper for Draw {
    fn enter_module(&mut self, name: &str, container_type: &str) {
        self.path.push(name.to_owned());
        self.containers.push(container_type.to_owned());
    }

    fn exit_module(&mut self, _name: &str, _container_type: &str) {
        self.path.pop();
        self.containers.pop();
    }

    fn map_float<const D: usize>(&mut self, param: Param<Tensor<D>>) -> Param<Tensor<D>> {
        let name = self.path.join(".");
        let id = ParamId::from(Seed(0).draw_u64(&["parameter", &name]));
        let shape = param.lazy_shape();
        let count = shape.num_elements();
        let mut rng = self.seed.rng(&["parameter", &name]);
        let dims: Vec<usize> = (0..D).map(|axis| shape[axis]).collect();
        let values: Vec<f32> = match self.values(&name, &dims) {
            Values::Constant(value) => vec![value; count],
            Values::Uniform(bound) => (0..count)
                .map(|_| rng.random_range(-bound..bound) as f32)
                .collect(),
            Values::Unit => (0..count).map(|_| rng.random_range(0.0..1.0)).collect(),
            Values::Normal => (0..count).map(|_| rng.sample(StandardNormal)).collect(),
        };
        let device = param.lazy_device();
        let tensor = Tensor::from_data(TensorData::new(values, shape), &device);
        param.transform_for_load(tensor, id)
    }
}

#[cfg(test)]
mod tests {
    use burn::nn::{BatchNormConfig, Linear, LinearConfig};
    use burn::tensor::Device;

    use super::*;
    use crate::transfer::read;

    fn linear(seed: u64) -> Linear {
        draw(
            LinearConfig::new(16, 4).init(&Device::flex().autodiff()),
            Seed(seed),
        )
        .expect("a known layer")
    }

    #[test]
    fn a_batch_norm_begins_as_pytorchs_does() {
        let device = Device::flex().autodiff();
        let norm = draw(BatchNormConfig::new(8).init(&device), Seed(3)).expect("a known layer");
        for (tensor, expected) in [
            (norm.gamma.val(), 1.0),
            (norm.beta.val(), 0.0),
            (norm.running_mean.value(), 0.0),
            (norm.running_var.value(), 1.0),
        ] {
            assert_eq!(read(tensor), [expected; 8]);
        }
    }

    #[test]
    fn a_parameter_without_a_rule_is_an_error_that_names_it() {
        #[derive(Module, Debug)]
        struct Odd {
            inner: Linear,
            scale: Param<Tensor<1>>,
        }
        let device = Device::flex();
        let odd = Odd {
            inner: linear(1),
            scale: Param::from_tensor(Tensor::zeros([3], &device)),
        };
        let error = draw(odd, Seed(1)).expect_err("no rule").to_string();
        assert!(error.starts_with("parameter scale of layer Odd"), "{error}");
    }

    #[test]
    fn parameters_follow_from_seed_and_name() {
        let bytes = |layer: &Linear| to_safetensors(layer, Path::new("memory")).expect("saved");
        let layer = linear(1);
        assert_eq!(bytes(&layer), bytes(&linear(1)));
        assert_ne!(bytes(&layer), bytes(&linear(2)));
        assert_eq!(layer.weight.id, linear(2).weight.id);
        assert!(layer.weight.val().is_require_grad());
        let values = read(layer.weight.val());
        assert!(values.iter().all(|value| value.abs() <= 0.25));
        assert!(values.iter().any(|value| value.abs() > 0.2));
    }

    #[test]
    fn a_network_of_another_size_is_refused() {
        let path = Path::new("memory");
        let bytes = to_safetensors(&linear(1), path).expect("saved");
        let mut other = LinearConfig::new(16, 5).init(&Device::flex());
        assert!(matches!(
            from_safetensors(&mut other, bytes.clone(), "", path),
            Err(Error::Weights { .. })
        ));
        let mut other = LinearConfig::new(16, 4).init(&Device::flex());
        assert!(from_safetensors(&mut other, bytes[..40].to_vec(), "", path).is_err());
        from_safetensors(&mut other, bytes.clone(), "", path).expect("loaded");
        assert_eq!(to_safetensors(&other, path).expect("saved"), bytes);
    }
}
