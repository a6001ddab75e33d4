//! The power drive state machine of CiA 402 (part 2, figure 8): states, commands, legal transitions.

/// State of the power drive system.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub enum State {
    /// Starting; leaves by itself.
    NotReadyToSwitchOn,
    /// No power may be switched on.
    SwitchOnDisabled,
    /// Power may be switched on.
    ReadyToSwitchOn,
    /// Power is on, no torque.
    SwitchedOn,
    /// The drive follows its target.
    OperationEnabled,
    /// The drive brakes, or has braked.
    QuickStopActive,
    /// The drive reacts to a fault; leaves by itself.
    FaultReactionActive,
    /// Latched fault.
    Fault,
}

/// What a controlword asks for.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub enum Command {
    /// `0xxx x110`.
    Shutdown,
    /// `0xxx 0111`; in operation enabled it is "disable operation".
    SwitchOn,
    /// `0xxx 1111`.
    EnableOperation,
    /// `0xxx xx0x`.
    DisableVoltage,
    /// `0xxx x01x`.
    QuickStop,
    /// Rising edge of bit 7.
    FaultReset,
}

/// Bit 7 of the controlword.
pub const FAULT_RESET_BIT: u16 = 0x80;
/// Statusword: voltage enabled.
pub const VOLTAGE_ENABLED: u16 = 1 << 4;
/// Statusword: controlwords are obeyed.
pub const REMOTE: u16 = 1 << 9;
/// Statusword: a limit cuts the target.
pub const INTERNAL_LIMIT: u16 = 1 << 11;
/// Statusword, cyclic synchronous modes: the drive follows its target.
pub const FOLLOWS_TARGET: u16 = 1 << 12;

impl State {
    /// All states.
    pub const ALL: [Self; 8] = [
        Self::NotReadyToSwitchOn,
        Self::SwitchOnDisabled,
        Self::ReadyToSwitchOn,
        Self::SwitchedOn,
        Self::OperationEnabled,
        Self::QuickStopActive,
        Self::FaultReactionActive,
        Self::Fault,
    ];

    /// From a statusword; `None` for a pattern that CiA 402 does not define.
    pub const fn from_statusword(word: u16) -> Option<Self> {
        Some(match (word & 0x4f, word & 0x6f) {
            (0x00, _) => Self::NotReadyToSwitchOn,
            (0x40, _) => Self::SwitchOnDisabled,
            (_, 0x21) => Self::ReadyToSwitchOn,
            (_, 0x23) => Self::SwitchedOn,
            (_, 0x27) => Self::OperationEnabled,
            (_, 0x07) => Self::QuickStopActive,
            (0x0f, _) => Self::FaultReactionActive,
            (0x08, _) => Self::Fault,
            _ => return None,
        })
    }

    /// Bits 0 to 3, 5 and 6 of the statusword.
    pub const fn statusword(self) -> u16 {
        match self {
            Self::NotReadyToSwitchOn => 0x00,
            Self::SwitchOnDisabled => 0x40,
            Self::ReadyToSwitchOn => 0x21,
            Self::SwitchedOn => 0x23,
            Self::OperationEnabled => 0x27,
            Self::QuickStopActive => 0x07,
            Self::FaultReactionActive => 0x0f,
            Self::Fault => 0x08,
        }
    }

