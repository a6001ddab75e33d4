//! How far a property of the true arm may be from its model's before the loop that holds it is not stable.

use super::StabilityError;
use super::held::Held;
use super::plant::Differs;
use super::spectrum::Spectrum;
use crate::config::Config;
use serde::Serialize;

/// Factors that are looked at, away from 1.
const FACTORS: &[f64] = &[1.25, 1.6, 2.0, 3.0, 5.0, 10.0, 25.0];
/// Ticks of delay that are looked at.
const TICKS: &[usize] = &[1, 2, 3, 4, 6, 8, 12, 16, 24, 32];
/// Halvings of the interval between the last factor that is stable and the first that is not.
const HALVINGS: usize = 3;

/// A property of the true arm.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Property {
    /// Tension at the cable: the loop's gain.
    Pull,
    /// Damping.
    Damping,
    /// Stiffness.
    Stiffness,
}

impl Property {
    /// All.
    pub const ALL: [Self; 3] = [Self::Pull, Self::Damping, Self::Stiffness];

    /// In words.
    pub const fn name(self) -> &'static str {
        match self {
            Self::Pull => "tension",
            Self::Damping => "damping",
            Self::Stiffness => "stiffness",
        }
    }

    /// Largest factor that is of use: tensions and stiffness are known better than damping.
    const fn most(self) -> f64 {
        match self {
            Self::Damping => 25.0,
            Self::Pull | Self::Stiffness => 3.0,
        }
    }

    fn times(self, differs: &Differs, factor: f64) -> Differs {
        let mut differs = *differs;
        match self {
            Self::Pull => differs.pull *= factor,
            Self::Damping => differs.damping *= factor,
            Self::Stiffness => differs.stiffness *= factor,
        }
        differs
    }
}

/// Between which factors the loop is stable.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct Margin {
    /// Least factor that is stable; every one down to it that was looked at is.
    pub least: f64,
    /// Greatest one that is not below it; null where all that were looked at are stable.
    pub unstable_below: Option<f64>,
    /// Greatest factor that is stable.
    pub greatest: f64,
    /// Least one that is not above it; null where all that were looked at are stable.
    pub unstable_above: Option<f64>,
}

/// Margins of a held loop, each with the other properties as they are.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct Margins {
    /// Of the tension at the cables over the one commanded.
    pub tension: Margin,
    /// Of the arm's damping over what it is.
    pub damping: Margin,
    /// Of the arm's stiffness over what it is.
    pub stiffness: Margin,
    /// Most ticks by which tensions may come late, and the period (s).
    pub delay_ticks: usize,
    /// The same in seconds.
    pub delay_s: f64,
    /// Least delay that is not stable (ticks); null where all that were looked at are stable.
    pub unstable_delay_ticks: Option<usize>,
}

/// Looks for the margins of a held loop that is stable; `progress` is told of each spectrum. Allocates; takes a minute for
/// the paper's arm.
///
/// # Errors
/// [`StabilityError::NoMap`] of the loop as it is. A factor with which the arm is not held at all counts as not stable.
pub fn margins(config: &Config, held: &Held, progress: &mut dyn FnMut()) -> Result<Margins, StabilityError> {
    let differs = *held.plant().differs();
    let mut stable = |differs: &Differs| {
        progress();
        held.with(differs).and_then(|held| Spectrum::of(config, &held)).is_ok_and(|spectrum| spectrum.is_stable())
    };
    let mut side = |property: Property, up: bool| {
        let to = |factor: f64| if up { factor } else { 1.0 / factor };
        let (mut good, mut bad) = (1.0, None);
        for &factor in FACTORS.iter().filter(|f| **f <= property.most()) {
            if stable(&property.times(&differs, to(factor))) {
                good = factor;
            } else {
                bad = Some(factor);
                break;
            }
        }
        if let Some(bad) = &mut bad {
            for _ in 0..HALVINGS {
                let middle = (good * *bad).sqrt();
                if stable(&property.times(&differs, to(middle))) {
                    good = middle;
                } else {
                    *bad = middle;
                }
            }
        }
        (to(good), bad.map(to))
    };
    let mut both = |property: Property| {
        let ((least, unstable_below), (greatest, unstable_above)) = (side(property, false), side(property, true));
        Margin { least, unstable_below, greatest, unstable_above }
    };
    let [tension, damping, stiffness] = Property::ALL.map(&mut both);
    let (mut good, mut bad) = (0, None);
    for &ticks in TICKS {
        if stable(&Differs { late_ticks: differs.late_ticks + ticks, ..differs }) {
            good = ticks;
        } else {
            bad = Some(ticks);
            break;
        }
    }
    // Between the two every tick is looked at.
    while let Some(first) = bad
        && first > good + 1
    {
        let middle = good.midpoint(first);
        if stable(&Differs { late_ticks: differs.late_ticks + middle, ..differs }) {
            good = middle;
        } else {
            bad = Some(middle);
        }
    }
    Ok(Margins {
        tension,
        damping,
        stiffness,
        delay_ticks: good,
        delay_s: good as f64 * held.period_s(),
        unstable_delay_ticks: bad,
    })
}
