//! File names made from ids.

use std::collections::BTreeSet;

/// Maximum bytes of a path component. File systems take 255; layouts add suffixes.
const MAX_NAME: usize = 200;

/// Whether [`safe_path`] shortens a component of an id. Its beginning is kept, followed by a hash of the whole
/// component, so that different names stay different.
pub(super) fn is_shortened(id: &str) -> bool {
    id.split('/').any(|part| part.len() > MAX_NAME)
}

fn shortened(part: String) -> String {
    if part.len() <= MAX_NAME {
        return part;
    }
    let hash = blake3::hash(part.as_bytes()).to_hex();
    let hash = &hash[..16];
    let begin = part.floor_char_boundary(MAX_NAME - hash.len() - 1);
    format!("{}~{hash}", &part[..begin])
}

/// A relative path for an id: characters that some file systems refuse become `_`, no component is empty or a dot path,
/// and long ones are shortened.
pub(super) fn safe_path(id: &str) -> String {
    let parts: Vec<String> = id
        .split('/')
        .map(|part| {
            let safe: String = part
                .chars()
                .map(|c| match c {
                    '\\' | ':' | '*' | '?' | '"' | '<' | '>' | '|' => '_',
                    c => c,
                })
                .collect();
            match safe.trim_matches(['.', ' ']) {
                "" => "_".to_owned(),
                _ => shortened(safe),
            }
        })
        .collect();
    parts.join("/")
}

/// [`safe_path`] of a name that is one component of a path, such as the id of an item or the name of a system.
pub(crate) fn safe_name(name: &str) -> String {
    safe_path(&name.replace('/', "_"))
}

/// [`safe_path`] of an id, without `ending`, which the file name gets anyway: `walk.bvh` is written to `walk.bvh`, not
/// to `walk.bvh.bvh`.
pub(super) fn safe_stem(id: &str, ending: &str) -> String {
    let split = id
        .len()
        .checked_sub(ending.len())
        .filter(|&at| id.is_char_boundary(at));
    let (stem, last) = split.map_or((id, ""), |at| id.split_at(at));
    let named = !stem.is_empty() && !stem.ends_with('/');
    safe_path(if named && last.eq_ignore_ascii_case(ending) {
        stem
    } else {
        id
    })
}

/// Appends a number to a path if it is taken; paths that differ only in case count as equal.
pub(super) fn unique(path: String, taken: &mut BTreeSet<String>) -> String {
    let mut candidate = path.clone();
    let mut number = 1;
    while !taken.insert(candidate.to_lowercase()) {
        number += 1;
        candidate = format!("{path}_{number}");
    }
    candidate
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn ids_become_paths_inside_the_folder() {
        for (id, path) in [
            ("a/b", "a/b"),
            ("../../etc/passwd", "_/_/etc/passwd"),
            ("robot.glb#Dance", "robot.glb#Dance"),
            ("a//b: c", "a/_/b_ c"),
            ("/x", "_/x"),
            ("c:\\x", "c__x"),
        ] {
            assert_eq!(safe_path(id), path);
        }
        let long = "é".repeat(125);
        let short = safe_path(&format!("a/{long}"));
        assert!(short.len() <= 2 + MAX_NAME, "{short}");
        assert!(short.starts_with("a/é"), "{short}");
        assert_ne!(short, safe_path(&format!("a/{long}x")));
        assert!(is_shortened(&long) && !is_shortened("a/b"));
        for (id, ending, stem) in [
            ("a/walk.BVH", ".bvh", "a/walk"),
            ("a/walk.glb", ".bvh", "a/walk.glb"),
            ("a/.bvh", ".bvh", "a/.bvh"),
            ("walk_stageii", "_stageii", "walk"),
            ("é", ".b", "é"),
        ] {
            assert_eq!(safe_stem(id, ending), stem);
        }
        let mut taken = BTreeSet::new();
        assert_eq!(unique("Walk".to_owned(), &mut taken), "Walk");
        assert_eq!(unique("walk".to_owned(), &mut taken), "walk_2");
    }
}
