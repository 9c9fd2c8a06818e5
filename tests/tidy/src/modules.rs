//! The modules of a package, and which file's items a path means.

use std::collections::{BTreeMap, BTreeSet};

use crate::checkout::Checkout;
use crate::packages::{Package, folder, join};
use crate::scan::{Declaration, ModuleText, Scan};

/// Most steps from name to name through re-exports, so that a name that leads to itself ends.
const STEPS: usize = 8;

struct Module<'a> {
    file: String,
    text: &'a ModuleText,
    /// The module itself for the root of a target.
    parent: usize,
    root: usize,
    children: BTreeMap<String, usize>,
}

/// What a name means: an item, a module, both, or neither where it is of another crate.
#[derive(Default, Clone, Copy)]
struct Meaning {
    /// The module that defines the item.
    item: Option<usize>,
    module: Option<usize>,
}

/// A use of an item of one file in another file of the package.
pub(crate) struct Use {
    pub from: String,
    pub line: usize,
    pub to: String,
    pub path: String,
}

/// The modules of all targets of a package that are code.
pub(crate) struct Modules<'a> {
    package: &'a Package,
    modules: Vec<Module<'a>>,
    library: Option<usize>,
}

/// Returns the files that the targets of a package reach, with or without declarations under `#[cfg(test)]`.
pub(crate) fn reached(
    checkout: &Checkout,
    scans: &BTreeMap<String, Scan>,
    package: &Package,
    tests: Declarations,
) -> BTreeSet<String> {
    let mut reached = BTreeSet::new();
    let mut open: Vec<(String, String)> = package
        .roots()
        .map(|path| (path.to_owned(), folder(path).to_owned()))
        .collect();
    while let Some((file, place)) = open.pop() {
        if !reached.insert(file.clone()) {
            continue;
        }
        for (inline, text) in scans.get(&file).into_iter().flat_map(|scan| &scan.modules) {
            for declaration in &text.declarations {
                if !declaration.is_inline && (tests == Declarations::All || !declaration.is_test) {
                    open.extend(declared_file(
                        checkout,
                        &file,
                        &join(&place, &inline.join("/")),
                        declaration,
                    ));
                }
            }
        }
    }
    reached
}

/// Which `mod` declarations are followed.
#[derive(Clone, Copy, PartialEq, Eq)]
pub(crate) enum Declarations {
    All,
    Code,
}

/// Returns the file of a declaration and the folder of the modules declared in that file.
fn declared_file(
    checkout: &Checkout,
    file: &str,
    place: &str,
    declaration: &Declaration,
) -> Option<(String, String)> {
    let name = declaration.name.trim_start_matches("r#");
    if let Some(path) = &declaration.file {
        let path = join(folder(file), path);
        let below = folder(&path).to_owned();
        return checkout.sources.contains_key(&path).then_some((path, below));
    }
    let below = join(place, name);
    [format!("{below}.rs"), format!("{below}/mod.rs")]
        .into_iter()
        .find(|path| checkout.sources.contains_key(path))
        .map(|path| (path, below))
}

impl<'a> Modules<'a> {
    /// Reads the modules of a package.
    pub(crate) fn new(checkout: &Checkout, scans: &'a BTreeMap<String, Scan>, package: &'a Package) -> Self {
        let mut found = Self {
            package,
            modules: Vec::new(),
            library: None,
        };
        for path in package.roots() {
            let root = found.modules.len();
            if package.library.as_deref() == Some(path) {
                found.library = Some(root);
            }
            let place = Place {
                file: path.to_owned(),
                folder: folder(path).to_owned(),
                inline: Vec::new(),
            };
            found.add(checkout, scans, &place, root);
        }
        found
    }

    /// Adds a module and those below it, and returns its number.
    fn add(
        &mut self,
        checkout: &Checkout,
        scans: &'a BTreeMap<String, Scan>,
        place: &Place,
        parent: usize,
    ) -> Option<usize> {
        let text = scans.get(&place.file)?.modules.get(&place.inline)?;
        let number = self.modules.len();
        self.modules.push(Module {
            file: place.file.clone(),
            text,
            parent,
            root: if parent == number {
                number
            } else {
                self.modules[parent].root
            },
            children: BTreeMap::new(),
        });
        for declaration in text
            .declarations
            .iter()
            .filter(|declaration| !declaration.is_test)
        {
            if let Some(place) = place.declared(checkout, declaration)
                && let Some(child) = self.add(checkout, scans, &place, number)
            {
                self.modules[number]
                    .children
                    .insert(declaration.name.clone(), child);
            }
        }
        Some(number)
    }

