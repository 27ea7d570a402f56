//! TMED compared with its released code: features, network, guidance, sampling and loss.

use std::path::Path;

use burn::tensor::{Device, Tensor};
use glam::{DQuat, DVec3};
use kinematics::rotation::from_six_d_rows;
use safetensors::SafeTensors;
use train::config::Preset;
use train::gaussian::{Respacing, SampleSteps};
use train::model::pass::Pass;
use train::model::tmed::{Condition, Places, Tmed};
use train::system::EditConfig;
use train::tmed::features::{
    FeatureFrame, FeatureStatistics, GROUPS, NUM_FEATURES, features_of_poses, poses_of_features,
};
use train::tmed::{TmedConfig, branches, group_loss, guided, import_tmed};

use super::gaussian::step_counts;
use super::{Golden, check, floats, max_difference, recorded_poses};
use crate::shared::{frozen_text, opened, refused};

fn network(golden: &Golden) -> Tmed {
    let config = golden.network("latent_dim", "ff_size");
    let (text, features) = (golden.size("text_encoded_dim"), golden.size("nfeats"));
    let network = Tmed::new(&config, text, features, &Device::flex());
    golden.load(network, "weights.")
}

/// Condition of the case. Targets are positioned after the padded sources, as in the released network.
fn condition(golden: &Golden) -> Condition {
    let text: Tensor<3> = golden.tensor("in.text");
    let source = golden.tensor::<3>("in.source").swap_dims(0, 1);
    let [rows, frames, _] = source.dims();
    Condition {
        text_lengths: golden.lengths("in.text_mask"),
        source_lengths: golden.lengths("in.source_mask"),
        places: Places {
            text: text.dims()[1],
            source: vec![frames; rows],
        },
        text,
        source,
    }
}

#[test]
fn golden_tmed_denoiser_and_guidance() {
    let Some(golden) = Golden::find("tmed_denoiser") else {
        return;
    };
    let network = network(&golden);
    let forward = |condition: &Condition| {
        network.forward(
            golden.tensor("in.x"),
            &golden.lengths("in.target_mask"),
            &golden.indices("in.t"),
            condition,
            &Pass::default(),
        )
    };
    let whole = condition(&golden);
    check(forward(&whole), &golden, "out.x0", 5e-5);
    let [rows, frames, _] = whole.source.dims();
    let nothing = Condition {
        source: whole.source.zeros_like(),
        source_lengths: vec![frames; rows],
        ..whole.clone()
    };
    check(forward(&nothing), &golden, "out.x0_zero_source", 5e-5);
    // Texts may be truncated to the longest one: positions of later tokens do not change.
    let longest = *whole.text_lengths.iter().max().expect("rows");
    let cut = Condition {
        text: whole.text.clone().narrow(1, 0, longest),
        ..whole
    };
    check(forward(&cut), &golden, "out.x0", 5e-5);

    let frames = golden.lengths("in.guide.target_mask");
    for weights in golden.between("out.guided_t", "") {
        let name = format!("out.guided_t{weights}");
        let (text, source) = weights.split_once("_m").expect("two weights");
        let [text, source] = [text, source].map(|weight| weight.parse().expect("a number"));
        let condition = guided_condition(&golden, text, source);
        let x = golden.tensor("in.guide.x");
        let all = branches(text, source);
        let pass = Pass::default();
        let found = guided(&network, &all, &condition, &x, &frames, 150, &pass);
        check(found, &golden, &name, 2e-4);
    }
}

/// The condition of the guided row, repeated for each branch. For branches without a source, the released code uses
/// zeros.
fn guided_condition(golden: &Golden, text: f64, source: f64) -> Condition {
    let names = ["in.guide.text_uncond", "in.guide.text_cond"];
    let asked: [Tensor<3>; 2] = names.map(|name| golden.tensor(name));
    let asked_lengths = names.map(|name| golden.lengths(&format!("{name}_mask"))[0]);
    let given = golden.tensor::<3>("in.guide.source").swap_dims(0, 1);
    let seen = golden.lengths("in.guide.source_mask")[0];
    let [_, frames, _] = given.dims();
    let all = branches(text, source);
    let texts = all.iter().map(|branch| usize::from(branch.has_text));
    let sources = all.iter().map(|branch| match branch.has_source {
        true => (given.clone(), seen),
        false => (given.zeros_like(), frames),
    });
    let (sources, source_lengths): (Vec<_>, Vec<_>) = sources.unzip();
    Condition {
        text: Tensor::cat(texts.clone().map(|at| asked[at].clone()).collect(), 0),
        text_lengths: texts.map(|at| asked_lengths[at]).collect(),
        source: Tensor::cat(sources, 0),
        source_lengths,
        places: Places {
            text: asked[0].dims()[1],
            source: vec![frames; all.len()],
        },
    }
}

