//! Conventions that a machine can watch over: imports, the home of unsafe, and the reference of configuration keys.

// A test that cannot go on fails; the exemption of the lints covers test functions, not their helpers.
#![allow(clippy::unwrap_used, clippy::expect_used)]

use sinew::config::schema::{Key, Presence, TableSpec};
use sinew::config::{SCENARIO, TABLES};
use std::collections::BTreeSet;
use std::fs;
use std::path::{Path, PathBuf};

/// The library's modules, lowest first: a module imports from itself and from those before it only.
const ORDER: &[&str] = &[
    "config",
    "math",
    "model",
    "integrator",
    "collision",
    "planner",
    "estimator",
    "posture",
    "report",
    "scenario",
    "control",
    "stability",
    "ipc",
    "recording",
    "daemon",
];

fn root() -> PathBuf {
    PathBuf::from(env!("CARGO_MANIFEST_DIR"))
}

fn rust_files(directory: &Path) -> Vec<PathBuf> {
    let Ok(entries) = fs::read_dir(directory) else { return Vec::new() };
    let mut files = Vec::new();
    for entry in entries {
        let path = entry.unwrap().path();
        if path.is_dir() {
            files.extend(rust_files(&path));
        } else if path.extension().is_some_and(|extension| extension == "rs") {
            files.push(path);
        }
    }
    files.sort();
    files
}

/// Code lines with their numbers; comments (and doc links in them) may name anything.
fn code_lines(text: &str) -> impl Iterator<Item = (usize, &str)> {
    text.lines().enumerate().map(|(i, line)| (i + 1, line.trim())).filter(|(_, line)| !line.starts_with("//"))
}

/// Code lines, with an import that runs over several of them in one piece.
fn statements(text: &str) -> Vec<(usize, String)> {
    let mut statements: Vec<(usize, String)> = Vec::new();
    let mut open = false;
    for (number, line) in code_lines(text) {
        match statements.last_mut().filter(|_| open) {
            Some((_, statement)) => statement.push_str(line),
            None => statements.push((number, line.to_owned())),
        }
        let starts = line.starts_with("use ") || (line.starts_with("pub") && line.contains(" use "));
        open = (open || starts) && !line.contains(';');
    }
    statements
}

/// Modules of `ORDER` that a line of code names through the crate's root.
fn modules_named(line: &str, climbs_to_root: &str) -> Vec<&'static str> {
    let mut named = Vec::new();
    for start in ["crate::", climbs_to_root] {
        for (at, _) in line.match_indices(start) {
            // `xcrate::` is another name; `super::super::` must not match inside a longer climb twice.
            if line[..at].ends_with(|c: char| c.is_alphanumeric() || c == '_') {
                continue;
            }
            let rest = &line[at + start.len()..];
            let paths: Vec<&str> = match rest.strip_prefix('{') {
                Some(group) => group.split([',', '}']).map(str::trim).collect(),
                None => vec![rest],
            };
            for path in paths {
                let head: String = path.chars().take_while(|c| c.is_alphanumeric() || *c == '_').collect();
                named.extend(ORDER.iter().copied().filter(|module| *module == head));
            }
        }
    }
    named
}

/// Imports in a module's file that point up the list.
fn upward_imports(module: &str, is_module_file: bool, text: &str) -> Vec<String> {
    let Some(own) = ORDER.iter().position(|name| *name == module) else { return Vec::new() };
    let climb = if is_module_file { "super::" } else { "super::super::" };
    let mut bad = Vec::new();
    for (number, statement) in statements(text) {
        for named in modules_named(&statement, climb) {
            if ORDER.iter().position(|name| *name == named).is_some_and(|other| other > own) {
                bad.push(format!("line {number}: {module} imports {named}"));
            }
        }
    }
    bad
}

#[test]
fn imports_in_src_point_one_way() {
    let src = root().join("src");
    let mut bad = Vec::new();
    for file in rust_files(&src) {
        let relative = file.strip_prefix(&src).unwrap();
        let first = relative.components().next().unwrap().as_os_str().to_string_lossy().into_owned();
        let module = first.trim_end_matches(".rs");
        assert!(
            ORDER.contains(&module) || ["lib", "main", "bin", "cli"].contains(&module),
            "src/{first} has no place in the order of imports"
        );
        let is_module_file = relative.components().count() == 1 || relative.ends_with("mod.rs");
        for import in upward_imports(module, is_module_file, &fs::read_to_string(&file).unwrap()) {
            bad.push(format!("{}: {import}", file.display()));
        }
    }
    assert!(bad.is_empty(), "{}", bad.join("\n"));
}

