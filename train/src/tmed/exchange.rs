//! Import of TMED trained elsewhere: released weights and statistics.

use std::path::Path;

use burn::tensor::Device;
use datasets_spec::Skeleton;
use safetensors::SafeTensors;

use super::config::TmedConfig;
use super::features::{FeatureStatistics, NUM_FEATURES};
use super::task::{KIND, TmedRecord};
use crate::Error;
use crate::config::{NetworkConfig, Preset};
use crate::exchange::{encoder_sizes, read_numpy_object, write_imported};
use crate::fit::TextRecord;
use crate::model::weights::{from_safetensors, to_safetensors};

/// Parameters of released checkpoints that the released network never uses.
const UNUSED: [&str; 2] = ["feat_comb_coeff", "first_pose_proj."];

/// Makes a run folder of a TMED trained elsewhere, with the released settings. Sizes are read from the tensors, except
/// for the number of attention heads. The features are normalised by `statistics`, and `text` is the frozen text
/// encoder, CLIP ViT-L/14.
///
/// `weights` is a safetensors file under the released names.
///
/// # Errors
/// The folder holds another run, a tensor is missing, unknown or of another shape, the statistics are
/// of another width, or a file cannot be written.
pub fn import_tmed(
    run_dir: &Path,
    num_heads: usize,
    (statistics, text): (FeatureStatistics, TextRecord),
    weights: Vec<u8>,
    path: &Path,
    device: &Device,
) -> Result<(), Error> {
    let record = TmedRecord {
        train: TmedConfig {
            model: sizes(&weights, num_heads, path)?,
            ..TmedConfig::preset(Preset::Official)
        },
        statistics,
        text,
        compose: None,
    };
    record.check()?;
    let mut model = record.model(device);
    check_names(&to_safetensors(&model.denoiser, path)?, &weights, path)?;
    from_safetensors(&mut model.denoiser, weights, "", path)?;
    // MotionFix uses another body model, but this program poses motions on its own skeleton.
    let skeleton = Skeleton::smplx_neutral();
    write_imported(run_dir, &skeleton, (KIND, record), &model.denoiser)
}

fn sizes(weights: &[u8], num_heads: usize, path: &Path) -> Result<NetworkConfig, Error> {
    let source = "pose_proj_in_source.weight";
    let (model, num_features) = encoder_sizes(weights, source, "encoder", num_heads, path)?;
    if num_features != NUM_FEATURES {
        return Err(Error::weights(
            path,
            format!("it takes {num_features} numbers a frame, expected {NUM_FEATURES}"),
        ));
    }
    Ok(NetworkConfig {
        dropout: TmedConfig::preset(Preset::Official).model.dropout,
        ..model
    })
}

/// Refuses tensors that the network lacks and that are not known to be unused, such as those of a network with more
/// parts.
fn check_names(ours: &[u8], theirs: &[u8], path: &Path) -> Result<(), Error> {
    let open = |bytes| SafeTensors::deserialize(bytes).map_err(|error| Error::weights(path, error));
    let (ours, theirs) = (open(ours)?, open(theirs)?);
    let is_unused = |name: &str| {
        // Released checkpoints store position tables as "pe".
        name.ends_with(".pe") || UNUSED.iter().any(|unused| name.starts_with(unused))
    };
    match theirs
        .names()
        .into_iter()
        .find(|name| !is_unused(name) && ours.tensor(name).is_err())
    {
        None => Ok(()),
        Some(name) => Err(Error::weights(path, format!("{name} is not in TMED"))),
    }
}

/// Reads the statistics of MotionFix (`statistics_motionfix.npy`): a dictionary of feature groups, each
/// with its mean and standard deviation.
///
/// # Errors
/// The file is malformed, or a group is missing or of another width.
///
/// # Source
/// `formats` section 6.
pub fn read_released_statistics(bytes: &[u8], path: &Path) -> Result<FeatureStatistics, Error> {
    /// The feature groups in order, with their widths.
    const GROUPS: [(&str, usize); 5] = [
        ("body_transl_delta_pelv", 3),
        ("body_orient_xy", 6),
        ("z_orient_delta", 6),
        ("body_pose", 126),
        ("body_joints_local_wo_z_rot", 66),
    ];
    let value = read_numpy_object(bytes, path)?;
    let numbers = |of: &str| -> Result<Vec<f32>, Error> {
        let mut all = Vec::with_capacity(NUM_FEATURES);
        for (group, width) in GROUPS {
            let array = value.get(group).and_then(|group| group.get(of)?.as_array());
            let found = array.and_then(pickle::Array::to_f64).unwrap_or_default();
            if found.len() != width {
                let problem = format!(
                    "{of} of {group} has {} numbers, expected {width}",
                    found.len()
                );
                return Err(Error::weights(path, problem));
            }
            all.extend(found.into_iter().map(|number| number as f32));
        }
        Ok(all)
    };
    let statistics = FeatureStatistics {
        mean: numbers("mean")?,
        std: numbers("std")?,
    };
    statistics.check()?;
    Ok(statistics)
}

#[cfg(test)]
mod tests {
    use pickle::{Array, Value, encode};

    use super::*;

    #[test]
    fn released_statistics_are_read_in_the_order_of_the_features() {
        let array =
            |width: usize, of: f32| Value::Array(Array::from_f32(&[width], vec![of; width]).into());
        let group = |name: &str, width: usize, of: f32| {
            let entries = vec![
                (Value::text("mean"), array(width, of)),
                (Value::text("std"), array(width, of + 10.0)),
            ];
            (Value::text(name), Value::Dict(entries))
        };
        let mut groups = vec![
            group("body_pose", 126, 4.0),
            group("body_transl", 3, 9.0),
            group("body_transl_delta_pelv", 3, 1.0),
            group("z_orient_delta", 6, 3.0),
            group("body_orient_xy", 6, 2.0),
            group("body_joints_local_wo_z_rot", 66, 5.0),
        ];
        let file = |groups: &[(Value, Value)]| {
            let mut bytes = b"\x93NUMPY\x01\x00\x02\x00{}".to_vec();
            bytes.extend(encode(&Value::Dict(groups.to_vec())));
            read_released_statistics(&bytes, Path::new("memory"))
        };
        let read = file(&groups).expect("read");
        let starts = [0, 3, 9, 15, 141, 206];
        let means = starts.map(|index| read.mean[index]);
        assert_eq!(means, [1.0, 2.0, 3.0, 4.0, 5.0, 5.0]);
        let stds = starts.map(|index| read.std[index]);
        assert_eq!(stds, [11.0, 12.0, 13.0, 14.0, 15.0, 15.0]);
        groups.pop();
        assert!(file(&groups).is_err());
    }
}
