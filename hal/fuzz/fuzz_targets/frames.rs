//! Slots of the virtual bus and datagrams of the kernel's sockets: nothing, or a frame that encodes to what it was.
#![no_main]

libfuzzer_sys::fuzz_target!(|bytes: &[u8]| {
    sinew_hal::virtual_bus::fuzz_decode(bytes);
    sinew_hal::socketcan_bus::fuzz_decode(bytes);
});
