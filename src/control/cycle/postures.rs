//! Where the arm rests without torque, and where a task wants it to start.
//!
//! An arm stores elastic energy: tensions that belong to another posture than the one it is in throw it there. So cables
//! are tightened to the start tensions only where the arm already rests in their equilibrium (brakes hold it, or it was
//! left there). Everywhere else they are tightened evenly, and the way to the start posture is a motion like any other. The
//! way back is one, too.

use crate::control::settings::Settings;
use crate::integrator::{Stepper, equilibrium};
use crate::model::{Arm, State};

/// Cables whose lengths are all this near to an equilibrium's belong to it, over the arm's length.
const NEAR: f64 = 0.006;

/// Postures of an arm.
#[derive(Debug, Clone)]
pub(super) struct Postures {
    /// Mean curvatures at rest under the safe tensions (1/m).
    rest: Vec<f64>,
    start: Vec<f64>,
    start_lengths_m: Vec<f64>,
    start_n: Vec<f64>,
    even_n: Vec<f64>,
    near_m: f64,
    /// Whether the start tensions are another posture's than the even ones.
    differs: bool,
    /// What the present start tightens to: directly the start tensions?
    direct: Option<bool>,
}

impl Postures {
    /// By statics. Where the start tensions have no equilibrium that is found, its posture is the one at rest. Allocates.
    pub(super) fn new(settings: &Settings, arm: &Arm) -> Self {
        let even_n = vec![settings.safe_tension_n(); arm.cable_count()];
        let (rest, lengths) = at_rest(arm, &even_n).unwrap_or_else(|| straight(arm));
        let start_n = settings.start_tensions_n.clone();
        let differs = start_n != even_n;
        let (start, start_lengths_m) =
            if differs { at_rest(arm, &start_n).unwrap_or((rest.clone(), lengths)) } else { (rest.clone(), lengths) };
        let near_m = NEAR * settings.arm.length_m();
        Self { rest, start, start_lengths_m, start_n, even_n, near_m, differs, direct: (!differs).then_some(true) }
    }

    /// Mean curvatures (1/m) at rest under the safe tensions.
    pub(super) fn rest(&self) -> &[f64] {
        &self.rest
    }

    /// Mean curvatures (1/m) of the start tensions' equilibrium.
    pub(super) fn start(&self) -> &[f64] {
        &self.start
    }

    /// A new start: forgets what the last one chose.
    pub(super) fn forget(&mut self) {
        self.direct = (!self.differs).then_some(true);
    }

    /// Chooses by the cables' lengths (m) what to tighten to, once.
    pub(super) fn choose(&mut self, lengths_m: &[f64]) {
        let near = || self.start_lengths_m.iter().zip(lengths_m).all(|(a, b)| (a - b).abs() <= self.near_m);
        if self.direct.is_none() {
            self.direct = Some(near());
        }
    }

    /// Tensions (N) to tighten to; `None` while the arm's lengths have not been heard.
    pub(super) fn tensions_n(&self) -> Option<&[f64]> {
        self.direct.map(|direct| if direct { &self.start_n[..] } else { &self.even_n[..] })
    }

    /// Whether the start tensions are given at once, and hold the arm in another posture than the one it rests in.
    pub(super) fn is_bent(&self) -> bool {
        self.differs && self.direct == Some(true)
    }

    /// Whether the start posture is still to be gone to once the cables are tight.
    pub(super) fn is_to_raise(&self) -> bool {
        self.direct == Some(false)
    }
}

/// Mean curvatures (1/m) and lengths of the cables (m) in equilibrium under tensions `u` (N).
fn at_rest(arm: &Arm, u: &[f64]) -> Option<(Vec<f64>, Vec<f64>)> {
    let mut state = State::at_rest(arm.straight());
    equilibrium(arm, &mut Stepper::new(arm), u, &mut state).ok()?;
    Some(measured(arm, &state))
}

fn straight(arm: &Arm) -> (Vec<f64>, Vec<f64>) {
    measured(arm, &State::at_rest(arm.straight()))
}

fn measured(arm: &Arm, state: &State) -> (Vec<f64>, Vec<f64>) {
    let count = 2 * arm.segment_count();
    let (mut curvatures, mut rates, mut lengths) = (vec![0.0; count], vec![0.0; count], vec![0.0; arm.cable_count()]);
    arm.curvatures_into(&state.q, &state.qd, &mut curvatures, &mut rates);
    arm.cable_lengths_into(&state.q, &mut lengths);
    (curvatures, lengths)
}
