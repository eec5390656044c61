//! The files of the page, as they lie in `web/` and `samples/`.

use std::sync::LazyLock;

use base64::Engine as _;
use base64::engine::general_purpose::URL_SAFE_NO_PAD;
use sha2::{Digest as _, Sha256};

pub(super) struct File {
    name: &'static str,
    pub bytes: &'static [u8],
}

macro_rules! files {
    ($folder:literal: $($name:literal),* $(,)?) => {
        [$(File { name: $name, bytes: include_bytes!(concat!("../../../../", $folder, "/", $name)) }),*]
    };
}

pub(super) static INDEX: File = File { name: "index.html", bytes: include_bytes!("../../../../web/index.html") };

static PAGE: [File; 20] = files!("web":
    "answer.js", "api.js", "camera.js", "camera-field.js", "elements.js", "geometry.js", "icon.svg", "images.js", "live.js", "main.js",
    "objects.js", "overlay.js", "pair.js", "picker.js", "reference.js", "relative-pose.js", "status.js", "style.css", "try.js",
    "words.js",
);

/// Images that the bundled networks answer right, and the camera that took them; two more with a known relative pose.
static SAMPLES: [File; 7] = files!("samples":
    "demo.camera.json", "poses.json", "sample-1.jpg", "sample-2.jpg", "pair/first.jpg", "pair/second.jpg", "pair/pair.json",
);

/// One for all files: a new version of one makes every copy old.
static TAG: LazyLock<String> = LazyLock::new(|| {
    let all = [&INDEX].into_iter().chain(&PAGE).chain(&SAMPLES);
    let sha256 = all.fold(Sha256::new(), |sum, file| sum.chain_update(file.bytes)).finalize();
    format!("\"{}\"", URL_SAFE_NO_PAD.encode(&sha256[..12]))
});

/// For `ETag` and `If-None-Match`.
pub(super) fn tag() -> &'static str {
    &TAG
}

/// The file at `/page/{path}`.
pub(super) fn file(path: &str) -> Option<&'static File> {
    let (files, name) = match path.strip_prefix("samples/") {
        Some(name) => (&SAMPLES[..], name),
        None => (&PAGE[..], path),
    };
    files.iter().find(|file| file.name == name)
}

impl File {
    pub(super) fn content_type(&self) -> &'static str {
        match self.name.rsplit('.').next() {
            Some("html") => "text/html; charset=utf-8",
            Some("js") => "text/javascript; charset=utf-8",
            Some("css") => "text/css; charset=utf-8",
            Some("svg") => "image/svg+xml",
            Some("jpg") => "image/jpeg",
            _ => "application/json",
        }
    }
}

#[cfg(test)]
mod tests {
    use std::collections::BTreeSet;
    use std::fs;
    use std::path::Path;

    use super::*;

    /// A file that is forgotten here would be missing in the browser.
    #[test]
    fn the_files_are_those_of_the_folder() {
        let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("web");
        let names = fs::read_dir(folder).unwrap().map(|entry| entry.unwrap().file_name().into_string().unwrap());
        let served = |name: &String| ["js", "css", "svg"].iter().any(|ending| name.ends_with(&format!(".{ending}")));
        let there: BTreeSet<String> = names.filter(served).collect();
        assert_eq!(PAGE.iter().map(|file| file.name.to_owned()).collect::<BTreeSet<_>>(), there);
    }

    #[test]
    fn all_of_it_is_small() {
        let bytes: usize = [&INDEX].into_iter().chain(&PAGE).chain(&SAMPLES).map(|file| file.bytes.len()).sum();
        assert!(bytes <= 300_000, "{bytes} bytes");
    }
}
