//! Dependencies: crates depend only on crates of lower layers, and imports inside a crate form no cycle.

use std::collections::{BTreeMap, BTreeSet};
use std::fs;
use std::path::{Path, PathBuf};

/// The crates of the default build with their folders, from the lowest to the highest. Each may depend on those before it.
const FLOORS: [(&str, &str); 18] = [
    ("kinematics", "datasets-spec/kinematics"),
    ("pickle", "pipeline/pickle"),
    ("kernels", "train/kernels"),
    ("datasets-spec", "datasets-spec"),
    ("remote-store", "datasets-spec/remote"),
    ("tables", "datasets-spec/tables"),
    ("work", "pipeline/work"),
    ("clip", "pipeline/clip"),
    ("features", "pipeline/features"),
    ("compose", "pipeline/compose"),
    ("annotate", "annotate"),
    ("train", "train"),
    ("eval", "eval"),
    ("formats", "pipeline/formats"),
    ("pipeline", "pipeline"),
    ("fuzz", "pipeline/fuzz"),
    ("corpus", "pipeline/corpus"),
    ("stance", "."),
];

/// Crates that neither the trainer nor the annotation server builds.
const READERS: [&str; 3] = ["formats", "pipeline", "corpus"];

fn root() -> &'static Path {
    Path::new(env!("CARGO_MANIFEST_DIR"))
}

fn dependencies(folder: &str) -> BTreeSet<String> {
    let text = fs::read_to_string(root().join(folder).join("Cargo.toml")).expect("a manifest");
    let manifest: toml::Table = text.parse().expect("TOML");
    let found = manifest.get("dependencies").and_then(toml::Value::as_table);
    found
        .into_iter()
        .flat_map(|table| table.keys().cloned())
        .collect()
}

#[test]
fn crates_depend_on_lower_ones_alone() {
    let mut below: BTreeSet<&str> = BTreeSet::new();
    let all: BTreeSet<&str> = FLOORS.iter().map(|(name, _)| *name).collect();
    for (name, folder) in FLOORS {
        for needed in dependencies(folder) {
            let is_ours = all.contains(needed.as_str());
            assert!(
                !is_ours || below.contains(needed.as_str()),
                "{name} needs {needed}"
            );
            let is_reader = READERS.contains(&needed.as_str());
            assert!(
                !is_reader || !["train", "annotate"].contains(&name),
                "{name} builds {needed}"
            );
        }
        below.insert(name);
    }
}

/// Path of a module in its crate.
type Module = Vec<String>;

/// Finds the files of a crate, by their modules.
fn modules(folder: &Path, at: &Module, found: &mut BTreeMap<Module, PathBuf>) {
    for entry in fs::read_dir(folder).expect("a folder") {
        let path = entry.expect("an entry").path();
        let stem = path
            .file_stem()
            .unwrap_or_default()
            .to_string_lossy()
            .into_owned();
        let child = [at.as_slice(), std::slice::from_ref(&stem)].concat();
        if path.is_dir() {
            modules(&path, &child, found);
        } else if path.extension().is_some_and(|extension| extension == "rs") && stem != "tests" {
            let is_own = ["lib", "mod"].contains(&stem.as_str());
            found.insert(if is_own { at.clone() } else { child }, path);
        }
    }
}

/// Finds the paths of a tree of imports, such as those of `a::{b, c::d}`.
fn paths(tree: &str, before: &Module, found: &mut Vec<Module>) {
    let (mut depth, mut start) = (0usize, 0);
    let mut parts = Vec::new();
    for (at, c) in tree.char_indices() {
        match c {
            '{' => depth += 1,
            '}' => depth -= 1,
            ',' if depth == 0 => {
                parts.push(&tree[start..at]);
                start = at + 1;
            }
            _ => {}
        }
    }
    parts.push(&tree[start..]);
    for part in parts
        .into_iter()
        .map(str::trim)
        .filter(|part| !part.is_empty())
    {
        let (path, group) = match part.split_once('{') {
            Some((path, group)) => (path, group.strip_suffix('}')),
            None => (part, None),
        };
        let mut whole = before.clone();
        let names = path.split(" as ").next().unwrap_or_default().split("::");
        whole.extend(
            names
                .map(|name| name.trim().to_owned())
                .filter(|name| !name.is_empty()),
        );
        match group {
            Some(group) => paths(group, &whole, found),
            None => found.push(whole),
        }
    }
}

