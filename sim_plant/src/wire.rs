//! Faults on the wire by command: frames between controller and drives that are lost, late, doubled, out of order or
//! spoilt.
//!
//! Enters: texts such as `drop=0.01` or `delay:sync@4-4.05`. Leaves: the plans of the seeded shim in front of each bus,
//! period by period. It must never touch a frame before the first drive was enabled: time and chance both begin there, so
//! that a seed gives the same faults every time.

use sinew_hal::can::{Filter, FilterSet};
use sinew_hal::canopen::cob;
use sinew_hal::cia402::layout::PACKED_RPDO;
use sinew_hal::fault_shim::{Delay, FaultPlan};
use std::str::FromStr;
use std::time::Duration;

/// What is done to a frame.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum WireKind {
    /// It is lost.
    Drop,
    /// It comes so many periods late.
    Delay(u32),
    /// It comes twice.
    Duplicate,
    /// It changes places with the next one.
    Reorder,
    /// One bit of its payload is flipped behind the bus's own check sum, as by a broken node or gateway.
    Corrupt,
}

/// Which frames.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum WireFrames {
    /// All, both ways.
    All,
    /// NMT commands.
    Nmt,
    /// SYNC.
    Sync,
    /// Emergency objects of drives.
    Emcy,
    /// Torques and controlwords to the drives, whichever the layout; of one node, in the classic layout only.
    Rpdo,
    /// Feedback of the drives.
    Tpdo,
    /// SDO, both ways.
    Sdo,
    /// The master's heartbeat.
    Master,
    /// The drives' heartbeats and boot-ups.
    Heartbeat,
}

/// One fault.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct WireFault {
    /// What is done.
    pub kind: WireKind,
    /// To which frames.
    pub frames: WireFrames,
    /// Of which node only; `None`: of all.
    pub node: Option<u8>,
    /// Probability for each of them.
    pub probability: f64,
    /// From when on (s since the first drive was enabled).
    pub from_s: f64,
    /// Until when (s); infinite: to the end.
    pub to_s: f64,
}

const NAMES: [(&str, WireFrames); 9] = [
    ("all", WireFrames::All),
    ("nmt", WireFrames::Nmt),
    ("sync", WireFrames::Sync),
    ("emcy", WireFrames::Emcy),
    ("rpdo", WireFrames::Rpdo),
    ("tpdo", WireFrames::Tpdo),
    ("sdo", WireFrames::Sdo),
    ("master", WireFrames::Master),
    ("heartbeat", WireFrames::Heartbeat),
];

impl FromStr for WireFault {
    type Err = String;

    /// `KIND[:FRAMES[.NODE]][=PROBABILITY][@FROM[-TO]]`; KIND is `drop`, `delay` or `delayN` (N periods), `duplicate`,
    /// `reorder`, `corrupt`; FRAMES is `all`, `nmt`, `sync`, `emcy`, `rpdo`, `tpdo`, `sdo`, `master`, `heartbeat`.
    fn from_str(text: &str) -> Result<Self, String> {
        let usage = || {
            format!(
                "`{text}`: expected drop|delay[N]|duplicate|reorder|corrupt[:all|nmt|sync|emcy|rpdo|tpdo|sdo|master|\
                 heartbeat[.NODE]][=PROBABILITY][@FROM[-TO]], e.g. drop=0.01 or delay2:tpdo.5@4-4.5"
            )
        };
        let (text_of_what, window) = text.split_once('@').map_or((text, None), |(what, window)| (what, Some(window)));
        let (what, probability) = text_of_what.split_once('=').unwrap_or((text_of_what, "1"));
        let (kind, frames) = what.split_once(':').unwrap_or((what, "all"));
        let (frames, node) = frames.split_once('.').map_or((frames, None), |(frames, node)| (frames, Some(node)));
        let kind = match kind {
            "drop" => WireKind::Drop,
            "duplicate" => WireKind::Duplicate,
            "reorder" => WireKind::Reorder,
            "corrupt" => WireKind::Corrupt,
            "delay" => WireKind::Delay(1),
            other => match other.strip_prefix("delay").and_then(|n| n.parse().ok()) {
                Some(periods @ 1..=1000) => WireKind::Delay(periods),
                _ => return Err(usage()),
            },
        };
        let frames = NAMES.iter().find(|(name, _)| *name == frames).ok_or_else(usage)?.1;
        let node = match node.map(str::parse::<u8>) {
            None => None,
            Some(Ok(node @ 1..=127)) if !matches!(frames, WireFrames::Nmt | WireFrames::Sync | WireFrames::Master) => {
                Some(node)
            }
            _ => return Err(usage()),
        };
        let probability: f64 = probability.parse().map_err(|_| usage())?;
        let number = |text: &str| text.parse::<f64>().ok().filter(|t| t.is_finite() && *t >= 0.0).ok_or_else(usage);
        let (from_s, to_s) = match window.map(|w| w.split_once('-').map_or((w, None), |(f, t)| (f, Some(t)))) {
            None => (0.0, f64::INFINITY),
            Some((from, None)) => (number(from)?, f64::INFINITY),
            Some((from, Some(to))) => (number(from)?, number(to)?),
        };
        if !(0.0..=1.0).contains(&probability) || to_s <= from_s {
            return Err(usage());
        }
        Ok(Self { kind, frames, node, probability, from_s, to_s })
    }
}

