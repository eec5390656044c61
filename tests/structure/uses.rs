//! Which file uses what of which other file: each name is followed to where it is defined.

use std::collections::BTreeSet;
use std::path::PathBuf;

use super::tree::{ModuleId, Names, Tree};

/// Longest chain of re-exports; a longer one goes in a circle.
const MAX_CHAIN: usize = 16;

/// One name that a file takes from elsewhere.
#[derive(Debug, PartialEq, Eq, PartialOrd, Ord)]
pub(crate) struct Use {
    pub(crate) file: PathBuf,
    /// The file that defines the name; the crate's name where that is none of ours.
    pub(crate) of: PathBuf,
    pub(crate) name: String,
    /// The files whose modules the name was looked up in, down to the one that defines it.
    pub(crate) through: BTreeSet<PathBuf>,
}

/// What a path leads to.
enum Found {
    Module(ModuleId),
    /// Also of a module that has no such item: a macro may have made it.
    Item(ModuleId, String),
    /// An item of a crate that is not ours, or a name from the prelude.
    Foreign(String),
}

/// All uses of one file by another, and of other crates.
pub(crate) fn uses(tree: &Tree) -> BTreeSet<Use> {
    let mut uses = BTreeSet::new();
    for (id, module) in tree.modules.iter().enumerate() {
        let imports = module.imports.iter().filter(|import| !import.handed_on).map(|import| (&import.path, true));
        // A single name that leads nowhere is a variable, not a crate.
        let mentions = module.mentions.iter().map(|path| (path, path.len() > 1));
        for (path, may_be_foreign) in imports.chain(mentions) {
            let mut search = Search { tree, passed: Vec::new() };
            let file = module.file.clone();
            let passed =
                |search: Search<'_>| search.passed.into_iter().map(|id| tree.modules[id].file.clone()).collect();
            match search.find(id, path, MAX_CHAIN) {
                Some(Found::Item(owner, name)) if tree.modules[owner].file != file => {
                    let of = tree.modules[owner].file.clone();
                    uses.insert(Use { file, of, name, through: passed(search) });
                }
                Some(Found::Foreign(name)) if may_be_foreign => {
                    uses.insert(Use { file, of: name.clone().into(), name, through: passed(search) });
                }
                // What is used of a module is found where it is mentioned.
                Some(Found::Module(_) | Found::Item(..) | Found::Foreign(_)) | None => {}
            }
        }
    }
    uses
}

struct Search<'a> {
    tree: &'a Tree,
    passed: Vec<ModuleId>,
}

impl Search<'_> {
    /// Follows a path written in a module.
    fn find(&mut self, from: ModuleId, path: &Names, chain: usize) -> Option<Found> {
        let chain = chain.checked_sub(1)?;
        let (first, rest) = path.split_first()?;
        let here = self.step(from, first, rest.is_empty(), chain);
        let crate_root = || self.tree.crates.get(first).map(|root| Found::Module(*root));
        let mut found = here.or_else(crate_root).unwrap_or_else(|| Found::Foreign(first.clone()));
        for (place, name) in (1..).zip(rest) {
            // The rest of an item's path are its variants and methods.
            let Found::Module(module) = found else { break };
            self.passed.push(module);
            let last = place == rest.len();
            found = self.step(module, name, last, chain).unwrap_or_else(|| Found::Item(module, name.clone()));
        }
        if let Found::Item(owner, _) = &found {
            self.passed.push(*owner);
        }
        Some(found)
    }

    /// What a name means in a module. A module and a function may share one: the last name of a path means the function,
    /// those before it the module.
    fn step(&mut self, at: ModuleId, name: &str, last: bool, chain: usize) -> Option<Found> {
        let module = &self.tree.modules[at];
        let child = module.children.get(name).map(|child| Found::Module(*child));
        match name {
            "crate" => return Some(Found::Module(module.root)),
            "self" => return Some(Found::Module(at)),
            "super" => return module.parent.map(Found::Module),
            _ if !last && child.is_some() => return child,
            _ if module.items.contains(name) => return Some(Found::Item(at, name.to_owned())),
            _ => {}
        }
        let mut imported = module.imports.iter().filter(|import| import.name == name);
        imported.find_map(|import| self.find(at, &import.path, chain)).or(child)
    }
}
