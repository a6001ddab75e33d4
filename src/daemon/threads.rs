//! What the kernel knows of this process's threads: scheduling, page faults, preemptions, time.
//!
//! Enters: `/proc/self/task`. Leaves: a report per thread. It must never run on the control thread, which therefore
//! pays nothing for it: the kernel counts anyway.

use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;
use std::path::Path;

/// A thread. Counts and times are since the loop's first tick, or the thread's start where that came later.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct ThreadReport {
    /// Name: `sinew-control`, `sinew-bus`, `sinew-io`; the main thread has the program's.
    pub name: String,
    /// Id.
    pub id: u32,
    /// `fifo 80`, `normal`.
    pub scheduling: String,
    /// Processors that it may run on.
    pub cpus: String,
    /// Time on a processor (s).
    pub run_s: f64,
    /// Time ready to run and waiting for a processor (s): other threads, or the host of a virtual machine, had it.
    pub wait_s: f64,
    /// Page faults served without the disk. The control thread has none while its memory is locked.
    pub faults_minor: u64,
    /// Page faults that waited for the disk.
    pub faults_major: u64,
    /// Times that it gave its processor up by itself: it slept or waited.
    pub switches_voluntary: u64,
    /// Times that its processor was taken from it.
    pub switches_involuntary: u64,
}

/// Counts of all threads at a time, by id.
#[derive(Debug, Clone, Default)]
pub(crate) struct Baseline(BTreeMap<u32, ThreadReport>);

impl Baseline {
    /// As of now.
    pub(crate) fn now() -> Self {
        Self(read().into_iter().map(|thread| (thread.id, thread)).collect())
    }

    /// All threads, what they did since, in the order of their start.
    pub(crate) fn since(&self) -> Vec<ThreadReport> {
        let mut threads = read();
        for thread in &mut threads {
            let Some(before) = self.0.get(&thread.id) else { continue };
            thread.run_s -= before.run_s;
            thread.wait_s -= before.wait_s;
            thread.faults_minor = thread.faults_minor.saturating_sub(before.faults_minor);
            thread.faults_major = thread.faults_major.saturating_sub(before.faults_major);
            thread.switches_voluntary = thread.switches_voluntary.saturating_sub(before.switches_voluntary);
            thread.switches_involuntary = thread.switches_involuntary.saturating_sub(before.switches_involuntary);
        }
        threads
    }
}

fn read() -> Vec<ThreadReport> {
    let Ok(tasks) = std::fs::read_dir("/proc/self/task") else { return Vec::new() };
    let mut threads: Vec<_> = tasks.flatten().filter_map(|task| read_one(&task.path())).collect();
    threads.sort_by_key(|thread| thread.id);
    threads
}

/// `None` for a thread that has just ended.
fn read_one(task: &Path) -> Option<ThreadReport> {
    let file = |name: &str| std::fs::read_to_string(task.join(name)).ok();
    let (stat, status) = (file("stat")?, file("status")?);
    // Behind the name, which may hold anything; proc(5) numbers the fields from 1, the name being the second.
    let (_, fields) = stat.rsplit_once(')')?;
    let fields: Vec<&str> = fields.split_whitespace().collect();
    let field = |number: usize| fields.get(number - 3).and_then(|text| text.parse::<u64>().ok());
    let line = |key: &str| status.lines().find_map(|line| line.strip_prefix(key)).map(str::trim);
    let count = |key: &str| line(key).and_then(|text| text.parse().ok());
    // Not every kernel keeps these: then the time is that of the clock's ticks, and there is no waiting.
    let times = file("schedstat").unwrap_or_default();
    let mut times = times.split_whitespace().map_while(|text| text.parse::<u64>().ok()).map(|ns| ns as f64 * 1e-9);
    let ticks_s = (field(14)? + field(15)?) as f64 * 1e-2;
    Some(ThreadReport {
        name: line("Name:")?.to_owned(),
        id: count("Pid:")? as u32,
        scheduling: match (field(41)?, field(40)?) {
            (1, priority) => format!("fifo {priority}"),
            (2, priority) => format!("round robin {priority}"),
            (0, _) => "normal".to_owned(),
            (policy, _) => format!("policy {policy}"),
        },
        cpus: line("Cpus_allowed_list:").unwrap_or_default().to_owned(),
        run_s: times.next().filter(|run| *run > 0.0).unwrap_or(ticks_s),
        wait_s: times.next().unwrap_or(0.0),
        faults_minor: field(10)?,
        faults_major: field(12)?,
        switches_voluntary: count("voluntary_ctxt_switches:")?,
        switches_involuntary: count("nonvoluntary_ctxt_switches:")?,
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::hint::black_box;
    use std::sync::mpsc;
    use std::time::Duration;

    #[test]
    fn page_faults_and_sleeps_are_counted_with_the_thread_that_has_them() {
        let (done, after) = mpsc::channel();
        let (go, gone) = mpsc::channel::<()>();
        let baseline = Baseline::now();
        let thread = std::thread::Builder::new().name("counted".into()).spawn(move || {
            // Larger than what the allocator keeps: fresh pages, each touched once.
            let mut pages = vec![0_u8; 8 << 20];
            pages.iter_mut().step_by(4096).for_each(|byte| *byte = 1);
            black_box(&pages);
            (0..20).for_each(|_| std::thread::sleep(Duration::from_micros(100)));
            done.send(()).unwrap();
            gone.recv().unwrap_err();
        });
        after.recv().unwrap();
        let threads = baseline.since();
        let counted = threads.iter().find(|t| t.name == "counted").unwrap();
        // Pages may come in larger pieces than the smallest.
        assert!(counted.faults_minor >= 4 && counted.switches_voluntary >= 20, "{counted:?}");
        assert!(counted.run_s > 0.0 && counted.scheduling == "normal" && !counted.cpus.is_empty(), "{counted:?}");
        drop(go);
        thread.unwrap().join().unwrap();
        assert!(!Baseline::now().since().iter().any(|t| t.name == "counted"), "an ended thread is not reported");
    }

    #[test]
    fn a_baseline_counts_from_its_time_on() {
        let before = Baseline::now();
        let own = std::fs::read_link("/proc/thread-self").unwrap();
        let id: u32 = own.file_name().unwrap().to_string_lossy().parse().unwrap();
        let mine = |threads: Vec<ThreadReport>| threads.into_iter().find(|t| t.id == id).unwrap();
        (0..10).for_each(|_| std::thread::sleep(Duration::from_micros(100)));
        let since_before = mine(before.since());
        let now = mine(Baseline::now().since());
        assert!(since_before.switches_voluntary >= 10, "{since_before:?}");
        assert!(now.switches_voluntary < since_before.switches_voluntary, "{now:?}");
    }
}
