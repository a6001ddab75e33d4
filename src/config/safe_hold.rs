//! `safe_hold`: what a drive does by itself when its master is silent, and what the loop does with its cable at a fault.
//!
//! An arm stores elastic energy, so letting go is a motion. An arm whose cables keep pulling as they did stays where it is.

use super::drives::DriveConfig;
use super::reader::Section;
use super::schema::{Key, Kind};
use serde::Serialize;

/// What becomes of a cable without a master.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum SafeHold {
    /// It keeps its tension.
    #[default]
    Hold,
    /// It goes to the tension of the last moments without what was swinging, which the drive is told all the time.
    Rest,
    /// It goes to `safe_tension_n` within `safe_ramp_s`.
    Ramp,
    /// The drive's brake closes.
    Brake,
}

impl SafeHold {
    /// Every one.
    pub const ALL: [Self; 4] = [Self::Hold, Self::Rest, Self::Ramp, Self::Brake];

    /// As the configuration has it.
    pub const fn name(self) -> &'static str {
        match self {
            Self::Hold => "hold",
            Self::Rest => "rest",
            Self::Ramp => "ramp",
            Self::Brake => "brake",
        }
    }

    /// What a drive of this kind is told to do when the connection is lost (6007): nothing, so that it keeps its torque; a
    /// fault; or to take its voltage off, by which its brake closes. The simulated drive has its own objects for a hold.
    pub const fn abort_connection(self, simulated: bool) -> i16 {
        match self {
            Self::Brake => 2,
            Self::Hold if !simulated => 0,
            _ => 1,
        }
    }

    /// Whether the arm stays about where it is.
    pub const fn stays(self) -> bool {
        !matches!(self, Self::Ramp)
    }
}

/// What all cables do, in words: `hold`, or `hold (20), ramp (4)`.
pub fn in_words(drives: &[DriveConfig]) -> String {
    let count = |hold: SafeHold| drives.iter().filter(|drive| drive.safe_hold == hold).count();
    let used: Vec<_> = SafeHold::ALL.into_iter().map(|hold| (hold, count(hold))).filter(|(_, n)| *n > 0).collect();
    match &used[..] {
        [(hold, _)] => hold.name().to_owned(),
        _ => used.iter().map(|(hold, n)| format!("{} ({n})", hold.name())).collect::<Vec<_>>().join(", "),
    }
}

pub(super) const KEY: Key = Key::default(
    "safe_hold",
    Kind::Choice(&["hold", "rest", "ramp", "brake"]),
    "",
    "\"hold\"",
    "What the drive does by itself when its master is silent, and the loop with the cable at a fault. `hold`: it keeps its \
     tension, so the arm stays. `rest`: it goes to the tension of the last moments without what was swinging, which is \
     written to the drive all the time (2000:02, sinew's simulated drive alone). `ramp`: it goes to `safe_tension_n`, by which \
     a bent arm springs back. `brake`: its voltage is taken off, and its brake closes (not sinew's simulated drive, which has none).",
);

pub(super) fn read(section: &Section<'_>) -> SafeHold {
    let name = section.choice(KEY.name);
    SafeHold::ALL.into_iter().find(|hold| hold.name() == name).unwrap_or_default()
}

/// Refuses what the drive cannot do.
pub(super) fn check(section: &Section<'_>, drive: &DriveConfig) {
    let refused = match (drive.safe_hold, drive.is_simulated()) {
        (SafeHold::Rest, false) => {
            ("the drive has no object for a tension that is kept up to date", "hold, ramp, brake")
        }
        (SafeHold::Brake, true) => ("sinew's simulated drive has no brake", "hold, rest, ramp"),
        _ => return,
    };
    if section.is_clean() {
        section.refuse(KEY.name, refused.0, &format!("permitted: {}", refused.1));
    }
}
