//! What can go wrong, as data: faults that change the mode, limits that act, and the latch that keeps the first cause.
//!
//! Nothing here formats: words are made elsewhere (`fault_words`).

use super::fault_parts::Class;

/// The machine must change its mode: tensions go to the safe value by ramp, drives are disabled, the cause is latched.
///
/// Codes are stable and below 64; a number once given is never reused.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Fault {
    /// A drive reports a fault.
    DriveFault {
        /// Cable (0-based).
        cable: u16,
        /// The drive layer's number for it.
        cause: u32,
    },
    /// The drives left torque operation without being told to and without naming a fault.
    DrivesLost,
    /// The drives did not come up in time.
    DrivesNotUp {
        /// Time waited (s).
        after_s: f64,
    },
    /// A bus does not answer.
    BusLost {
        /// Bus (0-based).
        bus: u16,
    },
    /// A drive measures another tension than it was told.
    TensionError {
        /// Cable (0-based).
        cable: u16,
        /// Measured beyond commanded (N).
        error_n: f64,
    },
    /// An emergency stop outside of the controller is pressed.
    EmergencyStop {
        /// Cable whose drive has the input (0-based), [`Fault::SERVICE`] for the operator's.
        source: u16,
    },
    /// No reading of an encoder for too long.
    EncoderSilent {
        /// Cable (0-based).
        cable: u16,
        /// Age of its last reading (s); infinite if there was none.
        age_s: f64,
    },
    /// A reading differs from the one before by more than a cable can move.
    EncoderJump {
        /// Cable (0-based).
        cable: u16,
        /// Difference (m); NaN where the reading was not a number.
        step_m: f64,
    },
    /// A reading stays exactly the same while the model moves its cable.
    EncoderStuck {
        /// Cable (0-based).
        cable: u16,
        /// Motion of the model's cable meanwhile (m).
        motion_m: f64,
    },
    /// What an encoder shows does not fit the other cables of its segment.
    CableLength {
        /// Cable (0-based).
        cable: u16,
        /// Shown beyond the others (m).
        error_m: f64,
        /// Motion shown over the one that the others tell; NaN where none is known.
        factor: f64,
        /// Another cable of the segment would explain it as well.
        unsure: bool,
    },
    /// A cable does not pull what its drive was told, by what the arm does.
    CablePull {
        /// Cable (0-based).
        cable: u16,
        /// Pull over the one commanded.
        factor: f64,
    },
    /// Model and measurement differ by more than the bound.
    InnovationBound {
        /// Largest |z| (rad).
        innovation_rad: f64,
    },
    /// The difference of model and measurement grows.
    InnovationGrowth {
        /// Growth within the window (rad).
        growth_rad: f64,
    },
    /// The observer did not settle in time.
    NotSettled {
        /// Time waited (s).
        after_s: f64,
    },
    /// The observer found no start from the measured lengths.
    NoStart,
    /// The estimated state is not finite, or its step failed.
    EstimateLost,
    /// A planned tension is not a finite number.
    TensionNotFinite {
        /// Cable (0-based).
        cable: u16,
    },
    /// A planned tension lies outside its box by more than rounding.
    TensionOutside {
        /// Cable (0-based).
        cable: u16,
        /// As planned (N).
        tension_n: f64,
    },
    /// The planner could not linearise its step several times in a row.
    PlanSingular {
        /// Ticks in a row.
        count: u32,
    },
    /// A target that is not a finite number reached the loop.
    TargetNotFinite,
    /// Too many deadlines missed.
    Overruns {
        /// Missed and not forgotten (`control::overruns`).
        count: u32,
    },
    /// The tip is faster than declared.
    TipSpeed {
        /// Speed (m/s).
        speed_mps: f64,
    },
    /// A segment bends faster than declared.
    BendRate {
        /// Rate of its bend angle (rad/s).
        rate_radps: f64,
    },
    /// The arm swings by more than declared.
    Swinging {
        /// Swing of the tip, peak to peak (m).
        swing_m: f64,
    },
    /// A tension stays at its limit.
    Saturated {
        /// Cable (0-based).
        cable: u16,
        /// Time (s).
        time_s: f64,
    },
}

impl Fault {
    /// [`Fault::EmergencyStop`] of the operator's socket.
    pub const SERVICE: u16 = u16::MAX;