/// The imports of a file outside of its tests: whether they are public, and their paths.
fn imports(text: &str) -> Vec<(bool, Module)> {
    let text = text.split("#[cfg(test)]\nmod ").next().unwrap_or_default();
    let mut found = Vec::new();
    for (at, _) in text.match_indices("use ") {
        let line = text[..at].rsplit('\n').next().unwrap_or_default();
        if !line.is_empty() && !line.starts_with("pub") {
            continue;
        }
        let tree = text[at + 4..].split(';').next().unwrap_or_default();
        let mut of_it = Vec::new();
        paths(&tree.replace('\n', " "), &Module::new(), &mut of_it);
        found.extend(of_it.into_iter().map(|path| (!line.is_empty(), path)));
    }
    found
}

/// A crate: its modules, and the names that they re-export from others.
struct House {
    files: BTreeMap<Module, PathBuf>,
    handed_on: BTreeMap<(Module, String), Module>,
}

impl House {
    fn open(folder: &Path) -> Self {
        let mut files = BTreeMap::new();
        modules(folder, &Module::new(), &mut files);
        let mut house = Self {
            files,
            handed_on: BTreeMap::new(),
        };
        for (module, path) in &house.files {
            for (is_public, import) in imports(&fs::read_to_string(path).expect("text")) {
                if let Some(whole) = house.whole(module, &import).filter(|_| is_public) {
                    let name = whole.last().cloned().unwrap_or_default();
                    house.handed_on.insert((module.clone(), name), whole);
                }
            }
        }
        house
    }

    /// The path from the root of the crate; none if it leads to another crate.
    fn whole(&self, module: &Module, import: &Module) -> Option<Module> {
        let mut at = match import.first()?.as_str() {
            "crate" => Module::new(),
            "self" => module.clone(),
            "super" => module[..module.len().checked_sub(1)?].to_vec(),
            child => {
                let inner = [module.as_slice(), &[child.to_owned()]].concat();
                self.files.contains_key(&inner).then_some(inner)?
            }
        };
        for name in &import[1..] {
            match name.as_str() {
                "super" => drop(at.pop()),
                "self" => {}
                name => at.push(name.to_owned()),
            }
        }
        Some(at)
    }

    /// The module that defines the item at a path.
    fn definer(&self, path: &Module) -> Module {
        let mut path = path.clone();
        loop {
            let deepest = (0..=path.len())
                .rev()
                .find(|len| self.files.contains_key(&path[..*len]));
            let deepest = deepest.expect("a crate has a root");
            let module = path[..deepest].to_vec();
            let Some(name) = path.get(deepest) else {
                return module;
            };
            match self.handed_on.get(&(module.clone(), name.clone())) {
                Some(other) => path = [other.as_slice(), &path[deepest + 1..]].concat(),
                None => return module,
            }
        }
    }

    /// Imports of each module from other modules. Re-exports do not count as imports.
    fn edges(&self) -> BTreeMap<Module, BTreeSet<Module>> {
        let mut edges: BTreeMap<Module, BTreeSet<Module>> = BTreeMap::new();
        for (module, path) in &self.files {
            let of_it = edges.entry(module.clone()).or_default();
            for (is_public, import) in imports(&fs::read_to_string(path).expect("text")) {
                if let Some(whole) = self.whole(module, &import).filter(|_| !is_public) {
                    of_it.insert(self.definer(&whole));
                }
            }
            of_it.remove(module);
        }
        edges
    }
}

/// All modules that a module imports, directly or indirectly.
fn reached<'a>(
    from: &'a Module,
    edges: &'a BTreeMap<Module, BTreeSet<Module>>,
) -> BTreeSet<&'a Module> {
    let (mut found, mut open) = (BTreeSet::new(), vec![from]);
    while let Some(module) = open.pop() {
        for next in edges.get(module).into_iter().flatten() {
            if found.insert(next) {
                open.push(next);
            }
        }
    }
    found
}

#[test]
fn no_imports_form_a_circle() {
    let mut files = 0;
    for (name, folder) in FLOORS {
        let house = House::open(&root().join(folder).join("src"));
        let edges = house.edges();
        files += house.files.len();
        let in_circles: Vec<String> = edges
            .keys()
            .filter(|module| reached(module, &edges).contains(module))
            .map(|module| module.join("::"))
            .collect();
        assert!(in_circles.is_empty(), "circles of {name}: {in_circles:?}");
    }
    assert!(files > 500, "{files} files");
}
