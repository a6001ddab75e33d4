//! Faults by command: encoders that stick, jump or fall silent, drives that trip, restart or die.
//!
//! Enters: texts such as `stick:7@12.5`. Leaves: what happens to which cable, and when. It never decides by itself: a
//! cable left to chance (`any`) is drawn from the plant's seed, so that a seed gives the same fault every time.

use rand::{RngExt, SeedableRng};
use rand_xoshiro::Xoshiro256PlusPlus;
use sinew::config::{CableName, CableNames};
use std::str::FromStr;

/// What breaks.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum FaultKind {
    /// The encoder shows its last value for ever.
    Stick,
    /// The encoder is off by this much (m) from then on.
    Jump(f64),
    /// The drive's process data no longer reach the bus; it follows its commands all the same.
    Silence,
    /// The drive cuts its power and says so: over-current (EMCY 0x2310).
    Trip,
    /// The drive loses its supply: no torque, no frame, no answer.
    Dead,
    /// The drive's supply fails for a moment: it starts anew, announces itself, and has lost its configuration.
    Reboot,
    /// The drive pulls so much more than it is told (N), and measures it.
    Pull(f64),
    /// The emergency stop at the drive is pressed, for good: bit 14 of its statusword.
    Press,
}

/// Which cable.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Which {
    /// By its name.
    Cable(CableName),
    /// By its number over the whole arm, from 1.
    Number(usize),
    /// Drawn from the seed.
    Any,
}

/// One fault.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct FaultSpec {
    /// What breaks.
    pub kind: FaultKind,
    /// Where.
    pub which: Which,
    /// When (s), counted from the moment at which the first drive was enabled.
    pub at_s: f64,
}

/// What a drive pulls too much, unless told otherwise (N).
const PULL_N: f64 = 40.0;
/// Step of an encoder that jumps, unless told otherwise (m).
const JUMP_M: f64 = 0.02;

impl FromStr for FaultSpec {
    type Err = String;

    /// `kind:cable@seconds`, `jump:cable:metres@seconds`, `pull:cable:newtons@seconds`; without a time: at once; `any` for a cable drawn from the seed.
    fn from_str(text: &str) -> Result<Self, String> {
        let usage = || {
            format!(
                "`{text}`: expected stick|jump|silence|trip|dead|reboot|press:CABLE[@SECONDS], jump:CABLE[:METRES][@SECONDS] or pull:CABLE[:NEWTONS][@SECONDS], CABLE as SEGMENT,NUMBER, e.g. stick:2,1@12.5 or jump:any:0.03@4"
            )
        };
        let (what, at) = text.split_once('@').unwrap_or((text, "0"));
        let at_s: f64 = at.parse().map_err(|_| usage())?;
        if !(at_s.is_finite() && at_s >= 0.0) {
            return Err(usage());
        }
        let mut parts = what.split(':');
        let (kind, cable, size) = (parts.next(), parts.next(), parts.next());
        if parts.next().is_some() {
            return Err(usage());
        }
        let kind = match (kind, size) {
            (Some("stick"), None) => FaultKind::Stick,
            (Some("jump"), None) => FaultKind::Jump(JUMP_M),
            (Some("jump"), Some(size)) => {
                let size: f64 = size.parse().map_err(|_| usage())?;
                if !size.is_finite() {
                    return Err(usage());
                }
                FaultKind::Jump(size)
            }
            (Some("pull"), None) => FaultKind::Pull(PULL_N),
            (Some("pull"), Some(size)) => match size.parse() {
                Ok(size) if f64::is_finite(size) => FaultKind::Pull(size),
                _ => return Err(usage()),
            },
            (Some("press"), None) => FaultKind::Press,
            (Some("silence"), None) => FaultKind::Silence,
            (Some("trip"), None) => FaultKind::Trip,
            (Some("dead"), None) => FaultKind::Dead,
            (Some("reboot"), None) => FaultKind::Reboot,
            _ => return Err(usage()),
        };
        let which = match cable {
            Some("any") => Which::Any,
            Some(number) => match number.parse() {
                Ok(n) if n >= 1 => Which::Number(n),
                _ => Which::Cable(number.parse().map_err(|_| usage())?),
            },
            None => return Err(usage()),
        };
        Ok(Self { kind, which, at_s })
    }
}

/// Faults that have not happened yet, in the order of their times.
#[derive(Debug, Clone, Default)]
pub struct Schedule {
    /// Latest first.
    waiting: Vec<(f64, usize, FaultKind)>,
}