    /// [`Fault::DriveFault`]'s cause where another node has written to the drive.
    pub const CHANGED: u32 = 10;

    /// One of each, for documents and tests; the data stand for any.
    pub const EXAMPLES: [Self; 25] = [
        Self::DriveFault { cable: 0, cause: 0 },
        Self::DrivesLost,
        Self::DrivesNotUp { after_s: 0.0 },
        Self::BusLost { bus: 0 },
        Self::TensionError { cable: 0, error_n: 0.0 },
        Self::EmergencyStop { source: 0 },
        Self::EncoderSilent { cable: 0, age_s: 0.0 },
        Self::EncoderJump { cable: 0, step_m: 0.0 },
        Self::EncoderStuck { cable: 0, motion_m: 0.0 },
        Self::CableLength { cable: 0, error_m: 0.0, factor: 1.0, unsure: false },
        Self::CablePull { cable: 0, factor: 1.0 },
        Self::InnovationBound { innovation_rad: 0.0 },
        Self::InnovationGrowth { growth_rad: 0.0 },
        Self::NotSettled { after_s: 0.0 },
        Self::NoStart,
        Self::EstimateLost,
        Self::TensionNotFinite { cable: 0 },
        Self::TensionOutside { cable: 0, tension_n: 0.0 },
        Self::PlanSingular { count: 0 },
        Self::TargetNotFinite,
        Self::Overruns { count: 0 },
        Self::TipSpeed { speed_mps: 0.0 },
        Self::BendRate { rate_radps: 0.0 },
        Self::Swinging { swing_m: 0.0 },
        Self::Saturated { cable: 0, time_s: 0.0 },
    ];

    /// Stable number: 1x drives and bus, 2x encoders and cables, 3x estimate, 4x plan, 5x time, 6x motion.
    pub const fn code(&self) -> u32 {
        match self {
            Self::DriveFault { .. } => 10,
            Self::DrivesLost => 11,
            Self::DrivesNotUp { .. } => 12,
            Self::BusLost { .. } => 13,
            Self::TensionError { .. } => 14,
            Self::EmergencyStop { .. } => 15,
            Self::EncoderSilent { .. } => 20,
            Self::EncoderJump { .. } => 21,
            Self::EncoderStuck { .. } => 22,
            Self::CableLength { .. } => 23,
            Self::CablePull { .. } => 24,
            Self::InnovationBound { .. } => 30,
            Self::InnovationGrowth { .. } => 31,
            Self::NotSettled { .. } => 32,
            Self::NoStart => 33,
            Self::EstimateLost => 34,
            Self::TensionNotFinite { .. } => 40,
            Self::TensionOutside { .. } => 41,
            Self::PlanSingular { .. } => 42,
            Self::TargetNotFinite => 43,
            Self::Overruns { .. } => 50,
            Self::TipSpeed { .. } => 60,
            Self::BendRate { .. } => 61,
            Self::Swinging { .. } => 62,
            Self::Saturated { .. } => 63,
        }
    }

    /// Whether the arm may stay as it is at this fault, held by the tensions that it had, until somebody stops it. It may not
    /// where a drive pulls what nobody told it to, where somebody else commands the drives, where a person presses a
    /// button, and where nothing is held yet.
    pub const fn permits_holding(&self) -> bool {
        match self {
            Self::TensionError { .. } | Self::EmergencyStop { .. } | Self::DrivesNotUp { .. } => false,
            Self::DriveFault { cause, .. } => *cause != Self::CHANGED,
            _ => true,
        }
    }

    /// Whether a drive with this cause of a fault gives no torque any more: an error of the device by its emergency code (CiA 301),
    /// other than one of communication (81xx, 82xx), at which it does what it was told to do without a master.
    pub const fn ends_torque(cause: u32) -> bool {
        cause >= 0x1000 && cause >> 8 != 0x81 && cause >> 8 != 0x82
    }

    /// Whether the loop itself is sound, so that a stop may lower the arm after this fault.
    pub const fn permits_lowering(&self) -> bool {
        matches!(self, Self::TargetNotFinite | Self::Overruns { .. } | Self::Saturated { .. })
    }

    /// Whether the estimate can no longer be believed, so that it is not continued after this fault.
    pub const fn spoils_estimate(&self) -> bool {
        matches!(self.class(), Class::Cables | Class::Estimate)
    }
}

