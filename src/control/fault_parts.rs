//! What a fault is about, and what it carries: as numbers, and back.

use super::fault::Fault;

/// The kind of a fault: the tens of its code.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Class {
    /// Drives and buses.
    Drives = 1,
    /// Encoders and cables.
    Cables = 2,
    /// The estimate.
    Estimate = 3,
    /// The plan.
    Plan = 4,
    /// Deadlines.
    Time = 5,
    /// The arm's motion.
    Motion = 6,
}

/// What a fault is about.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Subject {
    /// The arm as a whole.
    Arm,
    /// A cable, its encoder or its drive (0-based).
    Cable(u16),
    /// A bus (0-based).
    Bus(u16),
    /// Whoever ordered it.
    Operator,
}

impl Fault {
    /// Its kind; the tens of its code.
    pub const fn class(&self) -> Class {
        match self {
            Self::DriveFault { .. }
            | Self::DrivesLost
            | Self::DrivesNotUp { .. }
            | Self::BusLost { .. }
            | Self::TensionError { .. }
            | Self::EmergencyStop { .. } => Class::Drives,
            Self::EncoderSilent { .. }
            | Self::EncoderJump { .. }
            | Self::EncoderStuck { .. }
            | Self::CableLength { .. }
            | Self::CablePull { .. } => Class::Cables,
            Self::InnovationBound { .. }
            | Self::InnovationGrowth { .. }
            | Self::NotSettled { .. }
            | Self::NoStart
            | Self::EstimateLost => Class::Estimate,
            Self::TensionNotFinite { .. }
            | Self::TensionOutside { .. }
            | Self::PlanSingular { .. }
            | Self::TargetNotFinite => Class::Plan,
            Self::Overruns { .. } => Class::Time,
            Self::TipSpeed { .. } | Self::BendRate { .. } | Self::Swinging { .. } | Self::Saturated { .. } => {
                Class::Motion
            }
        }
    }

    /// What it is about.
    pub const fn subject(&self) -> Subject {
        match *self {
            Self::DriveFault { cable, .. }
            | Self::TensionError { cable, .. }
            | Self::EncoderSilent { cable, .. }
            | Self::EncoderJump { cable, .. }
            | Self::EncoderStuck { cable, .. }
            | Self::CableLength { cable, .. }
            | Self::CablePull { cable, .. }
            | Self::TensionNotFinite { cable }
            | Self::TensionOutside { cable, .. }
            | Self::Saturated { cable, .. } => Subject::Cable(cable),
            Self::EmergencyStop { source: Self::SERVICE } => Subject::Operator,
            Self::EmergencyStop { source } => Subject::Cable(source),
            Self::BusLost { bus } => Subject::Bus(bus),
            Self::DrivesLost
            | Self::DrivesNotUp { .. }
            | Self::InnovationBound { .. }
            | Self::InnovationGrowth { .. }
            | Self::NotSettled { .. }
            | Self::NoStart
            | Self::EstimateLost
            | Self::PlanSingular { .. }
            | Self::TargetNotFinite
            | Self::Overruns { .. }
            | Self::TipSpeed { .. }
            | Self::BendRate { .. }
            | Self::Swinging { .. } => Subject::Arm,
        }
    }

    /// What it is about, as a number: the cable or bus (0-based), a count where it has one, else 0.
    pub const fn detail(&self) -> u32 {
        match (self.subject(), self) {
            (Subject::Cable(place) | Subject::Bus(place), _) => place as u32,
            (Subject::Operator, _) => Self::SERVICE as u32,
            (Subject::Arm, Self::PlanSingular { count } | Self::Overruns { count }) => *count,
            (Subject::Arm, _) => 0,
        }
    }

