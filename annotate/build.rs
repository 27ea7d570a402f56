//! Embeds the built front end, `web/dist`, as it is committed: `cargo build` needs no Node.

use std::fmt::Write as _;
use std::path::{Path, PathBuf};

fn main() {
    let root = PathBuf::from(std::env::var("CARGO_MANIFEST_DIR").expect("cargo sets the folder"));
    let dist = root.join("web").join("dist");
    println!("cargo::rerun-if-changed=web/dist");
    println!("cargo::rerun-if-changed=build.rs");
    let mut names = Vec::new();
    list(&dist, "", &mut names);
    names.sort();
    let mut code = "pub(super) static FILES: &[(&str, &[u8])] = &[\n".to_owned();
    for name in names {
        let path = dist.join(&name);
        writeln!(code, "    ({name:?}, include_bytes!({path:?})),").expect("text grows");
    }
    code += "];\n";
    let out = PathBuf::from(std::env::var("OUT_DIR").expect("cargo sets the folder"));
    std::fs::write(out.join("files.rs"), code).expect("the output folder takes a file");
}

/// Files under a folder, by their names relative to it; none where there is no folder.
fn list(folder: &Path, prefix: &str, names: &mut Vec<String>) {
    let Ok(entries) = std::fs::read_dir(folder) else {
        return;
    };
    for entry in entries.flatten() {
        let name = format!("{prefix}{}", entry.file_name().to_string_lossy());
        if entry.path().is_dir() {
            list(&entry.path(), &format!("{name}/"), names);
        } else {
            names.push(name);
        }
    }
}