impl WireFault {
    /// Whether it acts at a time (s since the first drive was enabled).
    fn acts_at(&self, time_s: f64) -> bool {
        // Half a nanosecond: times are sums of periods.
        (self.from_s..self.to_s).contains(&(time_s + 5e-10))
    }

    /// The identifiers of its frames; `drives` are the node ids that are drives. Empty: all.
    fn filters(&self, drives: &[u8]) -> Vec<Filter> {
        let one = |id: u16| Filter { value: u32::from(id), mask: 0x7ff };
        let nodes: Vec<u8> = match self.node {
            Some(node) => vec![node],
            None => (1..=127).collect(),
        };
        let of = |bases: &[u16]| nodes.iter().flat_map(|n| bases.iter().map(|b| one(b + u16::from(*n)))).collect();
        match self.frames {
            WireFrames::All if self.node.is_none() => Vec::new(),
            WireFrames::All => of(&[
                cob::EMCY,
                cob::TPDO,
                cob::TPDO + 0x100,
                cob::RPDO,
                cob::RPDO + 0x100,
                cob::SDO_REQUEST,
                cob::SDO_RESPONSE,
                cob::HEARTBEAT,
            ]),
            WireFrames::Nmt => vec![one(cob::NMT)],
            WireFrames::Sync => vec![one(cob::SYNC)],
            WireFrames::Emcy => of(&[cob::EMCY]),
            // Of all drives: the one that they share in the packed layout, too, which is none of a single drive.
            WireFrames::Rpdo if self.node.is_none() => [vec![one(PACKED_RPDO)], of(&[cob::RPDO])].concat(),
            WireFrames::Rpdo => of(&[cob::RPDO]),
            WireFrames::Tpdo => of(&[cob::TPDO]),
            WireFrames::Sdo => of(&[cob::SDO_REQUEST, cob::SDO_RESPONSE]),
            WireFrames::Heartbeat | WireFrames::Master => nodes
                .iter()
                .filter(|n| drives.contains(n) == (self.frames == WireFrames::Heartbeat))
                .map(|n| one(cob::HEARTBEAT + u16::from(*n)))
                .collect(),
        }
    }
}

/// The faults of a run, and which of them act now.
#[derive(Debug, Clone, Default)]
pub struct WireFaults {
    faults: Vec<WireFault>,
    acting: Vec<bool>,
}

impl WireFaults {
    /// These.
    pub fn new(faults: Vec<WireFault>) -> Self {
        Self { acting: vec![false; faults.len()], faults }
    }

    /// Whether a run has any.
    pub fn is_empty(&self) -> bool {
        self.faults.is_empty()
    }

    /// Moves on to a time (s since the first drive was enabled); true if other faults act than before.
    pub fn advance_to(&mut self, time_s: f64) -> bool {
        let mut changed = false;
        for (fault, acts) in self.faults.iter().zip(&mut self.acting) {
            changed |= std::mem::replace(acts, fault.acts_at(time_s)) != fault.acts_at(time_s);
        }
        changed
    }

