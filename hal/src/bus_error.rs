//! SIGBUS in words: what the kernel sends to a process that writes to shared memory for which there is no room left, or
//! that somebody has cut short.
//!
//! It cannot be undone: the write has no place to go. What can be had is a last word and an exit code that means
//! something, in place of "Bus error".

use std::io;
use std::sync::atomic::{AtomicI32, Ordering};

/// Exit code of the last word.
static CODE: AtomicI32 = AtomicI32::new(2);

const LAST_WORD: &[u8] =
    b"sinew: shared memory (/dev/shm) is full, or a file in it was cut short by somebody; see `df /dev/shm`\n";

extern "C" fn last_word(_signal: libc::c_int) {
    // SAFETY: write and _exit are among the functions that a signal handler may call; the buffer is static.
    unsafe {
        libc::write(2, LAST_WORD.as_ptr().cast(), LAST_WORD.len());
        libc::_exit(CODE.load(Ordering::Relaxed));
    }
}

/// From here on SIGBUS ends the process with a line on standard error and this exit code.
///
/// # Errors
/// The handler could not be set.
pub fn say_and_exit(code: i32) -> io::Result<()> {
    CODE.store(code, Ordering::Relaxed);
    let handler: extern "C" fn(libc::c_int) = last_word;
    // SAFETY: all of sigaction is integers and a function pointer kept as an integer, for which zeros are valid.
    let mut action: libc::sigaction = unsafe { std::mem::zeroed() };
    action.sa_sigaction = handler as libc::sighandler_t;
    // SAFETY: the structure is initialised, lives through the call, and the handler is a function of the C ABI that calls
    // nothing that is not permitted in one.
    if unsafe { libc::sigaction(libc::SIGBUS, &action, std::ptr::null_mut()) } == 0 {
        Ok(())
    } else {
        Err(io::Error::last_os_error())
    }
}
