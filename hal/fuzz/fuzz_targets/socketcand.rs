//! Lines of a socketcand client.
#![no_main]

libfuzzer_sys::fuzz_target!(|line: &[u8]| sinew_hal::socketcand::fuzz_parse(line));