    /// The standard's name.
    pub const fn name(self) -> &'static str {
        match self {
            Self::NotReadyToSwitchOn => "not ready to switch on",
            Self::SwitchOnDisabled => "switch on disabled",
            Self::ReadyToSwitchOn => "ready to switch on",
            Self::SwitchedOn => "switched on",
            Self::OperationEnabled => "operation enabled",
            Self::QuickStopActive => "quick stop active",
            Self::FaultReactionActive => "fault reaction active",
            Self::Fault => "fault",
        }
    }

    /// State after a command; `None` if the command is no legal transition here (it is then ignored).
    ///
    /// `quick_stop_holds`: the quick stop option code (605A) is 5 to 8, so that transition 16 exists.
    pub const fn after(self, command: Command, quick_stop_holds: bool) -> Option<Self> {
        use Command as C;
        Some(match (self, command) {
            (Self::SwitchOnDisabled, C::Shutdown) => Self::ReadyToSwitchOn, // 2
            (Self::ReadyToSwitchOn, C::SwitchOn) => Self::SwitchedOn,       // 3
            (Self::ReadyToSwitchOn, C::EnableOperation) => Self::OperationEnabled, // 3 and 4, as the standard's note has it
            (Self::SwitchedOn, C::EnableOperation) => Self::OperationEnabled,      // 4
            (Self::OperationEnabled, C::SwitchOn) => Self::SwitchedOn,             // 5
            (Self::SwitchedOn, C::Shutdown) => Self::ReadyToSwitchOn,              // 6
            (Self::ReadyToSwitchOn, C::QuickStop | C::DisableVoltage) => Self::SwitchOnDisabled, // 7
            (Self::OperationEnabled, C::Shutdown) => Self::ReadyToSwitchOn,        // 8
            (Self::OperationEnabled, C::DisableVoltage) => Self::SwitchOnDisabled, // 9
            (Self::SwitchedOn, C::QuickStop | C::DisableVoltage) => Self::SwitchOnDisabled, // 10
            (Self::OperationEnabled, C::QuickStop) => Self::QuickStopActive,       // 11
            (Self::QuickStopActive, C::DisableVoltage) => Self::SwitchOnDisabled,  // 12
            (Self::Fault, C::FaultReset) => Self::SwitchOnDisabled,                // 15
            (Self::QuickStopActive, C::EnableOperation) if quick_stop_holds => Self::OperationEnabled, // 16
            _ => return None,
        })
    }
}

impl std::fmt::Display for State {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.write_str(self.name())
    }
}

impl Command {
    /// All commands.
    pub const ALL: [Self; 6] = [
        Self::Shutdown,
        Self::SwitchOn,
        Self::EnableOperation,
        Self::DisableVoltage,
        Self::QuickStop,
        Self::FaultReset,
    ];

    /// From a controlword and the one before it, whose bit 7 tells a fault reset's edge. While bit 7 stays set, no
    /// other command is read.
    pub const fn decode(before: u16, word: u16) -> Option<Self> {
        if word & FAULT_RESET_BIT != 0 {
            return if before & FAULT_RESET_BIT == 0 { Some(Self::FaultReset) } else { None };
        }
        Some(match word & 0xf {
            w if w & 0x2 == 0 => Self::DisableVoltage,
            w if w & 0x4 == 0 => Self::QuickStop,
            w if w & 0x1 == 0 => Self::Shutdown,
            w if w & 0x8 == 0 => Self::SwitchOn,
            _ => Self::EnableOperation,
        })
    }

    /// Controlword with only this command's bits.
    pub const fn controlword(self) -> u16 {
        match self {
            Self::Shutdown => 0x06,
            Self::SwitchOn => 0x07,
            Self::EnableOperation => 0x0f,
            Self::DisableVoltage => 0x00,
            Self::QuickStop => 0x02,
            Self::FaultReset => 0x80,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_state_is_read_back_from_its_statusword() {
        for s in State::ALL {
            for other in [0, VOLTAGE_ENABLED | REMOTE | FOLLOWS_TARGET] {
                assert_eq!(State::from_statusword(s.statusword() | other), Some(s));
            }
        }
    }

    #[test]
    fn every_command_is_read_back_from_its_controlword() {
        for c in Command::ALL {
            assert_eq!(Command::decode(0, c.controlword()), Some(c));
        }
        assert_eq!(Command::decode(0x80, 0x8f), None);
    }

    #[test]
    fn exactly_the_transitions_of_the_standard_are_legal() {
        let legal: Vec<_> = State::ALL
            .into_iter()
            .flat_map(|s| Command::ALL.into_iter().filter_map(move |c| s.after(c, true).map(|to| (s, c, to))))
            .collect();
        assert_eq!(legal.len(), 16);
        // A fault is left by nothing but a fault reset, and leads to the state without power.
        let from_fault: Vec<_> = legal.iter().filter(|(s, ..)| *s == State::Fault).collect();
        assert_eq!(from_fault, [&(State::Fault, Command::FaultReset, State::SwitchOnDisabled)]);
        // Torque is reached only over the states before it.
        assert!(legal.iter().filter(|(.., to)| *to == State::OperationEnabled).all(|(s, c, _)| {
            *c == Command::EnableOperation
                && matches!(s, State::ReadyToSwitchOn | State::SwitchedOn | State::QuickStopActive)
        }));
        assert_eq!(State::QuickStopActive.after(Command::EnableOperation, false), None);
    }
}
