//! The modules of crates, read from their files: what each defines, imports and mentions.

use std::collections::{BTreeMap, BTreeSet};
use std::fs;
use std::path::{Path, PathBuf};

use syn::buffer::{Cursor, TokenBuffer};
use syn::visit::{self, Visit};
use syn::{Attribute, Item, ItemMod, ItemUse, Macro, Meta, UseTree, VisRestricted, Visibility};

/// Place of a module in [`Tree::modules`].
pub(crate) type ModuleId = usize;

/// A path as it is written: `super`, `pose`, `Pose`.
pub(crate) type Names = Vec<String>;

/// A file, or an inline module of one.
pub(crate) struct Module {
    /// From the folder that the tree was read in.
    pub(crate) file: PathBuf,
    /// The root of its crate.
    pub(crate) root: ModuleId,
    pub(crate) parent: Option<ModuleId>,
    pub(crate) children: BTreeMap<String, ModuleId>,
    pub(crate) items: BTreeSet<String>,
    pub(crate) imports: Vec<Import>,
    /// Paths in the code itself.
    pub(crate) mentions: BTreeSet<Names>,
}

/// One name of a `use`.
pub(crate) struct Import {
    /// What it is called here; `_` for a trait whose methods alone are wanted.
    pub(crate) name: String,
    pub(crate) path: Names,
    /// `pub use`: handed on to others, and not by itself a use of the other file.
    pub(crate) handed_on: bool,
}

#[derive(Default)]
pub(crate) struct Tree {
    pub(crate) modules: Vec<Module>,
    /// The root of each crate, by the name that other crates call it.
    pub(crate) crates: BTreeMap<String, ModuleId>,
    /// Files of `#[cfg(test)]` modules: not read.
    pub(crate) tests: BTreeSet<PathBuf>,
}

impl Tree {
    /// Reads crates, each given by its name and the file that it starts from.
    pub(crate) fn read(folder: &Path, crates: &[(&str, &str)]) -> Self {
        let mut tree = Self::default();
        for (name, file) in crates {
            let root = tree.read_file(folder, Path::new(file), None);
            tree.crates.insert((*name).to_owned(), root);
        }
        tree
    }

    fn read_file(&mut self, folder: &Path, file: &Path, parent: Option<ModuleId>) -> ModuleId {
        let text = fs::read_to_string(folder.join(file)).unwrap();
        let parsed = syn::parse_file(&text).unwrap_or_else(|error| panic!("{}: {error}", file.display()));
        let module = self.add(file, parent);
        let stem = file.file_stem().unwrap();
        let beside = file.parent().unwrap();
        let below = if ["lib", "main", "mod"].iter().any(|name| stem == *name) { beside } else { &beside.join(stem) };
        Reader { tree: self, folder, module, below: below.into() }.visit_file(&parsed);
        module
    }

    fn add(&mut self, file: &Path, parent: Option<ModuleId>) -> ModuleId {
        let id = self.modules.len();
        self.modules.push(Module {
            file: file.into(),
            root: parent.map_or(id, |parent| self.modules[parent].root),
            parent,
            children: BTreeMap::new(),
            items: BTreeSet::new(),
            imports: Vec::new(),
            mentions: BTreeSet::new(),
        });
        id
    }
}

struct Reader<'a> {
    tree: &'a mut Tree,
    folder: &'a Path,
    module: ModuleId,
    /// Where the files of the module's children lie.
    below: PathBuf,
}

