//! What the control thread asks of the operating system, and what it was refused.
//!
//! Enters: a [`Request`]. Leaves: a [`Report`] with one entry for each wish that was not granted, why, and what mends it.
//! Nothing here fails by itself: a machine without privileges runs on, degraded, and says so once. Who cannot accept
//! that asks [`Report::require`].
//! Must never: change another thread, except that locking memory is by nature a matter of the whole process.
//!
//! One wish is not a thread's and lasts only as long as somebody holds it: [`crate::wake_latency`]. Its refusal goes into
//! the same report.

use std::fmt;
use std::io;

use rustix::mm::MlockAllFlags;
use rustix::process::Resource;
use rustix::thread::{CapabilitySet, CpuSet};
use thiserror::Error;

/// What a thread wants.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Request {
    /// SCHED_FIFO priority, 1 (lowest) to 99; `None` leaves the scheduling alone. Above 49 the thread also precedes the
    /// kernel's interrupt threads on PREEMPT_RT, the CAN driver's among them.
    pub priority: Option<u8>,
    /// Processors that the thread may run on; empty leaves them alone.
    pub cpus: Vec<usize>,
    /// Lock all memory of the process, present and future.
    pub lock_memory: bool,
    /// Stack to touch now, so that it does not fault in later (bytes); cut to what the thread has.
    pub prefault_stack: usize,
    /// Flush denormal numbers to zero, see [`flush_denormals`].
    pub flush_denormals: bool,
}

impl Default for Request {
    /// Priority 40 on any processor, memory locked, 256 KiB of stack touched, denormals flushed.
    fn default() -> Self {
        Self {
            priority: Some(40),
            cpus: Vec::new(),
            lock_memory: true,
            prefault_stack: 256 << 10,
            flush_denormals: true,
        }
    }
}

/// A wish.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub enum Wish {
    /// SCHED_FIFO.
    Priority,
    /// Processors.
    Affinity,
    /// Memory in RAM.
    LockedMemory,
    /// Denormal numbers as zero.
    FlushDenormals,
    /// Processors that wake up soon, [`crate::wake_latency`].
    WakeLatency,
}

/// A wish not granted.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Refused {
    /// Which.
    pub wish: Wish,
    /// Error number of the operating system, where it was the one to refuse.
    pub os_error: Option<i32>,
    /// What stands in the way and what mends it.
    pub remedy: String,
}

impl fmt::Display for Refused {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let wish = match self.wish {
            Wish::Priority => "real-time priority",
            Wish::Affinity => "processor affinity",
            Wish::LockedMemory => "locked memory",
            Wish::FlushDenormals => "flushing of denormal numbers",
            Wish::WakeLatency => "wake-up latency",
        };
        write!(f, "{wish} refused")?;
        if let Some(e) = self.os_error {
            write!(f, " ({})", io::Error::from_raw_os_error(e))?;
        }
        write!(f, ": {}", self.remedy)
    }
}

/// What a thread got.
#[derive(Debug, Clone, PartialEq, Eq, Default)]
pub struct Report {
    /// Wishes not granted; empty if all were.
    pub refused: Vec<Refused>,
    /// Stack touched (bytes).
    pub stack_touched: usize,
}

/// Real time was required and not granted.
#[derive(Debug, Clone, PartialEq, Eq, Error)]
#[error("real time is required, but: {}", .0.iter().map(ToString::to_string).collect::<Vec<_>>().join("; "))]
pub struct NotRealtime(pub Vec<Refused>);

impl Report {
    /// `Err` if anything was refused.
    ///
    /// # Errors
    /// [`NotRealtime`] with the refusals.
    pub fn require(self) -> Result<Self, NotRealtime> {
        if self.refused.is_empty() { Ok(self) } else { Err(NotRealtime(self.refused)) }
    }
}

/// Keeps the calling thread, and every thread that it starts from here on, away from a processor that another thread is
/// to have for itself; the processors that remain. Empty, and nothing changed, where it is the only one permitted, or the
/// operating system does not say. Allocates.
pub fn leave_processor(cpu: usize) -> Vec<usize> {
    let Ok(permitted) = rustix::thread::sched_getaffinity(None) else { return Vec::new() };
    let others: Vec<usize> = (0..CpuSet::MAX_CPU).filter(|&c| c != cpu && permitted.is_set(c)).collect();
    if others.is_empty() || pin(&others).is_err() { Vec::new() } else { others }
}

