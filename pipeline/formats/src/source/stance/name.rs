//! File numbers of the release and ids of HumanML3D.

use crate::source::names::is_number;

/// Clips of HumanML3D before mirroring. The release numbers a clip's mirrored copy this much
/// higher: its last file, 029231, is the copy of the last clip.
///
/// # Source
/// The id range of the release, compared with the 14,616 rows of HumanML3D's `index.csv`.
const NUM_ORIGINALS: u32 = 14_616;

/// The id of a motion by the name of its file or its key in a list. Leading zeros are optional; mirrored
/// copies are `M` and a number, or the release's higher number.
pub(crate) fn motion_id(name: &str) -> String {
    let (mirrored, digits) = match name.strip_prefix('M') {
        Some(rest) => (true, rest),
        None => (false, name),
    };
    match digits.parse::<u32>() {
        _ if !is_number(digits) => name.to_owned(),
        Ok(number) if mirrored => format!("M{number:06}"),
        Ok(number) if (NUM_ORIGINALS..2 * NUM_ORIGINALS).contains(&number) => {
            format!("M{:06}", number - NUM_ORIGINALS)
        }
        Ok(number) => format!("{number:06}"),
        Err(_) => name.to_owned(),
    }
}

/// The file name of an id in the release; `None` if no file name maps back to the id.
pub fn file_stem(id: &str) -> Option<String> {
    let stem = match id.strip_prefix('M') {
        Some(digits) => {
            let number = digits.parse::<u32>().ok()?.checked_add(NUM_ORIGINALS)?;
            format!("{number:06}")
        }
        None => {
            let _number: u32 = id.parse().ok()?;
            id.to_owned()
        }
    };
    (motion_id(&stem) == id).then_some(stem)
}

/// Lowest file number after those of the release, for motions outside HumanML3D.
pub const FIRST_FREE_NUMBER: u32 = 2 * NUM_ORIGINALS;

/// The id of the original of a mirrored copy; `None` for other ids.
pub(super) fn original_of(id: &str) -> Option<&str> {
    id.strip_prefix('M').filter(|digits| is_number(digits))
}

/// The name in a list of files: without folders and without the extension of a motion file.
pub(super) fn listed_name(text: &str) -> &str {
    let name = text.trim().rsplit(['/', '\\']).next().unwrap_or_default();
    [".pkl", ".npy", ".npz", ".txt"]
        .iter()
        .find_map(|extension| name.strip_suffix(extension))
        .unwrap_or(name)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn numbers_beyond_the_originals_are_mirrored_copies() {
        for (name, id, stem) in [
            ("000009", "000009", Some("000009")),
            ("9", "000009", Some("000009")),
            ("014615", "014615", Some("014615")),
            ("014616", "M000000", Some("014616")),
            ("029231", "M014615", Some("029231")),
            ("M000009", "M000009", Some("014625")),
            ("029232", "029232", Some("029232")),
            ("walking", "walking", None),
            ("M", "M", None),
        ] {
            assert_eq!(motion_id(name), id);
            assert_eq!(file_stem(id).as_deref(), stem, "{id}");
        }
        // An id equal to a mirrored copy's file number would be read back as another id.
        assert_eq!(file_stem("014700"), None);
        assert_eq!(file_stem("7"), None);
        assert_eq!(file_stem("M014616"), None);
        assert_eq!(original_of("M000009"), Some("000009"));
        assert_eq!(original_of("000009"), None);
    }

    #[test]
    fn names_in_lists_may_be_paths() {
        assert_eq!(listed_name(" style/000009_proud.pkl\n"), "000009_proud");
        assert_eq!(listed_name("000009"), "000009");
    }
}