    /// What the shim of a bus with drives of these node ids does now, either way: a plan per fault that acts.
    pub fn plans(&self, drives: &[u8], period: Duration) -> Vec<FaultPlan> {
        let acting = self.faults.iter().zip(&self.acting).filter(|(_, acts)| **acts);
        acting
            .map(|(fault, _)| {
                let mut plan = FaultPlan { ids: FilterSet::new(&fault.filters(drives)), ..FaultPlan::default() };
                let p = fault.probability;
                match fault.kind {
                    WireKind::Drop => plan.drop = p,
                    WireKind::Duplicate => plan.duplicate = p,
                    WireKind::Reorder => plan.reorder = p,
                    WireKind::Corrupt => plan.corrupt = p,
                    WireKind::Delay(periods) => {
                        (plan.delay, plan.delay_by) = (p, Delay::Time(periods * period));
                    }
                }
                plan
            })
            .collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use sinew_hal::can::Id;

    fn fault(text: &str) -> WireFault {
        text.parse().unwrap()
    }

    #[test]
    fn a_fault_is_read_as_it_is_written() {
        let all = WireFault {
            kind: WireKind::Drop,
            frames: WireFrames::All,
            node: None,
            probability: 0.01,
            from_s: 0.0,
            to_s: f64::INFINITY,
        };
        assert_eq!(fault("drop=0.01"), all);
        let late = WireFault {
            kind: WireKind::Delay(2),
            frames: WireFrames::Tpdo,
            node: Some(5),
            probability: 1.0,
            from_s: 4.0,
            to_s: 4.5,
        };
        assert_eq!(fault("delay2:tpdo.5@4-4.5"), late);
        assert_eq!(fault("corrupt:emcy=0.5@1").from_s, 1.0);
    }

    #[test]
    fn a_fault_that_makes_no_sense_is_refused_with_an_example() {
        for text in [
            "",
            "lose",
            "drop:",
            "drop:pdo",
            "drop:sync.3",
            "drop:tpdo.0",
            "drop:tpdo.128",
            "drop=2",
            "drop=nan",
            "drop@4-4",
            "drop@5-4",
            "drop@x",
            "delay0",
            "delayx",
            "drop@-1",
        ] {
            let refusal = text.parse::<WireFault>().unwrap_err();
            assert!(refusal.contains("delay2:tpdo.5@4-4.5"), "{text}: {refusal}");
        }
    }

    #[test]
    fn a_fault_hits_its_own_frames_only() {
        let hit = |text: &str| -> Vec<u16> {
            let mut faults = WireFaults::new(vec![fault(text)]);
            assert!(faults.advance_to(0.0));
            let plan = &faults.plans(&[1, 2], Duration::from_millis(10))[0];
            [0, 0x80, 0x81, 0x82, 0x181, 0x182, 0x200, 0x201, 0x202, 0x581, 0x601, 0x701, 0x702, 0x77f]
                .into_iter()
                .filter(|id| plan.ids.passes(Id::Standard(*id)))
                .collect()
        };
        assert_eq!(hit("drop").len(), 14);
        assert_eq!(hit("drop:nmt"), [0]);
        assert_eq!(hit("drop:sync"), [0x80]);
        assert_eq!(hit("drop:emcy"), [0x81, 0x82]);
        assert_eq!(hit("drop:tpdo.2"), [0x182]);
        assert_eq!(hit("drop:rpdo"), [0x200, 0x201, 0x202]);
        assert_eq!(hit("drop:rpdo.2"), [0x202]);
        assert_eq!(hit("drop:sdo"), [0x581, 0x601]);
        assert_eq!(hit("drop:heartbeat"), [0x701, 0x702]);
        assert_eq!(hit("drop:master"), [0x77f]);
        assert_eq!(hit("drop:all.1"), [0x81, 0x181, 0x201, 0x581, 0x601, 0x701]);
    }

    #[test]
    fn faults_act_in_their_windows() {
        let mut faults = WireFaults::new(vec![fault("drop:sync@0.03-0.05"), fault("drop=0.5")]);
        let mut acting = Vec::new();
        for k in 0..7 {
            faults.advance_to(0.01 * f64::from(k));
            acting.push(faults.plans(&[], Duration::ZERO).len());
        }
        assert_eq!(acting, [1, 1, 1, 2, 2, 1, 1]);
    }
}