impl Schedule {
    /// Settles which cables are meant.
    ///
    /// # Errors
    /// A cable that the arm has not.
    pub fn new(specs: &[FaultSpec], names: &CableNames, seed: u64) -> Result<Self, String> {
        let mut rng = Xoshiro256PlusPlus::seed_from_u64(seed);
        let mut waiting = Vec::with_capacity(specs.len());
        for spec in specs {
            let cable = match spec.which {
                Which::Any => rng.random_range(0..names.count()),
                Which::Cable(name) => names.find(name).ok_or_else(|| format!("the arm has no cable {name}"))?,
                Which::Number(n) if n <= names.count() => n - 1,
                Which::Number(n) => return Err(format!("the arm has no cable {n}: it has {}", names.count())),
            };
            waiting.push((spec.at_s, cable, spec.kind));
        }
        // Those of one time in the order given.
        waiting.sort_by(|a, b| a.0.total_cmp(&b.0));
        waiting.reverse();
        Ok(Self { waiting })
    }

    /// The next fault whose time has come: its cable (from 0) and what breaks.
    pub fn due(&mut self, time_s: f64) -> Option<(usize, FaultKind)> {
        // Half a nanosecond: times are sums of periods.
        if self.waiting.last().is_some_and(|w| w.0 <= time_s + 5e-10) {
            self.waiting.pop().map(|(_, cable, kind)| (cable, kind))
        } else {
            None
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_fault_is_read_as_it_is_written() {
        let spec = |text: &str| text.parse::<FaultSpec>().unwrap();
        let name = "2,1".parse().unwrap();
        assert_eq!(spec("stick:2,1@12.5"), FaultSpec { kind: FaultKind::Stick, which: Which::Cable(name), at_s: 12.5 });
        assert_eq!(spec("stick:7").which, Which::Number(7));
        assert_eq!(spec("jump:any:-0.03"), FaultSpec { kind: FaultKind::Jump(-0.03), which: Which::Any, at_s: 0.0 });
        assert_eq!(spec("dead:24@1").kind, FaultKind::Dead);
        assert_eq!(spec("reboot:2@1").kind, FaultKind::Reboot);
        assert_eq!(spec("pull:2:-30@1").kind, FaultKind::Pull(-30.0));
        assert_eq!(spec("press:2@1").kind, FaultKind::Press);
    }

    #[test]
    fn a_fault_that_makes_no_sense_is_refused_with_an_example() {
        for text in [
            "",
            "stick",
            "stick:0",
            "stick:x@1",
            "burn:1",
            "stick:1@-1",
            "stick:1@inf",
            "stick:1:2",
            "jump:1:nan",
            "pull:1:x",
            "press:1:2",
        ] {
            let refusal = text.parse::<FaultSpec>().unwrap_err();
            assert!(refusal.contains("stick:2,1@12.5"), "{refusal}");
        }
    }

    #[test]
    fn faults_come_in_the_order_of_their_times_and_once() {
        let specs: Vec<FaultSpec> = ["stick:1,3@2", "jump:1,1@1", "trip:2@2"].map(|t| t.parse().unwrap()).into();
        let mut schedule = Schedule::new(&specs, &CableNames::new([6; 4]), 1).unwrap();
        assert_eq!(schedule.due(0.5), None);
        assert_eq!(schedule.due(1.0), Some((0, FaultKind::Jump(JUMP_M))));
        assert_eq!(schedule.due(1.0), None);
        assert_eq!(schedule.due(3.0), Some((2, FaultKind::Stick)));
        assert_eq!(schedule.due(3.0), Some((1, FaultKind::Trip)));
        assert_eq!(schedule.due(9.0), None);
    }

    #[test]
    fn a_cable_left_to_chance_is_the_same_for_a_seed_and_exists() {
        let specs = vec!["stick:any@0".parse().unwrap(); 50];
        let draw = |seed| {
            let mut schedule = Schedule::new(&specs, &CableNames::new([6]), seed).unwrap();
            std::iter::from_fn(|| schedule.due(0.0)).map(|f| f.0).collect::<Vec<_>>()
        };
        assert_eq!(draw(4), draw(4));
        assert_ne!(draw(4), draw(5));
        assert!(draw(4).iter().all(|&c| c < 6));
        for absent in ["stick:7", "stick:1,7", "stick:2,1"] {
            let specs = [absent.parse().unwrap()];
            assert!(Schedule::new(&specs, &CableNames::new([6]), 1).unwrap_err().contains("the arm has no cable"));
        }
    }
}
