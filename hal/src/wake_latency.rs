//! How long a processor may take to leave its idle state, a wish of who must be on time.
//!
//! Enters: the longest time. Leaves: a [`WakeLatency`], the wish for as long as it lives, or the refusal and what mends it,
//! as [`crate::realtime`] reports it.
//! Must never: outlive its owner. That is why it is a request to the kernel that ends with its file, and not the setting
//! of one processor in sysfs (`pm_qos_resume_latency_us`), which stays behind when a process is killed.
//!
//! A thread with the highest priority still waits until its processor is awake: the deeper the idle state, the longer, up
//! to hundreds of microseconds. Linux lets any process bound that time with `/dev/cpu_dma_latency`: as long as the file is
//! open, no processor enters an idle state that takes longer to leave than the least of the numbers that all processes
//! wrote. Sources: the kernel's `Documentation/power/pm_qos_interface.rst` and `kernel/power/qos.c`. Zero leaves only
//! polling on most machines, which costs the power of a processor that works, on all of them. A machine whose idle states
//! are not the kernel's to choose (no driver in `/sys/devices/system/cpu/cpuidle`) grants the wish and changes nothing.

use std::fs::File;
use std::io::{self, Write as _};
use std::os::unix::fs::FileTypeExt as _;
use std::path::Path;
use std::time::Duration;

use crate::realtime::{Refused, Wish};

const FILE: &str = "/dev/cpu_dma_latency";

/// Bounds the wake-up latency of all processors until it is dropped.
#[derive(Debug)]
#[must_use = "the bound ends when this is dropped"]
pub struct WakeLatency {
    /// What the kernel ties the wish to.
    _file: File,
}

impl WakeLatency {
    /// Asks that no processor enters an idle state which takes longer to leave than this, rounded down to microseconds.
    /// Allocates; called once, before the first tick.
    ///
    /// # Errors
    /// [`Refused`]: no such file, no right to it, or not written.
    pub fn at_most(longest: Duration) -> Result<Self, Refused> {
        Self::ask(Path::new(FILE), longest)
    }

    fn ask(path: &Path, longest: Duration) -> Result<Self, Refused> {
        let ask = || {
            let mut file = File::options().write(true).open(path)?;
            // Whoever writes without looking leaves a plain file where a container has no device; it would take anything.
            if !file.metadata()?.file_type().is_char_device() {
                return Err(io::Error::from_raw_os_error(libc::ENODEV));
            }
            file.write_all(&whole_us(longest).to_ne_bytes())?;
            Ok(Self { _file: file })
        };
        ask().map_err(|error| refused(path, &error))
    }
}

/// As the kernel wants it: signed, in its own byte order; a negative number it would ignore without a word.
fn whole_us(time: Duration) -> i32 {
    i32::try_from(time.as_micros()).unwrap_or(i32::MAX)
}

fn refused(path: &Path, error: &io::Error) -> Refused {
    let path = path.display();
    let remedy = match error.raw_os_error() {
        Some(libc::EACCES) => format!(
            "{path} may not be written: run as root, or give it to a group of the user by a udev rule such as \
             `KERNEL==\"cpu_dma_latency\", GROUP=\"sinew\", MODE=\"0660\"`"
        ),
        Some(libc::EPERM) => format!(
            "{path} is not among the devices of this service or container: give it `DeviceAllow={path} rw`, or \
             `--device {path}`"
        ),
        Some(libc::ENOENT | libc::ENODEV | libc::ENXIO | libc::EISDIR) => format!(
            "{path} is no device here: the kernel has no CONFIG_CPU_IDLE, or the container was not given the device \
             (`--device {path}`); where it cannot be had, leave `wake_latency_s` out"
        ),
        _ => format!("{path} does not take it; where it cannot be had, leave `wake_latency_s` out"),
    };
    Refused { wish: Wish::WakeLatency, os_error: error.raw_os_error(), remedy }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The bound in force: the least of all that is asked for (us).
    fn in_force() -> i32 {
        i32::from_ne_bytes(std::fs::read(FILE).unwrap()[..].try_into().unwrap())
    }

    #[test]
    fn the_bound_holds_while_it_is_held_or_the_refusal_says_why() {
        const LONGEST: Duration = Duration::from_millis(5);
        // Root may have it where there is one; for others the file's rights decide.
        let available = File::options().write(true).open(FILE);
        match (available, WakeLatency::at_most(LONGEST)) {
            (Ok(_), Ok(held)) => {
                // Somebody else's may be stricter; without any it would be 2000 s.
                assert!((0..=5000).contains(&in_force()), "{}", in_force());
                drop(held);
            }
            (Err(error), Err(refused)) => {
                assert_eq!((refused.wish, refused.os_error), (Wish::WakeLatency, error.raw_os_error()));
                assert!(refused.to_string().contains(FILE), "{refused}");
            }
            other => panic!("{other:?}"),
        }
    }

    #[test]
    fn the_number_is_whole_microseconds_rounded_down_and_never_negative() {
        let times = [Duration::ZERO, Duration::from_nanos(50_999), Duration::MAX];
        assert_eq!(times.map(whole_us), [0, 50, i32::MAX]);
    }

    #[test]
    fn what_is_no_such_device_is_refused_with_the_remedy() {
        let folder = tempfile::tempdir().unwrap();
        let file = folder.path().join("plain");
        std::fs::write(&file, "").unwrap();
        for (path, error) in [
            (folder.path().join("missing"), libc::ENOENT),
            (folder.path().to_owned(), libc::EISDIR),
            (file.clone(), libc::ENODEV),
        ] {
            let refused = WakeLatency::ask(&path, Duration::ZERO).unwrap_err();
            assert_eq!((refused.wish, refused.os_error), (Wish::WakeLatency, Some(error)), "{refused}");
            let said = refused.to_string();
            assert!(
                said.starts_with("wake-up latency refused (") && said.contains("leave `wake_latency_s` out"),
                "{said}"
            );
            assert!(said.contains(&*path.to_string_lossy()), "{said}");
        }
        assert_eq!(std::fs::read(file).unwrap(), b"", "nothing was written into a plain file");
    }

    #[test]
    fn a_device_that_takes_no_number_is_refused() {
        let refused = WakeLatency::ask(Path::new("/dev/full"), Duration::ZERO).unwrap_err();
        assert_eq!(refused.os_error, Some(libc::ENOSPC));
        assert!(refused.remedy.contains("/dev/full does not take it"), "{refused}");
    }

    #[test]
    fn missing_rights_are_mended_by_a_rule_or_by_the_service() {
        let said = |number| refused(Path::new(FILE), &io::Error::from_raw_os_error(number)).to_string();
        let rule = r#"KERNEL=="cpu_dma_latency", GROUP="sinew", MODE="0660""#;
        assert!(said(libc::EACCES).contains("run as root") && said(libc::EACCES).contains(rule));
        assert!(said(libc::EPERM).contains("DeviceAllow=/dev/cpu_dma_latency rw"));
    }
}