    /// Returns every use of another file's items. A module that re-exports what is below it does not use it.
    pub(crate) fn uses(&self) -> Vec<Use> {
        let mut found = Vec::new();
        for (number, module) in self.modules.iter().enumerate() {
            for mention in &module.text.mentions {
                let target = self
                    .meaning(number, &mention.path, 0)
                    .and_then(|meaning| meaning.item);
                found.extend(self.between(number, target, &mention.path, mention.line));
            }
            for import in &module.text.imports {
                for target in self.imported(number, import) {
                    if !(import.public && self.is_below(target, number)) {
                        found.extend(self.between(number, Some(target), &import.path, import.line));
                    }
                }
            }
        }
        found
    }

    fn between(&self, number: usize, target: Option<usize>, path: &[String], line: usize) -> Option<Use> {
        let from = &self.modules[number].file;
        let to = &self.modules[target?].file;
        (from != to).then(|| Use {
            from: from.clone(),
            line,
            to: to.clone(),
            path: path.join("::"),
        })
    }

    /// Returns the modules that define the items which an import brings: one, or for `*` those of all words used.
    fn imported(&self, number: usize, import: &crate::paths::Import) -> Vec<usize> {
        let Some(meaning) = self.meaning(number, &import.path, 0) else {
            return Vec::new();
        };
        match (&import.name, meaning.module) {
            (None, Some(module)) => {
                let words = &self.modules[number].text.words;
                let items = words.iter().filter_map(|word| self.named(module, word, 0)?.item);
                items.collect::<BTreeSet<usize>>().into_iter().collect()
            }
            _ => meaning.item.into_iter().collect(),
        }
    }

    fn is_below(&self, module: usize, above: usize) -> bool {
        let mut at = module;
        while at != above && self.modules[at].parent != at {
            at = self.modules[at].parent;
        }
        at == above
    }

    /// Returns the meaning of a path in a module, or nothing if its first name is unknown there.
    fn meaning(&self, number: usize, path: &[String], step: usize) -> Option<Meaning> {
        let (first, rest) = path.split_first()?;
        let root = self.modules[number].root;
        let mut at = match first.as_str() {
            "crate" => root,
            "self" => number,
            "super" => self.modules[number].parent,
            name if *name == self.package.library_name() && self.library != Some(root) => self.library?,
            name => {
                let meaning = self.named(number, name, step)?;
                if rest.is_empty() {
                    return Some(meaning);
                }
                match meaning.module {
                    Some(module) => module,
                    None => return Some(meaning),
                }
            }
        };
        for (index, name) in rest.iter().enumerate() {
            if name == "super" {
                at = self.modules[at].parent;
                continue;
            }
            // What a macro generates is unknown: the path then means the module's own file.
            let meaning = self.named(at, name, step).unwrap_or(Meaning {
                item: Some(at),
                module: None,
            });
            if index + 1 == rest.len() {
                return Some(meaning);
            }
            match meaning.module {
                Some(module) => at = module,
                None => return Some(meaning),
            }
        }
        Some(Meaning {
            item: None,
            module: Some(at),
        })
    }

    /// Returns the meaning of a name in a module, or nothing if the module does not know it.
    fn named(&self, number: usize, name: &str, step: usize) -> Option<Meaning> {
        if step > STEPS {
            return None;
        }
        let module = &self.modules[number];
        let own = module.text.items.contains(name).then_some(number);
        let mut meaning = Meaning {
            item: own.or_else(|| self.exported_macro(number, name)),
            module: module.children.get(name).copied(),
        };
        let mut is_known = meaning.item.is_some() || meaning.module.is_some();
        let imports = &module.text.imports;
        for import in imports
            .iter()
            .filter(|import| import.name.as_deref() == Some(name))
        {
            is_known = true;
            let other = self.meaning(number, &import.path, step + 1).unwrap_or_default();
            meaning.item = meaning.item.or(other.item);
            meaning.module = meaning.module.or(other.module);
        }
        if is_known {
            return Some(meaning);
        }
        imports
            .iter()
            .filter(|import| import.name.is_none())
            .find_map(|import| {
                let module = self.meaning(number, &import.path, step + 1)?.module?;
                self.named(module, name, step + 1)
            })
    }

    /// Returns the module of a macro that the whole crate sees in a module, its root.
    fn exported_macro(&self, root: usize, name: &str) -> Option<usize> {
        self.modules
            .iter()
            .position(|module| module.root == root && module.text.exported_macros.contains(name))
    }
}

/// Where a module is written.
struct Place {
    file: String,
    /// The folder of the modules that the file declares.
    folder: String,
    /// The names of the modules in the file around it, none for the file itself.
    inline: Vec<String>,
}

impl Place {
    fn declared(&self, checkout: &Checkout, declaration: &Declaration) -> Option<Self> {
        if declaration.is_inline {
            let mut inline = self.inline.clone();
            inline.push(declaration.name.clone());
            return Some(Self {
                file: self.file.clone(),
                folder: self.folder.clone(),
                inline,
            });
        }
        let place = join(&self.folder, &self.inline.join("/"));
        let (file, folder) = declared_file(checkout, &self.file, &place, declaration)?;
        Some(Self {
            file,
            folder,
            inline: Vec::new(),
        })
    }
}