    /// The numbers that it carries, first the one that tells most; NaN where there is none.
    pub fn values(&self) -> [f64; 2] {
        let one = |value: f64| [value, f64::NAN];
        match *self {
            Self::DriveFault { cause, .. } => one(f64::from(cause)),
            Self::DrivesNotUp { after_s } | Self::NotSettled { after_s } => one(after_s),
            Self::TensionError { error_n, .. } => one(error_n),
            Self::EncoderSilent { age_s, .. } => one(age_s),
            Self::EncoderJump { step_m, .. } => one(step_m),
            Self::EncoderStuck { motion_m, .. } => one(motion_m),
            Self::CableLength { error_m, factor, .. } => [error_m, factor],
            Self::CablePull { factor, .. } => one(factor),
            Self::InnovationBound { innovation_rad } => one(innovation_rad),
            Self::InnovationGrowth { growth_rad } => one(growth_rad),
            Self::TensionOutside { tension_n, .. } => one(tension_n),
            Self::PlanSingular { count } | Self::Overruns { count } => one(f64::from(count)),
            Self::TipSpeed { speed_mps } => one(speed_mps),
            Self::BendRate { rate_radps } => one(rate_radps),
            Self::Swinging { swing_m } => one(swing_m),
            Self::Saturated { time_s, .. } => one(time_s),
            Self::DrivesLost
            | Self::BusLost { .. }
            | Self::EmergencyStop { .. }
            | Self::NoStart
            | Self::EstimateLost
            | Self::TensionNotFinite { .. }
            | Self::TargetNotFinite => one(f64::NAN),
        }
    }

    /// What is neither a number nor what it is about: bit 0, another cable of the segment may be the one.
    pub const fn flags(&self) -> u32 {
        match self {
            Self::CableLength { unsure, .. } => *unsure as u32,
            _ => 0,
        }
    }

    /// The fault of what [`Self::code`], [`Self::detail`], [`Self::flags`] and [`Self::values`] told; `None` for a code of
    /// another version.
    pub fn of_parts(code: u32, detail: u32, flags: u32, [value, second]: [f64; 2]) -> Option<Self> {
        let kind = Self::EXAMPLES.into_iter().find(|fault| fault.code() == code)?;
        let cable = detail as u16;
        Some(match kind {
            Self::DriveFault { .. } => Self::DriveFault { cable, cause: value as u32 },
            Self::DrivesNotUp { .. } => Self::DrivesNotUp { after_s: value },
            Self::BusLost { .. } => Self::BusLost { bus: cable },
            Self::TensionError { .. } => Self::TensionError { cable, error_n: value },
            Self::EmergencyStop { .. } => Self::EmergencyStop { source: cable },
            Self::EncoderSilent { .. } => Self::EncoderSilent { cable, age_s: value },
            Self::EncoderJump { .. } => Self::EncoderJump { cable, step_m: value },
            Self::EncoderStuck { .. } => Self::EncoderStuck { cable, motion_m: value },
            Self::CableLength { .. } => {
                Self::CableLength { cable, error_m: value, factor: second, unsure: flags & 1 == 1 }
            }
            Self::CablePull { .. } => Self::CablePull { cable, factor: value },
            Self::InnovationBound { .. } => Self::InnovationBound { innovation_rad: value },
            Self::InnovationGrowth { .. } => Self::InnovationGrowth { growth_rad: value },
            Self::NotSettled { .. } => Self::NotSettled { after_s: value },
            Self::TensionNotFinite { .. } => Self::TensionNotFinite { cable },
            Self::TensionOutside { .. } => Self::TensionOutside { cable, tension_n: value },
            Self::PlanSingular { .. } => Self::PlanSingular { count: detail },
            Self::Overruns { .. } => Self::Overruns { count: detail },
            Self::TipSpeed { .. } => Self::TipSpeed { speed_mps: value },
            Self::BendRate { .. } => Self::BendRate { rate_radps: value },
            Self::Swinging { .. } => Self::Swinging { swing_m: value },
            Self::Saturated { .. } => Self::Saturated { cable, time_s: value },
            Self::DrivesLost | Self::NoStart | Self::EstimateLost | Self::TargetNotFinite => kind,
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_fault_is_the_same_behind_its_parts_and_its_class_is_the_tens_of_its_code() {
        let mut some = Fault::EXAMPLES.to_vec();
        some.extend([
            Fault::DriveFault { cable: 23, cause: 0x8250 },
            Fault::CableLength { cable: 7, error_m: 0.0012, factor: 2.0, unsure: true },
            Fault::EmergencyStop { source: Fault::SERVICE },
            Fault::EmergencyStop { source: 9 },
            Fault::Overruns { count: 400 },
            Fault::Swinging { swing_m: 0.03 },
        ]);
        for fault in some {
            assert_eq!(Fault::of_parts(fault.code(), fault.detail(), fault.flags(), fault.values()), Some(fault));
            assert_eq!(fault.class() as u32, fault.code() / 10, "{fault:?}");
        }
        assert_eq!(Fault::of_parts(1, 0, 0, [0.0; 2]), None);
    }
}