/// The machine acts within a bound; no change of mode, or one that an ordinary request undoes.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[repr(u8)]
pub enum Limit {
    /// Obstacles are unknown or too old: holding.
    ObstaclesExpired = 0,
    /// The target is absent or too old: holding.
    TargetStale = 1,
    /// The guard limits the change of a tension per tick.
    RateLimited = 2,
    /// A deadline was missed: the last tensions are held.
    OverrunHold = 3,
    /// Several were: the tensions are ramped down.
    OverrunRamp = 4,
    /// The time budget ended the planning step.
    BudgetSpent = 5,
    /// Distance constraints conflicted and were relaxed.
    Relaxed = 6,
    /// The planner failed in this tick; the last tensions are kept.
    PlanSingular = 7,
    /// A reading is missing and is bridged by the model.
    EncoderBridged = 8,
    /// Obstacles hold the arm back on its way; the reference waits.
    Blocked = 9,
    /// The target is out of reach: the nearest pose is approached, or the arm holds.
    OutOfReach = 10,
    /// The tip swings by more than `supervision.swing_m`.
    Swinging = 16,
    /// The tip is faster than `supervision.tip_speed_mps`.
    TipSpeed = 17,
    /// A segment bends faster than `supervision.bend_rate_radps`.
    BendRate = 18,
    /// A tension has been at its limit for `supervision.saturation_s`.
    Saturated = 19,
    /// A drive measures another tension than it was told.
    TensionError = 20,
    /// A cable's drive shows or pulls another amount than it says.
    CableSuspect = 21,
    /// An emergency stop outside of the controller is pressed.
    EmergencyStop = 22,
    /// The tip is measured farther from the estimate than `tip_sensor.error_m`: not used.
    TipDoubted = 23,
}

impl Limit {
    /// All, in the order of their codes.
    pub const ALL: [Self; 19] = [
        Self::ObstaclesExpired,
        Self::TargetStale,
        Self::RateLimited,
        Self::OverrunHold,
        Self::OverrunRamp,
        Self::BudgetSpent,
        Self::Relaxed,
        Self::PlanSingular,
        Self::EncoderBridged,
        Self::Blocked,
        Self::OutOfReach,
        Self::Swinging,
        Self::TipSpeed,
        Self::BendRate,
        Self::Saturated,
        Self::TensionError,
        Self::CableSuspect,
        Self::EmergencyStop,
        Self::TipDoubted,
    ];

    /// Stable number from 100 on, apart from those of faults.
    pub const fn code(self) -> u32 {
        100 + self as u32
    }

    /// A short text for people.
    pub const fn text(self) -> &'static str {
        match self {
            Self::ObstaclesExpired => "obstacles unknown or too old: holding",
            Self::TargetStale => "target absent or too old: holding",
            Self::RateLimited => "tension rate limited",
            Self::OverrunHold => "deadline missed: last tensions held",
            Self::OverrunRamp => "deadlines missed: tensions ramped down",
            Self::BudgetSpent => "planning budget spent",
            Self::Relaxed => "distance constraints relaxed",
            Self::PlanSingular => "planning step failed: last tensions kept",
            Self::EncoderBridged => "missing reading bridged by the model",
            Self::Blocked => "the way is blocked: waiting",
            Self::OutOfReach => "the target is out of reach",
            Self::Swinging => "the arm swings",
            Self::TipSpeed => "the tip is faster than declared",
            Self::BendRate => "a segment bends faster than declared",
            Self::Saturated => "a tension stays at its limit",
            Self::TensionError => "a drive measures another tension than it was told",
            Self::CableSuspect => "a cable does not do what its drive says",
            Self::EmergencyStop => "an emergency stop is pressed",
            Self::TipDoubted => "the tip sensor and the cables differ by too much",
        }
    }
}

/// The limits that act in a tick.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct Limits(pub u32);

impl Limits {
    /// Adds one.
    pub const fn insert(&mut self, limit: Limit) {
        self.0 |= 1 << limit as u32;
    }

    /// Whether one acts.
    pub const fn contains(self, limit: Limit) -> bool {
        self.0 >> limit as u32 & 1 == 1
    }
}

/// Most faults that one tick can raise: more than there are kinds would be repetition.
const LIST_MAX: usize = 8;

/// The faults of one tick; what finds no place is counted.
#[derive(Debug, Clone, Copy, Default)]
pub struct FaultList {
    faults: [Option<Fault>; LIST_MAX],
    count: usize,
}