#[test]
fn the_test_of_imports_sees_imports_that_point_up() {
    for text in [
        "use crate::planner::Plan;",
        "    let x = crate::daemon::run();",
        "use crate::{config, planner};",
        "use super::super::planner;",
        "use crate::{\n    config::ArmConfig,\n    planner::Plan,\n};",
    ] {
        assert_eq!(upward_imports("model", false, text).len(), 1, "{text}");
    }
    for text in
        ["use crate::config::ArmConfig;", "// crate::planner uses this", "use mycrate::planner;", "use super::planner;"]
    {
        assert!(upward_imports("model", false, text).is_empty(), "{text}");
    }
    assert_eq!(upward_imports("model", true, "use super::planner;").len(), 1);
}

#[test]
fn nothing_in_src_and_hal_imports_what_stands_above() {
    for (directory, forbidden) in [("src", vec!["sim_plant::"]), ("hal", vec!["sim_plant::", "sinew::"])] {
        for file in rust_files(&root().join(directory)) {
            let text = fs::read_to_string(&file).unwrap();
            for (number, line) in code_lines(&text) {
                for name in &forbidden {
                    assert!(!line.contains(name), "{}:{number}: {line}", file.display());
                }
            }
        }
    }
    let dependencies = |manifest: &str| {
        let text = fs::read_to_string(root().join(manifest)).unwrap();
        let after = text.split("\n[dependencies]").nth(1).unwrap_or("").to_owned();
        after.split("\n[").next().unwrap_or("").to_owned()
    };
    for line in dependencies("hal/Cargo.toml").lines() {
        assert!(!line.starts_with("sinew") && !line.starts_with("sim_plant"), "hal depends on {line}");
    }
    for line in dependencies("Cargo.toml").lines() {
        assert!(!line.starts_with("sim_plant"), "the library depends on {line}");
    }
}

/// Lines of code that use the keyword.
fn unsafe_lines(text: &str) -> Vec<usize> {
    let keyword = "unsafe";
    let uses = |line: &str| {
        ["{", "fn ", "impl", "extern", "trait"].iter().any(|next| line.contains(&format!("{keyword} {next}")))
            || line.contains(&format!("#[{keyword}("))
    };
    code_lines(text).filter(|(_, line)| uses(line)).map(|(number, _)| number).collect()
}

#[test]
fn unsafe_lives_in_hal_only() {
    assert_eq!(unsafe_lines(&format!("// {0} {{\nlet x = {0} {{ y }};", "unsafe")), [2]);
    for directory in ["src", "sim_plant", "tests", "benches", "examples"] {
        for file in rust_files(&root().join(directory)) {
            let lines = unsafe_lines(&fs::read_to_string(&file).unwrap());
            assert!(lines.is_empty(), "{}: lines {lines:?}", file.display());
        }
    }
}

static SCENARIO_TABLES: &[&TableSpec] = &[&SCENARIO];