/// Applies a request to the calling thread. Allocates; called once, before the first tick.
pub fn enter(request: &Request) -> Report {
    let mut report = Report::default();
    let mut refuse = |wish, (os_error, remedy): (Option<i32>, String)| {
        report.refused.push(Refused { wish, os_error, remedy });
    };
    // Memory first: the stack touched below is then locked as well.
    if request.lock_memory
        && let Err(why) = lock_memory()
    {
        refuse(Wish::LockedMemory, why);
    }
    if !request.cpus.is_empty()
        && let Err(why) = pin(&request.cpus)
    {
        refuse(Wish::Affinity, why);
    }
    if let Some(priority) = request.priority
        && let Err(why) = set_fifo(priority)
    {
        refuse(Wish::Priority, why);
    }
    if request.flush_denormals && !flush_denormals() {
        refuse(Wish::FlushDenormals, (None, "not known for this processor (x86_64 and aarch64 only)".into()));
    }
    report.stack_touched = prefault_stack(request.prefault_stack);
    report
}

type Refusal = (Option<i32>, String);

fn set_fifo(priority: u8) -> Result<(), Refusal> {
    // SAFETY: sched_param is a plain C structure for which all zeros is a valid value.
    let mut parameters: libc::sched_param = unsafe { std::mem::zeroed() };
    parameters.sched_priority = libc::c_int::from(priority);
    // Processes and threads that this one starts do not inherit it.
    let policy = libc::SCHED_FIFO | libc::SCHED_RESET_ON_FORK;
    // SAFETY: thread 0 is the calling one, and the pointer is to a live structure.
    if unsafe { libc::sched_setscheduler(0, policy, &raw const parameters) } == 0 {
        return Ok(());
    }
    let e = last_error();
    Err((
        Some(e),
        if e == libc::EINVAL {
            format!("priority {priority} does not exist, expected 1 to 99")
        } else {
            format!(
                "the limit of real-time priorities is {} and {priority} was wanted: give the user `rtprio {priority}` in \
                 /etc/security/limits.d, the service `LimitRTPRIO={priority}`, or the program CAP_SYS_NICE",
                limit(Resource::Rtprio)
            )
        },
    ))
}

fn pin(cpus: &[usize]) -> Result<(), Refusal> {
    let mut set = CpuSet::new();
    for &cpu in cpus {
        if cpu >= CpuSet::MAX_CPU {
            return Err((None, format!("processor {cpu} does not exist")));
        }
        set.set(cpu);
    }
    rustix::thread::sched_setaffinity(None, &set).map_err(|e| {
        let available = std::thread::available_parallelism().map_or(0, usize::from);
        let text =
            format!("none of the processors {cpus:?} may be used; this process has {available} (see `taskset -p`)");
        (Some(e.raw_os_error()), text)
    })
}

fn lock_memory() -> Result<(), Refusal> {
    let refusal = |os_error: Option<i32>| {
        let text = format!(
            "the limit of locked memory is {} bytes: give the user `memlock unlimited` in /etc/security/limits.d, the \
             service `LimitMEMLOCK=infinity`, or the program CAP_IPC_LOCK",
            limit(Resource::Memlock)
        );
        (os_error, text)
    };
    // Under a limit the lock might still be granted for what there is now, and with it every later allocation beyond the
    // limit would fail: a process that ends in the middle of a motion for want of memory is worse than page faults.
    if rustix::process::getrlimit(Resource::Memlock).current.is_some() && !may_lock_without_limit() {
        return Err(refusal(None));
    }
    rustix::mm::mlockall(MlockAllFlags::CURRENT | MlockAllFlags::FUTURE).map_err(|e| refusal(Some(e.raw_os_error())))
}

/// Whether the thread has CAP_IPC_LOCK, to which the limit does not apply.
fn may_lock_without_limit() -> bool {
    rustix::thread::capabilities(None).is_ok_and(|sets| sets.effective.contains(CapabilitySet::IPC_LOCK))
}

/// The soft limit of a resource, in words.
fn limit(resource: Resource) -> String {
    rustix::process::getrlimit(resource).current.map_or_else(|| "unlimited".into(), |limit| limit.to_string())
}

fn last_error() -> i32 {
    io::Error::last_os_error().raw_os_error().unwrap_or(libc::EIO)
}