impl FaultList {
    /// Adds one; beyond the capacity it is dropped, since the first cause is what counts.
    pub fn push(&mut self, fault: Fault) {
        if self.count < LIST_MAX {
            self.faults[self.count] = Some(fault);
            self.count += 1;
        }
    }

    /// In the order in which they were found.
    pub fn iter(&self) -> impl Iterator<Item = Fault> + '_ {
        self.faults[..self.count].iter().flatten().copied()
    }

    /// Whether there is none.
    pub const fn is_empty(&self) -> bool {
        self.count == 0
    }
}

/// A fault with its time.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Latched {
    /// What.
    pub fault: Fault,
    /// Tick in which it was found.
    pub tick: u64,
    /// Time of that tick (ns).
    pub now_ns: u64,
}

/// Keeps the first cause and counts what follows, until it is cleared.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct FaultLatch {
    /// The first cause: what the operator must look at; the rest often follows from it.
    pub first: Option<Latched>,
    /// The newest one.
    pub last: Option<Latched>,
    /// How many were raised since the last clear, repetitions included.
    pub count: u32,
    /// Bit `code` for every kind that was raised.
    pub kinds: u64,
}

impl FaultLatch {
    /// Latches a fault; true if its kind is new since the last clear.
    pub fn raise(&mut self, fault: Fault, tick: u64, now_ns: u64) -> bool {
        let latched = Latched { fault, tick, now_ns };
        self.first.get_or_insert(latched);
        self.last = Some(latched);
        self.count = self.count.saturating_add(1);
        let bit = 1 << fault.code();
        let new = self.kinds & bit == 0;
        self.kinds |= bit;
        new
    }

    /// Whether something is latched.
    pub const fn is_latched(&self) -> bool {
        self.first.is_some()
    }

    /// Forgets everything.
    pub fn clear(&mut self) {
        *self = Self::default();
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn codes_are_the_ones_that_were_given_out() {
        let codes: Vec<u32> = Fault::EXAMPLES.iter().map(Fault::code).collect();
        assert_eq!(
            codes,
            [10, 11, 12, 13, 14, 15, 20, 21, 22, 23, 24, 30, 31, 32, 33, 34, 40, 41, 42, 43, 50, 60, 61, 62, 63]
        );
        assert!(codes.iter().all(|&c| c < 64), "the latch keeps one bit per code");
        let limits: Vec<u32> = Limit::ALL.iter().map(|l| l.code()).collect();
        assert_eq!(limits, (100..111).chain(116..124).collect::<Vec<_>>());
    }

    #[test]
    fn every_fault_says_what_happened_and_what_clears_it() {
        let names = crate::config::CableNames::new([6; 4]);
        for fault in Fault::EXAMPLES {
            assert!(!fault.what().is_empty() && !fault.in_words(&names).is_empty());
            assert!(fault.remedy().contains("`clear`"), "{fault:?}");
        }
        let texts: std::collections::HashSet<_> = Fault::EXAMPLES.iter().map(Fault::what).collect();
        assert_eq!(texts.len(), Fault::EXAMPLES.len(), "one text per fault");
    }

    #[test]
    fn the_latch_keeps_the_first_cause_and_counts_the_rest() {
        let mut latch = FaultLatch::default();
        let first = Fault::EncoderSilent { cable: 3, age_s: 0.06 };
        assert!(latch.raise(first, 7, 70));
        assert!(!latch.raise(Fault::EncoderSilent { cable: 4, age_s: 0.06 }, 8, 80), "the kind is known");
        assert!(latch.raise(Fault::DrivesLost, 9, 90));
        assert_eq!(latch.first, Some(Latched { fault: first, tick: 7, now_ns: 70 }));
        assert_eq!(latch.last.unwrap().fault, Fault::DrivesLost);
        assert_eq!((latch.count, latch.kinds), (3, 1 << 20 | 1 << 11));
        latch.clear();
        assert!(!latch.is_latched());
        assert_eq!(latch.count, 0);
    }

    #[test]
    fn a_list_that_is_full_keeps_the_first_ones() {
        let mut list = FaultList::default();
        (0..20).for_each(|bus| list.push(Fault::BusLost { bus }));
        assert_eq!(list.iter().map(|f| f.detail()).collect::<Vec<_>>(), (0..8).collect::<Vec<_>>());
    }
}
