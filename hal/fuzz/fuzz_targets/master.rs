//! Whole frames at a master that brings drives up, and at the decoder of their feedback.
#![no_main]

use sinew_hal::can::{CanBus, Frame, Id, Kind, Received};
use sinew_hal::canopen::NodeId;
use sinew_hal::cia402::{DriveSetup, Goal, Master, MasterConfig};
use sinew_hal::memory_bus::MemoryBus;

libfuzzer_sys::fuzz_target!(|bytes: &[u8]| {
    let node = |n| NodeId::new(n).unwrap();
    let drives = vec![DriveSetup::new(0, node(1)), DriveSetup::new(1, node(2))];
    let config = MasterConfig::new(drives, node(127), 10_000);
    // Nobody listens: what the master sends goes nowhere.
    let bus = || Box::new(MemoryBus::default()) as Box<dyn CanBus>;
    let mut master = Master::new(config, vec![bus(), bus()]).unwrap();
    let mut decoder = master.decoder();
    master.start(0);
    let mut now_ns = 0;
    let mut rest = bytes;
    // Three bytes of place, time and wish, two of identifier, one of length, the payload.
    while let [what, i0, i1, len, tail @ ..] = rest {
        let (data, next) = tail.split_at(usize::from(len % 9).min(tail.len()));
        let id = u16::from_le_bytes([*i0, *i1]) & 0x7ff;
        if let Ok(frame) = Frame::new(Id::Standard(id), Kind::Classic, data) {
            let received = Received { frame, time_ns: now_ns };
            let bus = usize::from(what & 3);
            if bus < 2 {
                master.on_frame(bus, &received, now_ns);
            }
            decoder.on_frame(bus, &received);
        }
        now_ns += u64::from(what >> 4) * 20_000_000;
        match what >> 2 & 3 {
            1 => master.set_goal(Goal::Enabled, now_ns),
            2 => master.reset_faults(now_ns),
            _ => {}
        }
        let progress = master.poll(now_ns);
        assert!(progress.ready + progress.starting + progress.failed == progress.drives);
        rest = next;
    }
});
