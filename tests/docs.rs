//! The pages that people read: their links resolve, and the options and settings they print exist.
#![allow(clippy::unwrap_used, reason = "helpers of tests may unwrap, as tests may")]

use std::collections::{BTreeMap, BTreeSet};
use std::path::{Path, PathBuf};
use std::process::Command;

use tendon_config::Config;
use tendon_system_tests::{program, repository};

/// All Markdown pages of the project, outside of build folders and data.
fn pages() -> Vec<PathBuf> {
    let root = repository();
    let folders = [root.clone(), root.join("docs"), root.join("docs/decisions"), root.join("models")];
    let files =
        folders.iter().flat_map(|folder| folder.read_dir().unwrap().map(|entry| entry.unwrap().path()));
    let mut pages: Vec<PathBuf> =
        files.filter(|path| path.extension().is_some_and(|extension| extension == "md")).collect();
    pages.sort();
    assert!(pages.len() > 20, "only {} pages found", pages.len());
    pages
}

/// Lines of a page, each with the language of the code block it is in: `sh`, another, empty; `None` outside of blocks.
fn lines(text: &str) -> impl Iterator<Item = (Option<&str>, &str)> {
    let mut language = None;
    text.lines().filter_map(move |line| {
        if let Some(opened) = line.trim_start().strip_prefix("```") {
            language = if language.is_some() { None } else { Some(opened.trim()) };
            return None;
        }
        Some((language, line))
    })
}

/// Targets of the links `[text](target)` in a page.
fn links(text: &str) -> Vec<String> {
    let prose = lines(text).filter(|(language, _)| language.is_none()).map(|(_, line)| line);
    prose
        .flat_map(|line| line.split("](").skip(1))
        .filter_map(|rest| rest.split_once(')').map(|(target, _)| target.to_owned()))
        .collect()
}

/// The anchors that GitHub makes of a page's headings.
fn anchors(text: &str) -> BTreeSet<String> {
    let headings = lines(text).filter(|(language, line)| language.is_none() && line.starts_with('#'));
    headings
        .map(|(_, line)| {
            let heading = line.trim_start_matches('#').trim().to_lowercase();
            let kept = heading.chars().filter(|&c| c.is_alphanumeric() || matches!(c, ' ' | '-' | '_'));
            kept.map(|c| if c == ' ' { '-' } else { c }).collect()
        })
        .collect()
}

/// Command lines of `tendon` in the shell blocks of a page, as words; continued lines are joined.
fn command_lines(text: &str) -> Vec<Vec<String>> {
    let mut found = Vec::new();
    let mut joined = String::new();
    for (_, line) in lines(text).filter(|(language, _)| *language == Some("sh")) {
        joined.push_str(line);
        if joined.ends_with('\\') {
            joined.pop();
            continue;
        }
        let line = std::mem::take(&mut joined);
        let line = line.split(" #").next().unwrap_or_default().trim();
        let line = line.strip_prefix("./").unwrap_or(line);
        let run = line.strip_prefix("scripts/run").map(|rest| format!("run{rest}"));
        if let Some(words) = run.or_else(|| line.strip_prefix("tendon ").map(str::to_owned)) {
            found.push(shell_words(&words));
        }
    }
    found
}

/// Words of a command line; quotes keep blanks together.
fn shell_words(line: &str) -> Vec<String> {
    let mut words = vec![String::new()];
    let mut quote = None;
    for c in line.chars() {
        match (quote, c) {
            (None, '"' | '\'') => quote = Some(c),
            (Some(open), _) if open == c => quote = None,
            (None, ' ') => words.push(String::new()),
            _ => words.last_mut().unwrap().push(c),
        }
    }
    words.retain(|word| !word.is_empty());
    words
}

fn help(command: &[String]) -> String {
    let output = Command::new(program("tendon")).args(command).arg("--help").output().unwrap();
    assert!(output.status.success(), "tendon {} --help fails", command.join(" "));
    String::from_utf8(output.stdout).unwrap()
}

