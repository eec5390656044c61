//! Files that use each other.

use std::collections::{BTreeMap, BTreeSet, VecDeque};
use std::fmt::Write as _;
use std::path::Path;

use super::uses::Use;

/// For each file those that it uses.
type Graph<'a> = BTreeMap<&'a Path, BTreeSet<&'a Path>>;

/// Each circle in words, with the names that close it; empty if all arrows run one way.
pub(crate) fn circles(uses: &BTreeSet<Use>) -> Vec<String> {
    let mut graph = Graph::new();
    for one in uses {
        graph.entry(&one.file).or_default().insert(&one.of);
    }
    let mut found = BTreeSet::new();
    for (from, to) in graph.iter().flat_map(|(from, all)| all.iter().map(move |to| (*from, *to))) {
        if let Some(mut circle) = shortest(&graph, to, from) {
            // One circle is found from each of its files: it is told from the first.
            let first = (0..circle.len()).min_by_key(|place| circle[*place]).unwrap_or(0);
            circle.rotate_left(first);
            found.insert(circle);
        }
    }
    found.iter().map(|circle| in_words(circle, uses)).collect()
}

/// The files on the shortest way, both ends among them.
fn shortest<'a>(graph: &Graph<'a>, from: &'a Path, to: &Path) -> Option<Vec<&'a Path>> {
    let mut ways = VecDeque::from([vec![from]]);
    let mut seen = BTreeSet::from([from]);
    while let Some(way) = ways.pop_front() {
        let last = *way.last()?;
        if last == to {
            return Some(way);
        }
        for next in graph.get(last).into_iter().flatten() {
            if seen.insert(*next) {
                ways.push_back([&way[..], &[*next]].concat());
            }
        }
    }
    None
}

fn in_words(circle: &[&Path], uses: &BTreeSet<Use>) -> String {
    let arrows: Vec<_> = circle.iter().zip(circle.iter().cycle().skip(1)).collect();
    let mut text = circle[0].display().to_string();
    for (_, to) in &arrows {
        let _ = write!(text, " -> {}", to.display());
    }
    for (from, to) in arrows {
        let names: BTreeSet<_> =
            uses.iter().filter(|one| one.file == **from && one.of == **to).map(|one| one.name.as_str()).collect();
        let names = names.into_iter().collect::<Vec<_>>().join(", ");
        let _ = write!(text, "\n    {} uses {names}", from.display());
    }
    text
}
