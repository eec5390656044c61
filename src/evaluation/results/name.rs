use std::path::Path;

/// Name of a file of results as the BOP toolkit reads it, without its ending: `METHOD_DATASET-SPLIT`. Dataset and split are the
/// names of folders: `lmo/test`, or `lmo/test/000002` for a single scene. Underscores and hyphens within a name are left out,
/// because the toolkit takes the name apart at them.
#[must_use]
pub fn results_name(method: &str, split: &Path) -> String {
    // A path like "." has no names.
    let absolute = split.canonicalize().unwrap_or_else(|_| split.into());
    let names = absolute.iter().map(|name| name.to_string_lossy());
    let mut names: Vec<String> = names.map(|name| name.chars().filter(|c| c.is_alphanumeric()).collect()).collect();
    let scene = |name: &String| !name.is_empty() && name.chars().all(|c| c.is_ascii_digit());
    if names.last().is_some_and(scene) {
        names.pop();
    }
    let mut take = || names.pop().filter(|name| !name.is_empty());
    let split = take().unwrap_or_else(|| "test".into());
    let dataset = take().unwrap_or_else(|| "dataset".into());
    let method: String = method.chars().filter(|c| *c != '_').collect();
    format!("{method}_{dataset}-{split}")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_name_has_one_underscore_and_the_split_one_hyphen() {
        for (path, name) in [
            ("/data/lmo/test", "posed_lmo-test"),
            ("/data/lmo/test/000002", "posed_lmo-test"),
            ("/data/my_set/val-2", "posed_myset-val2"),
            ("/", "posed_dataset-test"),
        ] {
            assert_eq!(results_name("posed", Path::new(path)), name);
        }
        assert_eq!(results_name("posed_v2", Path::new("/a/b")), "posedv2_a-b");
    }
}