impl Reader<'_> {
    fn here(&mut self) -> &mut Module {
        &mut self.tree.modules[self.module]
    }

    /// The file of the child `mod name;`.
    fn file_of(&self, name: &str) -> PathBuf {
        let candidates = [self.below.join(format!("{name}.rs")), self.below.join(name).join("mod.rs")];
        let found = candidates.into_iter().find(|file| self.folder.join(file).is_file());
        found.unwrap_or_else(|| panic!("no file of the module '{name}' in {}", self.below.display()))
    }

    fn import(&mut self, tree: &UseTree, mut before: Names, handed_on: bool) {
        let (last, name) = match tree {
            UseTree::Path(path) => {
                before.push(path.ident.to_string());
                return self.import(&path.tree, before, handed_on);
            }
            UseTree::Group(group) => {
                return group.items.iter().for_each(|tree| self.import(tree, before.clone(), handed_on));
            }
            // Clippy's `wildcard_imports` and `enum_glob_use` keep them out of the code.
            UseTree::Glob(_) => panic!("{}: '*' does not say what it imports", self.here().file.display()),
            UseTree::Name(name) => (&name.ident, &name.ident),
            UseTree::Rename(name) => (&name.ident, &name.rename),
        };
        let mut name = name.to_string();
        if last != "self" {
            before.push(last.to_string());
        } else if name == "self" {
            name.clone_from(before.last().unwrap());
        }
        self.here().imports.push(Import { name, path: before, handed_on });
    }

    /// Paths among the tokens of a macro or an attribute. Single names are left out: most are arguments.
    fn tokens(&mut self, mut at: Cursor<'_>) {
        let mut path = Names::new();
        while !at.eof() {
            if let Some((name, rest)) = at.ident() {
                path.push(name.to_string());
                at = rest;
                if let Some(rest) = after_colon(rest).and_then(after_colon) {
                    at = rest;
                    continue;
                }
            } else if let Some((inside, _, _, rest)) = at.any_group() {
                self.tokens(inside);
                at = rest;
            } else if let Some((_, rest)) = at.token_tree() {
                at = rest;
            }
            if path.len() > 1 {
                self.here().mentions.insert(path.clone());
            }
            path.clear();
        }
    }
}

fn after_colon(at: Cursor<'_>) -> Option<Cursor<'_>> {
    at.punct().filter(|(punct, _)| punct.as_char() == ':').map(|(_, rest)| rest)
}

fn for_tests_only(attributes: &[Attribute]) -> bool {
    let is_test = |list: &syn::MetaList| list.path.is_ident("cfg") && list.tokens.to_string() == "test";
    attributes.iter().any(|attribute| attribute.meta.require_list().is_ok_and(is_test))
}

impl<'ast> Visit<'ast> for Reader<'_> {
    #[expect(clippy::wildcard_enum_match_arm, reason = "the rest defines no name here")]
    fn visit_item(&mut self, item: &'ast Item) {
        let name = match item {
            Item::Const(item) => Some(&item.ident),
            Item::Enum(item) => Some(&item.ident),
            Item::Fn(item) => Some(&item.sig.ident),
            Item::Static(item) => Some(&item.ident),
            Item::Struct(item) => Some(&item.ident),
            Item::Trait(item) => Some(&item.ident),
            Item::Type(item) => Some(&item.ident),
            Item::Union(item) => Some(&item.ident),
            _ => None,
        };
        if let Some(name) = name {
            self.here().items.insert(name.to_string());
        }
        visit::visit_item(self, item);
    }

    fn visit_item_mod(&mut self, item: &'ast ItemMod) {
        let name = item.ident.to_string();
        if for_tests_only(&item.attrs) {
            if item.content.is_none() {
                let file = self.file_of(&name);
                self.tree.tests.insert(file);
            }
            return;
        }
        let child = if let Some((_, items)) = &item.content {
            let file = self.here().file.clone();
            let child = self.tree.add(&file, Some(self.module));
            let below = self.below.join(&name);
            let mut inside = Reader { tree: self.tree, folder: self.folder, module: child, below };
            for item in items {
                inside.visit_item(item);
            }
            child
        } else {
            let file = self.file_of(&name);
            self.tree.read_file(self.folder, &file, Some(self.module))
        };
        self.here().children.insert(name, child);
    }

    fn visit_item_use(&mut self, item: &'ast ItemUse) {
        if !for_tests_only(&item.attrs) {
            self.import(&item.tree, Names::new(), !matches!(item.vis, Visibility::Inherited));
        }
    }

    fn visit_path(&mut self, path: &'ast syn::Path) {
        let names = path.segments.iter().map(|segment| segment.ident.to_string()).collect();
        self.here().mentions.insert(names);
        visit::visit_path(self, path);
    }

    fn visit_macro(&mut self, item: &'ast Macro) {
        self.visit_path(&item.path);
        self.tokens(TokenBuffer::new2(item.tokens.clone()).begin());
    }

    fn visit_attribute(&mut self, attribute: &'ast Attribute) {
        if let Meta::List(list) = &attribute.meta {
            self.tokens(TokenBuffer::new2(list.tokens.clone()).begin());
        }
    }

    /// `pub(in crate::server)` uses nothing.
    fn visit_vis_restricted(&mut self, _: &'ast VisRestricted) {}
}