/// The tables of the reference, in its order; the plant's follows and is tested beside its type.
fn documented() -> Vec<(&'static str, &'static [&'static TableSpec])> {
    vec![("daemon", TABLES), ("scenario", SCENARIO_TABLES)]
}

/// Replaces what stands between a part's two marks.
fn with_part(page: &str, part: &str, content: &str) -> String {
    let (begin, end) = (format!("<!-- begin {part} -->\n"), format!("<!-- end {part} -->"));
    let (before, rest) = page.split_once(&begin).unwrap_or_else(|| panic!("the page lacks {begin}"));
    let (_, after) = rest.split_once(&end).unwrap_or_else(|| panic!("the page lacks {end}"));
    format!("{before}{begin}\n{content}{end}{after}")
}

/// `SINEW_WRITE_REFERENCE=1 cargo test --test tidy` rewrites the page after a key has changed.
#[test]
fn config_readme_documents_every_key_as_the_reader_has_it() {
    let path = root().join("config/README.md");
    let page = fs::read_to_string(&path).unwrap();
    let mut expected = page.clone();
    for (part, tables) in documented() {
        let content: String = tables.iter().map(|table| table.markdown()).collect();
        expected = with_part(&expected, part, &content);
    }
    if std::env::var_os("SINEW_WRITE_REFERENCE").is_some() {
        fs::write(&path, &expected).unwrap();
        return;
    }
    for (number, (found, wanted)) in page.lines().zip(expected.lines()).enumerate() {
        assert_eq!(found, wanted, "config/README.md:{}: differs from the registry", number + 1);
    }
    assert_eq!(page.lines().count(), expected.lines().count(), "config/README.md differs from the registry in length");
}

/// The same of the codes of faults, limits and alarms.
#[test]
fn the_codes_are_documented_as_the_program_has_them() {
    use sinew::control::{Class, Fault, Limit};
    use sinew::ipc::payload::AlarmCode;
    let path = root().join("docs/CODES.md");
    let page = fs::read_to_string(&path).unwrap();
    let mut faults = String::from("| code | class | what happened | what clears it |\n|---|---|---|---|\n");
    for fault in Fault::EXAMPLES {
        let class = match fault.class() {
            Class::Drives => "drives and buses",
            Class::Cables => "encoders and cables",
            Class::Estimate => "estimate",
            Class::Plan => "plan",
            Class::Time => "deadlines",
            Class::Motion => "motion",
        };
        faults += &format!("| {} | {class} | {} | {} |\n", fault.code(), fault.what(), fault.remedy());
    }
    let mut limits = String::from("| code | what acts |\n|---|---|\n");
    Limit::ALL.iter().for_each(|limit| limits += &format!("| {} | {} |\n", limit.code(), limit.text()));
    let mut alarms = String::from("| code | what is wrong |\n|---|---|\n");
    AlarmCode::ALL.iter().for_each(|alarm| alarms += &format!("| {} | {} |\n", alarm.wire(), alarm.text()));
    let mut expected = page.clone();
    for (part, content) in [("faults", faults), ("limits", limits), ("alarms", alarms)] {
        expected = with_part(&expected, part, &content);
    }
    if std::env::var_os("SINEW_WRITE_REFERENCE").is_some() {
        return fs::write(&path, &expected).unwrap();
    }
    assert_eq!(page, expected, "docs/CODES.md differs from the program");
}

#[test]
fn the_registry_is_in_order() {
    for table in documented().iter().flat_map(|(_, tables)| *tables) {
        let mut seen = BTreeSet::new();
        table.walk(&mut |spec: &'static TableSpec, key: &'static Key| {
            assert!(
                seen.insert((spec.header, key.name)) || spec.header.contains("swarm"),
                "{} {} twice",
                spec.header,
                key.name
            );
            assert!(
                key.meaning.ends_with('.') && !key.meaning.contains('|'),
                "{} {}: {}",
                spec.header,
                key.name,
                key.meaning
            );
            for (suffix, unit) in [
                ("_s", "s"),
                ("_m", "m"),
                ("_n", "N"),
                ("_rad", "rad"),
                ("_mps", "m/s"),
                ("_deg", "deg"),
                ("_nm", "N m"),
                ("_kg", "kg"),
            ] {
                if key.name.ends_with(suffix) {
                    assert_eq!(key.unit, unit, "{} {} is named for another unit", spec.header, key.name);
                }
            }
            if let Presence::Default(text) = key.presence {
                let parsed: Result<toml::Table, _> = format!("x = {text}").parse();
                assert!(parsed.is_ok(), "{} {}: its default is no TOML", spec.header, key.name);
            }
        });
    }
}

/// Names of the tests in a file: the function after each `#[test]`.
fn tests_in(file: &str) -> BTreeSet<String> {
    let text = fs::read_to_string(root().join(file)).unwrap();
    let name = |rest: &str| {
        let start = rest.find("fn ").unwrap() + 3;
        rest[start..].split('(').next().unwrap().to_owned()
    };
    // What is claimed of both layouts of frames is a list of names.
    let both = text.split("\nwith_both_layouts! {\n").nth(1).and_then(|list| list.split("\n}").next()).unwrap_or("");
    let listed = both.split_whitespace().map(str::to_owned);
    text.split("#[test]\n").skip(1).map(name).chain(listed).collect()
}

#[test]
fn every_row_of_the_wire_faults_is_a_test_and_every_such_test_a_row() {
    let table = fs::read_to_string(root().join("hal/FAULTS.md")).unwrap();
    let mut named = [BTreeSet::new(), BTreeSet::new()];
    for line in table.lines().filter(|line| line.starts_with('|') && !line.starts_with("|---")) {
        let last = line.trim_end_matches('|').rsplit('|').next().unwrap().trim();
        let name = |kind: &str| last.strip_prefix(kind).and_then(|n| n.strip_suffix('`')).map(str::to_owned);
        match (name("T `"), name("M `")) {
            (Some(test), _) => assert!(named[0].insert(test), "twice: {line}"),
            (_, Some(test)) => assert!(named[1].insert(test), "twice: {line}"),
            // The head of a table, and the measured figures.
            _ => assert!(["test", "with 1 % lost"].contains(&last) || last.contains(" / "), "no test: {line}"),
        }
    }
    assert!(named[0].len() > 30 && named[1].len() > 10);
    assert_eq!(named[0], tests_in("tests/wire_faults.rs"));
    assert_eq!(named[1], tests_in("sim_plant/tests/wire_faults.rs"));
}

#[test]
fn every_row_of_the_hazard_table_names_a_test_that_exists() {
    let text = fs::read_to_string(root().join("docs/SAFETY.md")).unwrap();
    let table = text.split("\n## Hazards").nth(1).unwrap().split("\n## ").next().unwrap();
    let rows: Vec<&str> = table.lines().filter(|l| l.starts_with("| ") && !l.starts_with("| hazard |")).collect();
    assert!(rows.len() > 15, "{}", rows.len());
    for row in rows {
        let cell = row.trim_end_matches('|').rsplit('|').next().unwrap().trim();
        let parts: Vec<&str> = cell.split('`').filter(|part| !part.trim().is_empty()).collect();
        let [file, test] = parts[..] else { panic!("no file and test: {row}") };
        assert!(tests_in(file).contains(test), "{file} has no test {test}: {row}");
    }
}