#[test]
fn golden_tmed_sampling() {
    let (Some(golden), Some(case)) = (
        Golden::find("tmed_denoiser"),
        Golden::find("tmed_diffusion"),
    ) else {
        return;
    };
    let network = network(&golden);
    let frames = golden.lengths("in.guide.target_mask");
    let condition = guided_condition(&golden, 2.0, 2.0);
    let (noise, trace) = (case.tensor::<3>("in.noise"), case.tensor::<3>("out.trace"));
    let count = trace.dims()[0];
    let trained = *step_counts(&case).last().expect("counts");
    let steps = SampleSteps::new(trained, count, Respacing::Official).expect("steps");
    // Compares the result of a step.
    let compare = |x: &Tensor<3>, step: usize| {
        let expected = floats(&trace.clone().narrow(0, step, 1));
        let difference = max_difference(&floats(x), &expected);
        assert!(difference <= 2e-3, "step {step}: {difference}");
    };
    let mut made = 0;
    let x = steps.sample(
        case.tensor("in.init"),
        |x, step| {
            if step.index + 1 < count {
                compare(x, count - 2 - step.index);
            }
            let all = branches(2.0, 2.0);
            let (timestep, pass) = (step.timestep, Pass::default());
            guided(&network, &all, &condition, x, &frames, timestep, &pass)
        },
        |step| {
            made += 1;
            noise.clone().narrow(0, count - 1 - step.index, 1)
        },
    );
    assert_eq!(made, count);
    compare(&x, count - 1);
    check(x, &case, "out.final_row3", 2e-3);
}

#[test]
fn golden_tmed_loss() {
    let Some(golden) = Golden::find("tmed_diffusion") else {
        return;
    };
    let (total, groups) = group_loss(
        golden.tensor("in.loss.output"),
        golden.tensor("in.loss.target"),
        &golden.lengths("in.loss.mask"),
    );
    check(total, &golden, "out.loss.total", 1e-5);
    check(groups, &golden, "out.loss.per_group", 1e-5);
}

#[test]
fn golden_tmed_features() {
    let golden = Golden::read("motionfix_features");
    let points = golden.points("in.joint_positions");
    let joints = points.as_chunks::<22>().0;
    let check_features = |features: &[FeatureFrame], name: &str| {
        let difference = max_difference(features.as_flattened(), &golden.f32s(name));
        assert!(difference <= 5e-6, "{name}: {difference}");
    };
    let mut features = features_of_poses(&recorded_poses(&golden), joints);
    check_features(&features, "out.features207");

    let names = [
        "body_transl_delta_pelv",
        "body_orient_xy",
        "z_orient_delta",
        "body_pose",
        "body_joints_local_wo_z_rot",
    ];
    let column = |of: &str| -> Vec<f32> {
        let groups = names.iter().zip(GROUPS);
        groups
            .flat_map(|(name, group)| {
                let values = golden.f32s(&format!("in.stats.{name}.{of}"));
                assert_eq!(values.len(), group.width, "{name}");
                values
            })
            .collect()
    };
    let statistics = FeatureStatistics {
        mean: column("mean"),
        std: column("std"),
    };
    statistics.normalize(&mut features);
    check_features(&features, "out.features207_norm");

    // The reference starts at the mean of the translations, with heading 0.
    statistics.restore(&mut features);
    let start = golden.points("in.stats.body_transl.mean")[0];
    let poses = poses_of_features(&features, DQuat::IDENTITY, start);
    let (expected, shape) = golden.values("out.recovered135");
    for (pose, row) in poses.iter().zip(expected.chunks_exact(shape[1])) {
        let apart = pose.transl - DVec3::from_slice(row);
        assert!(apart.abs().max_element() <= 5e-5, "{apart}");
        for (rotation, six) in pose.rotations.iter().zip(row[3..].chunks_exact(6)) {
            let six: [f64; 6] = std::array::from_fn(|index| six[index]);
            let wanted = DQuat::from_mat3(&from_six_d_rows(six));
            assert!(rotation.angle_between(wanted) <= 5e-4);
        }
    }
}

#[test]
fn golden_tmed_is_imported_as_an_editor() {
    let Some(golden) = Golden::find("tmed_denoiser") else {
        return;
    };
    let released = golden.weights("weights.");
    let released = SafeTensors::deserialize(&released).expect("a safetensors file");
    let mut tensors = released.tensors();
    for unused in ["feat_comb_coeff", "first_pose_proj.weight"] {
        assert!(tensors.iter().any(|(name, _)| name == unused), "{unused}");
    }
    let dir = tempfile::tempdir().expect("a folder");
    let run = dir.path().join("run");
    let device = Device::flex();
    let import = |tensors: &[(String, safetensors::tensor::TensorView<'_>)]| {
        let bytes = safetensors::serialize(tensors.iter().cloned(), None).expect("serialises");
        let statistics = FeatureStatistics {
            mean: vec![0.0; NUM_FEATURES],
            std: vec![1.0; NUM_FEATURES],
        };
        let text = frozen_text(golden.size("text_encoded_dim"));
        let (heads, path) = (golden.size("num_heads"), Path::new("last.ckpt"));
        import_tmed(&run, heads, (statistics, text), bytes, path, &device)
    };
    let lost = "pose_proj_out.bias";
    let fewer = tensors.iter().filter(|(name, _)| name != lost).cloned();
    let fewer: Vec<_> = fewer.collect();
    let error = import(&fewer).expect_err(lost).to_string();
    assert!(error.ends_with(&format!("{lost} is missing")), "{error}");
    let more = tensors[0].1.clone();
    tensors.push(("encoder.final_norm".to_owned(), more));
    refused(import(&tensors), "encoder.final_norm");
    tensors.pop();
    import(&tensors).expect("imported");

    let system = opened(&run, &EditConfig::default());
    assert_eq!(system.identity().name, "TMED");
    let official = TmedConfig::preset(Preset::Official);
    assert_eq!(system.guidance(), official.diffusion.guidance);
}

/// The expected number is the sum of the parameters of all layers.
#[test]
fn the_official_network_has_the_published_size() {
    use burn::module::Module;
    let config = TmedConfig::preset(Preset::Official).model;
    let network = Tmed::new(&config, 768, NUM_FEATURES, &Device::flex());
    assert_eq!(network.num_params(), 18_061_007);
}
