//! HumanML3D folders: 263-d vectors, joints, captions, split lists and the crop list, whole or in part.

mod array;
mod folder;
mod id;
mod index;
mod layout;
mod splits;
#[cfg(test)]
mod tests;

use clip::ReadClip;
use clip::check::FLAG_FPS_DOUBTFUL;
use datasets_spec::Skeleton;
use datasets_spec::record::HUMANML3D_WIDTH;
use kinematics::skeleton::NUM_BODY_JOINTS;
use pickle::npy::Header;

use array::{KIT_JOINTS, KIT_WIDTH};

use super::format::Format;
use super::up::Up;

pub(crate) use array::{FPS, check_length, in_single_precision};
pub use array::{features, joints, read_array};
pub(crate) use folder::add_captions;
pub use folder::{find, read_captions};
pub(crate) use id::clip_of;
pub use id::{is_id, mirrored_of};
pub use index::{IndexRow, parse_index};
pub(crate) use layout::{LISTS, List, SPLIT_LISTS, lists_above, parse_list};
pub use layout::{Layout, layouts};
pub(crate) use splits::Splits;

/// Recognises a motion in a single npy array by its shape; the error says why it is none.
fn recognise_array(head: &[u8]) -> Result<(), String> {
    let Ok(shape) = Header::peek_shape("array", head) else {
        // The reader reports what is wrong with it.
        return Ok(());
    };
    match shape[..] {
        [_, HUMANML3D_WIDTH | KIT_WIDTH] | [_, NUM_BODY_JOINTS | KIT_JOINTS, 3] => Ok(()),
        // Positions of a body with hands or a face, which the reader refuses by their number.
        [_, 23..=55, 3] => Ok(()),
        [_, 66] => Err(
            "npy array of 66 columns, which may be positions or rotations of 22 joints; save \
             positions as [frames, 22, 3]"
                .to_owned(),
        ),
        _ => Err(format!("npy array of shape {shape:?}, no motion")),
    }
}

/// Reads an array outside of a release. The 263 columns of a vector are those of HumanML3D, whose rate is 20 fps; arrays of
/// joints come from many programs.
fn read_lone(bytes: &[u8], skeleton: &Skeleton) -> ReadClip {
    let mut clip = read_array(bytes, skeleton)?;
    if clip.features.is_none() {
        clip.flags |= FLAG_FPS_DOUBTFUL;
        clip.notes
            .push("the array states no frame rate; read at that of HumanML3D, 20 fps".to_owned());
    }
    Ok(clip)
}

/// A HumanML3D folder: joints, 263-d vectors, captions and split lists.
// Bytes per second: the vectors in f4 at 20 fps.
pub const FORMAT: Format = Format {
    extensions: &["npy"],
    assumed_up: Some(Up::Y),
    by_name: |_, head| Some(recognise_array(head)),
    read: |_, _, bytes, options| read_lone(bytes, &options.skeleton).into(),
    find,
    ..Format::of_releases(
        "humanml3d",
        "a folder with new_joint_vecs or new_joints; a lone array of their shape; rotations from the vector, else \
         fitted",
        (size_of::<[f32; HUMANML3D_WIDTH]>() * 20) as f64,
    )
};
