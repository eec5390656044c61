//! The checks, on small trees of which the answer is known.

use std::collections::BTreeSet;
use std::fs;

use crate::breaches;
use crate::circles::circles;
use crate::tree::Tree;
use crate::uses::{Use, uses};

/// The uses in a crate of these files.
fn uses_in(files: &[(&str, &str)]) -> BTreeSet<Use> {
    let folder = tempfile::tempdir().unwrap();
    for (file, text) in files {
        let path = folder.path().join(file);
        fs::create_dir_all(path.parent().unwrap()).unwrap();
        fs::write(path, text).unwrap();
    }
    uses(&Tree::read(folder.path(), &[("house", "lib.rs")]))
}

const LIB: &str = "mod shape; pub use shape::Circle;";
const SHAPE: &str = "mod circle; mod point; pub use circle::{Circle, circle}; pub use point::Point;";
const POINT: &str = "pub struct Point(pub f64, pub f64);";

#[test]
fn a_circle_through_a_re_export_is_found() {
    let found = circles(&uses_in(&[
        ("lib.rs", LIB),
        ("shape/mod.rs", SHAPE),
        ("shape/circle.rs", "use super::Point; pub struct Circle(Point, f64); pub fn circle() {}"),
        ("shape/point.rs", "pub struct Point; impl Point { fn around(self) { crate::shape::circle(); } }"),
    ]));
    let expected = "shape/circle.rs -> shape/point.rs -> shape/circle.rs\
                    \n    shape/circle.rs uses Point\n    shape/point.rs uses circle";
    assert_eq!(found, [expected]);
}

#[test]
fn arrows_that_run_one_way_are_no_circle() {
    let uses = uses_in(&[
        ("lib.rs", LIB),
        ("shape/mod.rs", SHAPE),
        ("shape/circle.rs", "use super::Point; pub struct Circle(Point, f64); pub fn circle() {}"),
        ("shape/point.rs", &format!("{POINT} #[cfg(test)] mod tests {{ use crate::Circle; }}")),
    ]);
    let arrows: Vec<_> = uses.iter().map(|one| [one.file.to_str(), one.of.to_str()].map(Option::unwrap)).collect();
    assert_eq!(arrows, [["shape/circle.rs", "shape/point.rs"]]);
    assert!(circles(&uses).is_empty());
}

#[test]
fn a_longer_circle_is_told_once() {
    let found = circles(&uses_in(&[
        ("lib.rs", "mod a; mod b; mod c;"),
        ("a.rs", "use crate::b; pub fn a() { b::b() }"),
        ("b.rs", "pub fn b() { println!(\"{}\", super::c::c()) }"),
        ("c.rs", "use crate::a::a as first; pub fn c() { first() }"),
    ]));
    assert_eq!(found.len(), 1, "{found:?}");
    assert!(found[0].starts_with("a.rs -> b.rs -> c.rs -> a.rs\n"), "{found:?}");
}

/// A `mod.rs` that hands on what its children define uses them only if it says so in its own code.
#[test]
fn a_parent_and_its_child_may_use_each_other_in_one_direction() {
    let parent = "mod child; pub use child::Child; pub const SIZE: usize = 3;";
    let child = ("child.rs", "pub struct Child([u8; super::SIZE]);");
    assert!(circles(&uses_in(&[("lib.rs", parent), child])).is_empty());
    let both = format!("{parent} pub struct Nest(Child);");
    assert_eq!(circles(&uses_in(&[("lib.rs", &both), child])).len(), 1);
}

#[test]
fn layers_are_kept_apart_and_foreign_crates_out() {
    let uses = uses_in(&[
        ("lib.rs", "mod base; mod high; mod low;"),
        ("base.rs", "pub struct Base;"),
        ("high.rs", "pub use crate::base::Base;"),
        ("low.rs", "use clap::Parser; fn up() { let image = 1; crate::high::Base; image }"),
    ]);
    let found = breaches(&uses, &[(&["low.rs"], &["clap", "high.rs", "image"])]);
    assert_eq!(found, ["low.rs uses Base of high.rs", "low.rs uses clap of clap"]);
    assert!(breaches(&uses, &[(&["low.rs"], &["tokio"]), (&["high.rs"], &["base.rs", "clap"])]).is_empty());
}
