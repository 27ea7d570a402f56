//! Dependencies: crates depend only on crates of lower layers, and imports inside a crate form no cycle.

use std::collections::{BTreeMap, BTreeSet};
use std::path::{Path, PathBuf};

use crate::util::{files_with_extension, stem_of, text_of};

/// The crates of the default build with their folders, the lowest first. Each may depend only on those before it.
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

/// Crates on which neither the trainer nor the annotation server may depend, and neither may their unit tests: a change
/// of a reader would compile those again.
const READERS: [&str; 3] = ["formats", "pipeline", "corpus"];

fn root() -> &'static Path {
    Path::new(env!("CARGO_MANIFEST_DIR"))
}

fn dependencies(folder: &str, section: &str) -> BTreeSet<String> {
    let manifest = text_of(root().join(folder).join("Cargo.toml"));
    let manifest: toml::Table = manifest.parse().expect("TOML");
    let found = manifest.get(section).and_then(toml::Value::as_table);
    let names = found.into_iter().flat_map(toml::Table::keys);
    names.cloned().collect()
}

#[test]
fn crates_depend_on_lower_ones_alone() {
    let mut below: BTreeSet<&str> = BTreeSet::new();
    let all: BTreeSet<&str> = FLOORS.iter().map(|(name, _)| *name).collect();
    for (name, folder) in FLOORS {
        let of_crate = dependencies(folder, "dependencies");
        let of_tests = dependencies(folder, "dev-dependencies");
        for needed in &of_crate {
            let is_lower = !all.contains(needed.as_str()) || below.contains(needed.as_str());
            assert!(is_lower, "{name} needs {needed}");
        }
        if ["train", "annotate"].contains(&name) {
            let mut reads = of_crate.union(&of_tests);
            let reads = reads.find(|needed| READERS.contains(&needed.as_str()));
            assert_eq!(reads, None, "{name} builds it");
        }
        below.insert(name);
    }
}

/// Path of a module in its crate.
type Module = Vec<String>;

/// The files of a crate, by their modules.
fn modules(folder: &Path) -> BTreeMap<Module, PathBuf> {
    let files = files_with_extension(folder, "rs").into_iter();
    let files = files.filter(|path| stem_of(path) != "tests");
    files
        .map(|path| {
            let inside = path.strip_prefix(folder).expect("inside");
            let inside = inside.with_extension("");
            let names = inside.iter();
            let names = names.map(|name| name.to_string_lossy().into_owned());
            let mut module: Module = names.collect();
            if ["lib", "mod"].contains(&&*stem_of(&path)) {
                module.pop();
            }
            (module, path)
        })
        .collect()
}

/// Finds the paths of a tree of imports, such as those of `a::{b, c::d}`.
fn paths(tree: &str, before: &Module, found: &mut Vec<Module>) {
    let mut depth = 0;
    let parts = tree.split(|c: char| {
        depth += i32::from(c == '{') - i32::from(c == '}');
        c == ',' && depth == 0
    });
    for part in parts.map(str::trim).filter(|part| !part.is_empty()) {
        let (path, group) = match part.split_once('{') {
            Some((path, group)) => (path, group.strip_suffix('}')),
            None => (part, None),
        };
        let mut whole = before.clone();
        let names = path.split(" as ").next().unwrap_or_default().split("::");
        let names = names.map(str::trim).filter(|name| !name.is_empty());
        whole.extend(names.map(str::to_owned));
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
        let mut house = Self {
            files: modules(folder),
            handed_on: BTreeMap::new(),
        };
        for (module, path) in &house.files {
            for (is_public, import) in imports(&text_of(path)) {
                if let Some(whole) = house.whole(module, &import).filter(|_| is_public) {
                    let name = whole.last().cloned().unwrap_or_default();
                    house.handed_on.insert((module.clone(), name), whole);
                }
            }
        }
        house
    }

    /// The path of an import from the root of the crate; `None` if it leads to another crate.
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
            let mut lengths = (0..=path.len()).rev();
            let deepest = lengths.find(|len| self.files.contains_key(&path[..*len]));
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
            for (is_public, import) in imports(&text_of(path)) {
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
        let mut in_circles: Vec<&Module> = edges.keys().collect();
        in_circles.retain(|module| reached(module, &edges).contains(module));
        assert!(in_circles.is_empty(), "circles of {name}: {in_circles:?}");
    }
    assert!(files > 500, "{files} files");
}
