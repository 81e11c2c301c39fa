//! An error says its cause once: a cause that `source()` gives, which `{:#}` prints after the error itself, must not
//! stand in the error's own text as well. Read from the source text, so that no kind of error is forgotten.
#![allow(clippy::unwrap_used, reason = "helpers of tests may unwrap, as tests may")]

use std::path::{Path, PathBuf};

use tendon_system_tests::repository;

/// All files of Rust below `folder`.
fn rust_files(folder: &Path, files: &mut Vec<PathBuf>) {
    for entry in std::fs::read_dir(folder).unwrap() {
        let path = entry.unwrap().path();
        if path.is_dir() {
            rust_files(&path, files);
        } else if path.extension().is_some_and(|extension| extension == "rs") {
            files.push(path);
        }
    }
}

/// Each `#[error(…)]` of a text, and what it stands above: a variant or a struct, up to the next one.
fn errors(text: &str) -> impl Iterator<Item = (&str, &str)> {
    text.split("#[error(").skip(1).filter_map(|rest| {
        let (message, body) = rest.split_once(")]\n")?;
        // The end of the enum or struct.
        Some((message, body.split("\n}\n").next().unwrap_or(body)))
    })
}

/// Whether the message prints what the body gives as the source.
fn says_its_source_twice(message: &str, body: &str) -> bool {
    let words = |name: &str| [format!("{{{name}}}"), format!("{{{name}:"), format!(".{name}")];
    let prints = |name: &str| words(name).iter().any(|word| message.contains(word.as_str()));
    let has_source_field = body.lines().any(|line| {
        let line = line.trim().trim_start_matches("pub ").trim_start_matches("pub(crate) ");
        line.starts_with("source:")
    });
    let is_marked = body.contains("#[from]") || body.contains("#[source]");
    (has_source_field && prints("source")) || (is_marked && (prints("0") || message.contains("{}")))
}

#[test]
fn no_error_says_its_cause_twice() {
    let mut files = Vec::new();
    for folder in ["shared", "services"] {
        rust_files(&repository().join(folder), &mut files);
    }
    let mut checked = 0;
    let mut twice = Vec::new();
    for file in files {
        let text = std::fs::read_to_string(&file).unwrap();
        for (message, body) in errors(&text) {
            checked += 1;
            if says_its_source_twice(message, body) {
                twice.push(format!("{}: {message}", file.display()));
            }
        }
    }
    assert!(checked > 100, "only {checked} errors found: has the way they are written changed?");
    assert!(twice.is_empty(), "name the field otherwise, or leave it out of the text: {twice:#?}");
}

#[test]
fn a_cause_that_is_said_twice_is_found() {
    for (text, expected) in [
        ("#[error(\"x: {source}\")]\nA {\n    source: io::Error,\n},\n}\n", true),
        ("#[error(\"{}: {source}\", path.display())]\nA {\n    pub source: io::Error,\n},\n}\n", true),
        ("#[error(\"x ({0})\")]\nA(#[from] io::Error),\n}\n", true),
        ("#[error(\"x ({0})\")]\nA(#[source] io::Error),\n}\n", true),
        ("#[error(\"x\")]\nA(#[from] io::Error),\n}\n", false),
        ("#[error(transparent)]\nA(#[from] io::Error),\n}\n", false),
        ("#[error(\"x: {reason}\")]\nA {\n    reason: io::Error,\n},\n}\n", false),
        ("#[error(\"x\")]\nA {\n    source: io::Error,\n},\n}\n", false),
    ] {
        let found: Vec<bool> =
            errors(text).map(|(message, body)| says_its_source_twice(message, body)).collect();
        assert_eq!(found, [expected], "{text}");
    }
}
