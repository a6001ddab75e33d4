//! Master and drives on buses in memory, in lockstep: the clock is a number.
#![allow(dead_code, clippy::unwrap_used, clippy::expect_used)] // each test binary uses its own part

use sim_plant::drive::objects::PRODUCT;
use sim_plant::drive::{Drive, DriveBank, Nameplate};
use sinew_hal::can::{CanBus, Frame, Id};
use sinew_hal::canopen::sdo_client::{Outcome, SdoClient};
use sinew_hal::canopen::{NmtCommand, NodeId};
use sinew_hal::cia402::script::{Step, script};
use sinew_hal::cia402::{
    CycleWriter, Decoder, DriveSetup, Event, Goal, Layout, Master, MasterConfig, ObjectWrite, Progress,
};
pub use sinew_hal::memory_bus::{MemoryBus, Refusal};
use std::time::Duration;

pub const MS: u64 = 1_000_000;

pub fn node(n: u8) -> NodeId {
    NodeId::new(n).unwrap()
}

/// Master, drives and the receive side on any number of buses.
pub struct Bench {
    pub now_ns: u64,
    pub master: Master,
    pub banks: Vec<(MemoryBus, DriveBank)>,
    pub receivers: Vec<MemoryBus>,
    pub decoder: Decoder,
    pub events: Vec<Event>,
    /// Every frame that was on a bus, with the bus.
    pub wire: Vec<(usize, Frame)>,
}

impl Bench {
    pub fn new(layout: Layout, buses: usize, per_bus: u8, adjust: impl FnOnce(&mut MasterConfig)) -> Self {
        let mut drives = Vec::new();
        for bus in 0..buses {
            for n in 1..=per_bus {
                let mut d = DriveSetup::new(bus, node(n));
                d.identity.product = Some(PRODUCT);
                d.rated_torque_mnm = Some(5000);
                d.writes = ObjectWrite::sinew_guard(30_000, 0, false).to_vec();
                drives.push(d);
            }
        }
        let mut config = MasterConfig::new(drives, node(127), 10_000);
        config.layouts = vec![layout; buses];
        adjust(&mut config);
        let wires: Vec<_> = (0..buses).map(|_| MemoryBus::default()).collect();
        let banks = wires
            .iter()
            .map(|w| {
                (
                    w.handle(),
                    DriveBank::new((1..=per_bus).map(|n| Drive::new(node(n), Nameplate::default(), 0)).collect()),
                )
            })
            .collect();
        let receivers = wires.iter().map(MemoryBus::handle).collect();
        let handles = wires.into_iter().map(|w| Box::new(w) as Box<dyn CanBus>).collect();
        let mut master = Master::new(config, handles).unwrap();
        let decoder = master.decoder();
        master.start(0);
        Self { now_ns: 0, master, banks, receivers, decoder, events: Vec::new(), wire: Vec::new() }
    }

    /// One millisecond.
    pub fn step(&mut self) -> Progress {
        self.now_ns += MS;
        let now = self.now_ns;
        let progress = self.master.pump(now);
        self.serve();
        progress
    }

    pub fn serve(&mut self) {
        let now = self.now_ns;
        for (bus, bank) in &mut self.banks {
            while !matches!(bank.pump(bus, Duration::ZERO, &mut || now), sim_plant::drive::Pumped::Idle) {}
        }
        for (i, r) in self.receivers.iter_mut().enumerate() {
            // Its time stays 0: the clock in which cycles begin is not this bench's number.
            while let Ok(Some(f)) = r.receive(Duration::ZERO) {
                self.wire.push((i, f.frame));
                self.events.push(self.decoder.on_frame(i, &f));
            }
        }
    }

    pub fn run_until(&mut self, ms: u64, mut done: impl FnMut(&Progress) -> bool) -> Progress {
        for _ in 0..ms {
            let p = self.step();
            if done(&p) {
                return p;
            }
        }
        panic!("not reached: {:?} {:?}", self.step(), self.master.take_faults());
    }

    pub fn enable(&mut self) {
        self.run_until(3000, |p| p.at_goal);
        self.master.set_goal(Goal::Enabled, self.now_ns);
        self.run_until(1000, |p| p.at_goal);
    }

    pub fn drive(&mut self, bus: usize, i: usize) -> &mut Drive {
        &mut self.banks[bus].1.drives_mut()[i]
    }

    /// A cycle of the control thread, then 10 ms in which everything else runs.
    pub fn cycle(&mut self, writer: &mut CycleWriter, torques: &[i16]) {
        let report = writer.write_cycle(torques);
        assert!(report.not_sent.is_empty() && report.sync_not_sent == 0, "{report:?}");
        self.serve();
        for _ in 0..10 {
            self.step();
        }
    }

    /// From now on the master's side of the bus does not take data frames with these identifiers.
    pub fn refuse(&mut self, bus: usize, which: Option<Refusal>) {
        self.banks[bus].0.refuse(which);
    }
}

/// Runs one SDO transfer against a drive.
pub fn transfer(d: &mut Drive, index: u16, sub: u8, write: Option<&[u8]>) -> Outcome {
    let mut client = SdoClient::new(MS);
    let mut next = Some(match write {
        Some(data) => client.download(index, sub, data, 0),
        None => client.upload(index, sub, 0),
    });
    while let Some(p) = next.take() {
        d.on_frame(&Frame::classic(Id::Standard(0x601), &p).unwrap(), 0);
        while let Some(f) = d.pop() {
            if f.id() == Id::Standard(0x581) {
                let (outcome, send) = client.on_response(f.data(), 0);
                if outcome != Outcome::Pending {
                    return outcome;
                }
                next = send;
            }
        }
    }
    Outcome::Pending
}

/// What the master writes to the first of so many drives of a bus, and NMT start.
pub fn configure(d: &mut Drive, layout: Layout, count: u8) {
    let drives = (1..=count).map(|n| DriveSetup::new(0, node(n))).collect();
    let config = MasterConfig { layouts: vec![layout], ..MasterConfig::new(drives, node(127), 10_000) };
    for step in script(&config, 0) {
        if let Step::Write { index, sub, data, .. } = step {
            assert_eq!(transfer(d, index, sub, Some(&data)), Outcome::Done(vec![]), "{index:04X}:{sub:02X}");
        }
    }
    d.on_frame(&NmtCommand::Start.encode(Some(node(1))), 0);
    while d.pop().is_some() {}
}
