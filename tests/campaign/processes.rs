//! What the processes of a trial do, told by the kernel.

use std::fmt::Write as _;
use std::path::PathBuf;

/// This process and all that it started, by their numbers.
pub fn family() -> Vec<u32> {
    let mut parents: Vec<(u32, u32)> = Vec::new();
    for entry in std::fs::read_dir("/proc").unwrap().flatten() {
        let Ok(pid) = entry.file_name().to_string_lossy().parse() else { continue };
        let status = std::fs::read_to_string(entry.path().join("status")).unwrap_or_default();
        let parent = status.lines().find_map(|line| line.strip_prefix("PPid:")?.trim().parse().ok());
        parents.extend(parent.map(|parent| (pid, parent)));
    }
    let mut found = vec![std::process::id()];
    let mut next = 0;
    while next < found.len() {
        let of = found[next];
        found.extend(parents.iter().filter(|(_, parent)| *parent == of).map(|(pid, _)| *pid));
        next += 1;
    }
    found
}

/// A process and where each of its threads waits in the kernel (by root).
pub fn whereabouts(pid: u32) -> std::io::Result<String> {
    let folder = PathBuf::from(format!("/proc/{pid}"));
    let words = std::fs::read_to_string(folder.join("cmdline"))?.replace('\0', " ");
    let mut text = format!("{pid}: {words}");
    for task in std::fs::read_dir(folder.join("task"))?.flatten() {
        let read = |name: &str| std::fs::read_to_string(task.path().join(name)).unwrap_or_default();
        let status = read("status");
        let state = status.lines().find_map(|line| line.strip_prefix("State:")).unwrap_or_default().trim();
        let stack: Vec<String> = read("stack").lines().take(3).map(|l| l.trim_start_matches("[<0>] ").into()).collect();
        let _ = write!(text, "\n  {} {state} {} {}", read("comm").trim(), read("wchan"), stack.join(" < "));
    }
    Ok(text)
}