/// Sets the calling thread's processor to treat denormal numbers (below 2.2e-308) as zero, in operands and results;
/// false where that is not known. Filters that decay produce them, and they cost a hundred times a normal number's time.
///
/// On x86_64 these are FTZ and DAZ of MXCSR, on aarch64 FZ of FPCR, which covers both.
///
/// **What the language says.** Rust assumes the default floating-point environment, and its reference for `_mm_setcsr` calls
/// code that runs in another one undefined behaviour, by whatever means it was set; only floating-point operations inside
/// the same assembly block would be free of it. No Rust program can have this mode and keep to that letter. It is set
/// all the same, on the threads that ask for it and for their whole life, for what a tick may cost depends on it. What
/// is relied on is narrower: the compiler takes rounding and exceptions to be the defaults, which this does not change,
/// and may besides compute an operation itself, move it or leave it out as if denormals were kept. So wherever a number
/// is below 2.2e-308 either outcome, it or zero, must be right, also within one expression; no index, no length, no
/// branch of safety may depend on telling them apart. Ours do not: tolerances are many orders larger. The bits stay as
/// they are until the thread ends, and no code in between is written for another mode.
pub fn flush_denormals() -> bool {
    #[cfg(target_arch = "x86_64")]
    {
        const FTZ_AND_DAZ: u32 = 1 << 15 | 1 << 6;
        let mut mxcsr = 0_u32;
        // SAFETY: stores MXCSR to, and loads it from, a live u32; both bits exist on every x86_64 processor, so nothing
        // traps. That Rust code runs with them set is outside of what the language promises: see above for what is relied
        // on instead.
        unsafe {
            std::arch::asm!("stmxcsr [{}]", in(reg) &raw mut mxcsr, options(nostack, preserves_flags));
            mxcsr |= FTZ_AND_DAZ;
            std::arch::asm!("ldmxcsr [{}]", in(reg) &raw const mxcsr, options(nostack, preserves_flags, readonly));
        }
        true
    }
    #[cfg(target_arch = "aarch64")]
    {
        let mut fpcr: u64;
        // SAFETY: FPCR may be read and written at any privilege, and bit 24 exists on every aarch64 processor. That Rust
        // code runs with it set is outside of what the language promises: see above for what is relied on instead.
        unsafe {
            std::arch::asm!("mrs {}, fpcr", out(reg) fpcr, options(nomem, nostack, preserves_flags));
            fpcr |= 1 << 24;
            std::arch::asm!("msr fpcr, {}", in(reg) fpcr, options(nomem, nostack, preserves_flags));
        }
        true
    }
    #[cfg(not(any(target_arch = "x86_64", target_arch = "aarch64")))]
    false
}

/// Room left untouched at the stack's end: its guard page, and what a signal handler may need.
const STACK_RESERVE: usize = 64 << 10;
/// Stack touched in one call.
const CHUNK: usize = 16 << 10;

/// Touches the calling thread's stack below here, at most `bytes`; returns how much.
fn prefault_stack(bytes: usize) -> usize {
    let here = (&raw const bytes).addr();
    let Some(low) = stack_low() else { return 0 };
    let room = here.saturating_sub(low).saturating_sub(STACK_RESERVE);
    // Each call takes its chunk and a little for its own frame.
    let calls = bytes.min(room) / (CHUNK + 512);
    touch(calls);
    calls * CHUNK
}

#[inline(never)]
fn touch(calls: usize) {
    if calls == 0 {
        return;
    }
    let mut chunk = [0_u8; CHUNK];
    // The array and the writes to it must really be made.
    std::hint::black_box(&mut chunk);
    touch(calls - 1);
    std::hint::black_box(&mut chunk);
}