#[test]
fn links_between_pages_resolve() {
    let mut broken = Vec::new();
    let mut checked = 0;
    for page in pages() {
        let text = std::fs::read_to_string(&page).unwrap();
        for link in links(&text) {
            if link.contains("://") {
                continue;
            }
            checked += 1;
            let (path, anchor) = link.split_once('#').unwrap_or((&link, ""));
            let target = if path.is_empty() { page.clone() } else { page.parent().unwrap().join(path) };
            let has_anchor = || {
                let text = std::fs::read_to_string(&target).unwrap_or_default();
                anchors(&text).contains(anchor)
            };
            if !target.exists() || (!anchor.is_empty() && !has_anchor()) {
                broken.push(format!("{}: {link}", page.display()));
            }
        }
    }
    assert!(checked > 50, "only {checked} links found");
    assert!(broken.is_empty(), "broken links:\n{}", broken.join("\n"));
}

#[test]
fn every_page_is_reached_from_the_readme() {
    let mut reached = BTreeSet::new();
    let mut open = vec![repository().join("README.md")];
    while let Some(page) = open.pop() {
        if !reached.insert(page.clone()) {
            continue;
        }
        let text = std::fs::read_to_string(&page).unwrap();
        let folder = page.parent().unwrap();
        let targets =
            links(&text).into_iter().map(|link| link.split('#').next().unwrap_or_default().to_owned());
        let linked = targets
            .filter(|path| path.ends_with(".md"))
            .filter_map(|path| folder.join(path).canonicalize().ok());
        open.extend(linked);
    }
    let docs = repository().join("docs");
    let lost: Vec<PathBuf> =
        pages().into_iter().filter(|page| page.starts_with(&docs) && !reached.contains(page)).collect();
    assert!(lost.is_empty(), "no link leads to {lost:?}");
}

#[test]
fn options_and_settings_on_the_pages_exist() {
    let mut helps: BTreeMap<Vec<String>, String> = BTreeMap::new();
    let mut wrong = Vec::new();
    let mut checked = 0;
    for page in pages() {
        let text = std::fs::read_to_string(&page).unwrap();
        for words in command_lines(&text) {
            let is_group = matches!(words[0].as_str(), "dataset" | "profile");
            let command = words[..if is_group { 2 } else { 1 }].to_vec();
            let help = helps.entry(command.clone()).or_insert_with(|| help(&command));
            let mut options = words.iter();
            while let Some(option) = options.next() {
                if !option.starts_with("--") {
                    continue;
                }
                checked += 1;
                let is_known = help.split_whitespace().any(|word| word.trim_end_matches(',') == option);
                let is_right = is_known && (option != "--set" || is_assignment(options.next()));
                if !is_right {
                    wrong.push(format!("{}: tendon {}: {option}", page.display(), words.join(" ")));
                }
            }
        }
    }
    assert!(checked > 30, "only {checked} options found");
    assert!(wrong.is_empty(), "not as the program has it:\n{}", wrong.join("\n"));
}

fn is_assignment(word: Option<&String>) -> bool {
    word.is_some_and(|word| Config::default().with(word).is_ok())
}

#[test]
fn the_front_door_stays_short() {
    for (page, most) in [("README.md", 150), ("ARCHITECTURE.md", 250)] {
        let lines = std::fs::read_to_string(repository().join(page)).unwrap().lines().count();
        assert!(lines <= most, "{page} has {lines} lines, more than {most}: move something to docs/");
    }
}

#[test]
fn the_checks_find_what_is_wrong() {
    let page = "# One two\n[a](x.md#y) [b](z.md)\n```sh\n[no](link)\ntendon run --set a=1 \\\n  --json 'a b' # why\n```\n";
    assert_eq!(links(page), ["x.md#y", "z.md"]);
    assert!(anchors(page).contains("one-two"));
    assert_eq!(command_lines(page), [["run", "--set", "a=1", "--json", "a b"].map(str::to_owned)]);
    assert!(!Path::new("docs").join("nowhere.md").exists());
}
