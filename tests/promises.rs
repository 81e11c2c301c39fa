//! Every test that docs/promises.md names exists where it says.
#![allow(clippy::unwrap_used, reason = "helpers of tests may unwrap, as tests may")]

use tendon_system_tests::repository;

/// A test that the page names: the file, and the function in it; none where the whole file is the test.
#[derive(Debug, PartialEq, Eq)]
struct Named {
    file: String,
    functions: Vec<String>,
}

/// The tests in the last column of each row of the page's tables: `` `file.rs`: `test`, `test`; `file.rs` ``.
fn named_tests(page: &str) -> Vec<Named> {
    let mut named: Vec<Named> = Vec::new();
    for line in page.lines().filter(|line| line.starts_with("| ") && !line.starts_with("| ---")) {
        let Some(tests) = line.trim_end_matches(['|', ' ']).rsplit(" | ").next() else { continue };
        // Between backticks: every second part.
        for name in tests.split('`').skip(1).step_by(2) {
            if name.ends_with(".rs") || name.ends_with(".py") {
                named.push(Named { file: name.to_owned(), functions: Vec::new() });
            } else if let Some(last) = named.last_mut() {
                last.functions.push(name.to_owned());
            }
        }
    }
    named
}

/// Whether the text of a file of Rust, or of Python's unittest, has a test of this name.
fn has_test(file: &str, text: &str, name: &str) -> bool {
    if file.ends_with(".py") {
        return name.starts_with("test_") && text.contains(&format!("    def {name}(self)"));
    }
    let function = format!("fn {name}(");
    let mut lines =
        text.lines().collect::<Vec<_>>().into_iter().rev().skip_while(|line| !line.contains(&function));
    // The attributes above it, and those of proptest.
    lines.next().is_some()
        && lines
            .take_while(|line| !line.trim().is_empty() && !line.trim_start().starts_with('}'))
            .any(|line| line.contains("#[test]"))
}

#[test]
fn every_test_that_a_promise_names_exists() {
    let page = std::fs::read_to_string(repository().join("docs/promises.md")).unwrap();
    let promises = page.lines().filter(|line| line.starts_with("| ")).count();
    let named = named_tests(&page);
    let functions: usize = named.iter().map(|named| named.functions.len()).sum();
    assert!(
        promises > 40 && functions > 40,
        "{promises} promises, {functions} tests: is it written otherwise?"
    );
    let mut missing = Vec::new();
    for Named { file, functions } in named {
        let Ok(text) = std::fs::read_to_string(repository().join(&file)) else {
            missing.push(file);
            continue;
        };
        missing.extend(
            functions
                .iter()
                .filter(|name| !has_test(&file, &text, name))
                .map(|name| format!("{file}: {name}")),
        );
    }
    assert!(missing.is_empty(), "docs/promises.md names tests that are not there: {missing:#?}");
}

#[test]
fn a_test_that_is_missing_is_noticed() {
    let page = "| Promise | Test |\n| --- | --- |\n| It `holds` | `a.rs`: `one`, `two` (ignored); `b.rs` |\n";
    let named = |file: &str, functions: &[&str]| Named {
        file: file.to_owned(),
        functions: functions.iter().map(|&name| name.to_owned()).collect(),
    };
    assert_eq!(named_tests(page), [named("a.rs", &["one", "two"]), named("b.rs", &[])]);
    let text = "#[test]\n#[ignore = \"long\"]\nfn one() {\n}\n\nfn two() {}\n";
    assert_eq!(["one", "two", "three"].map(|name| has_test("a.rs", text, name)), [true, false, false]);
    let text = "class A:\n    def test_one(self):\n        pass\n\n    def two(self):\n";
    assert_eq!(
        ["test_one", "two", "test_two"].map(|name| has_test("a.py", text, name)),
        [true, false, false]
    );
}