/// Lowest address of the calling thread's stack.
fn stack_low() -> Option<usize> {
    // SAFETY: pthread_attr_t is a plain C structure that the next call fills.
    let mut attributes: libc::pthread_attr_t = unsafe { std::mem::zeroed() };
    // SAFETY: the calling thread is alive and the pointer is to a live structure.
    if unsafe { libc::pthread_getattr_np(libc::pthread_self(), &raw mut attributes) } != 0 {
        return None;
    }
    let (mut low, mut size) = (std::ptr::null_mut(), 0);
    // SAFETY: attributes was filled above; the pointers are to live variables; destroyed once, here.
    let found = unsafe {
        let found = libc::pthread_attr_getstack(&raw const attributes, &raw mut low, &raw mut size) == 0;
        libc::pthread_attr_destroy(&raw mut attributes);
        found
    };
    found.then(|| low.addr())
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::hint::black_box;

    /// Runs on a thread of its own: what a test sets must not reach the others.
    fn alone<T: Send + 'static>(f: impl FnOnce() -> T + Send + 'static) -> T {
        std::thread::spawn(f).join().unwrap()
    }

    const NOTHING: Request =
        Request { priority: None, cpus: Vec::new(), lock_memory: false, prefault_stack: 0, flush_denormals: false };

    #[test]
    fn denormals_vanish_on_the_thread_that_asked_and_on_no_other() {
        let half = || black_box(f64::MIN_POSITIVE) / black_box(2.0);
        let as_operand = || black_box(f64::from_bits(1 << 40)) * black_box(1e300);
        alone(move || {
            assert!(half() > 0.0 && as_operand() > 0.0);
            assert!(flush_denormals());
            assert_eq!((half(), as_operand()), (0.0, 0.0));
            assert_eq!(black_box(f64::MIN_POSITIVE) * black_box(1.0), f64::MIN_POSITIVE, "normal numbers stay");
        });
        assert!(half() > 0.0);
    }

    #[test]
    fn impossible_wishes_are_reported_with_a_remedy_and_nothing_fails() {
        let report = alone(|| enter(&Request { priority: Some(100), cpus: vec![CpuSet::MAX_CPU - 1], ..NOTHING }));
        assert_eq!(report.refused.iter().map(|r| r.wish).collect::<Vec<_>>(), [Wish::Affinity, Wish::Priority]);
        assert_eq!(report.refused[1].os_error, Some(libc::EINVAL));
        assert!(report.refused[1].to_string().contains("expected 1 to 99"));
        assert!(report.refused[0].to_string().contains("none of the processors"));
        let error = report.require().unwrap_err().to_string();
        assert!(error.starts_with("real time is required, but: processor affinity refused"), "{error}");
    }

    #[test]
    fn a_processor_beyond_the_kernels_sets_is_reported() {
        let report = alone(|| enter(&Request { cpus: vec![usize::MAX], ..NOTHING }));
        assert_eq!((report.refused[0].wish, report.refused[0].os_error), (Wish::Affinity, None));
    }

    #[test]
    fn nothing_wanted_is_nothing_refused() {
        assert_eq!(alone(|| enter(&NOTHING)).require(), Ok(Report::default()));
    }

    #[test]
    fn a_thread_is_pinned_where_it_asked() {
        let allowed = rustix::thread::sched_getaffinity(None).unwrap();
        let cpu = (0..CpuSet::MAX_CPU).find(|&c| allowed.is_set(c)).unwrap();
        let (report, now) = alone(move || {
            let report = enter(&Request { cpus: vec![cpu], ..NOTHING });
            (report, rustix::thread::sched_getaffinity(None).unwrap())
        });
        assert_eq!(report.refused, []);
        assert_eq!((now.count(), now.is_set(cpu)), (1, true));
    }

    #[test]
    fn priority_is_granted_or_refused_with_the_limit_named() {
        let (report, policy) = alone(|| {
            let report = enter(&Request { priority: Some(1), ..NOTHING });
            // SAFETY: a query of the calling thread without pointers.
            (report, unsafe { libc::sched_getscheduler(0) } & !libc::SCHED_RESET_ON_FORK)
        });
        match report.refused.as_slice() {
            [] => assert_eq!(policy, libc::SCHED_FIFO),
            [refused] => {
                assert_eq!((refused.wish, policy), (Wish::Priority, libc::SCHED_OTHER));
                assert!(refused.remedy.contains("LimitRTPRIO=1"), "{refused}");
            }
            more => panic!("{more:?}"),
        }
    }

    #[test]
    fn the_stack_is_touched_but_never_beyond_its_end() {
        for stack in [256 << 10, 1 << 20, 8 << 20] {
            for wanted in [0, 1, 64 << 10, 512 << 10, usize::MAX / 2] {
                let touched = std::thread::Builder::new()
                    .stack_size(stack)
                    .spawn(move || prefault_stack(wanted))
                    .unwrap()
                    .join()
                    .unwrap();
                // The C library may reuse a larger stack than asked for; going beyond its end would end the test process.
                assert!(touched <= wanted);
                if wanted >= stack {
                    assert!(touched * 10 >= (stack - STACK_RESERVE) * 8, "{touched} of {stack}");
                }
            }
        }
    }
}
