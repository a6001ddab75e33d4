//! What joins the drives to the arm: drums, brakes, encoders.
//!
//! Enters: every drive's torque and whether it follows its target, and the time by which the arm advances. Leaves: the
//! encoders' counts, the torque that the drives report, and the true arm for judging. It must never read a clock: in
//! lockstep a seed gives the same counts bit for bit.
//!
//! **Brakes.** At power-up every drum is held by its brake with its cable at the start tension, and the arm rests in that
//! equilibrium: as long as all brakes hold, nothing moves and nothing is integrated, however many SYNCs pass. A brake
//! opens as that of a hoist does, after its motor has taken the load over: when its drive is enabled and pulls at least
//! as much as the brake holds (within a step of the torque on the wire), or [`BRAKE_OPENS_S`] after the drive was enabled
//! if it never does. So a controller that tightens to the start tensions takes the arm over without a jump, cable by
//! cable. A brake that has opened stays open: from then on a drive without power lets its cable go slack, as the declared
//! safe tension of 0 N wants it.
//!
//! While a brake holds, the drive reports the torque of the held cable, as one with a torque sensor at its drum would.

use crate::config::PlantConfig;
use crate::fault::FaultKind;
use crate::truth::{Truth, TruthSettings};
use sinew::config::{ArmConfig, Config};
use sinew::integrator::{StaticsError, StepError};
use sinew_hal::motor_bank::{ChannelError, MotorBank, MotorChannel, Sense};

/// Time (s) after which the brake of an enabled drive opens although the drive does not carry the cable.
pub const BRAKE_OPENS_S: f64 = 5.0;

/// Where the arm rests at power-up.
#[derive(Debug, Clone, PartialEq)]
pub struct Start {
    /// Tensions (N), cable by cable.
    pub tensions_n: Vec<f64>,
    /// Curvatures (1/m), `(y, z)` segment by segment, near the equilibrium that is meant.
    pub curvatures_1pm: Vec<f64>,
}

impl Start {
    /// The straight arm under the least tensions.
    pub fn straight(arm: &ArmConfig) -> Self {
        Self {
            tensions_n: vec![arm.tension_n_min; arm.cable_count()],
            curvatures_1pm: vec![0.0; 2 * arm.segments.len()],
        }
    }
}

/// What a drive does to its cable now.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct DriveAction {
    /// It is in "operation enabled".
    pub enabled: bool,
    /// Torque (per mille of rated torque).
    pub torque_permille: i16,
}

/// Why there is no rig.
#[derive(Debug, thiserror::Error)]
pub enum RigError {
    /// A drive that cannot work.
    #[error("drives: {0}")]
    Channel(#[from] ChannelError),
    /// No start.
    #[error("the arm has no equilibrium under the start tensions: {0}")]
    Start(#[from] StaticsError),
    /// Lists of other lengths.
    #[error("{found} start tensions for {expected} cables")]
    Tensions {
        /// Cables of the arm.
        expected: usize,
        /// Tensions given.
        found: usize,
    },
}

/// One cable's drum.
#[derive(Debug, Clone, Copy, Default)]
struct Drum {
    /// Tension that the brake holds (N); `None` once it has opened.
    held_n: Option<f64>,
    enabled_s: f64,
    /// Counts of an encoder that sticks.
    stuck: Option<i32>,
    /// Error of an encoder that has jumped (m).
    offset_m: f64,
    /// What the motor pulls beyond what its drive is told (N), while it is enabled.
    extra_n: f64,
}

/// The arm between its drums.
#[derive(Debug, Clone)]
pub struct Rig {
    truth: Truth,
    channels: MotorBank,
    drums: Vec<Drum>,
    command_n: Vec<f64>,
    /// Lengths before the last step and their mean rates over it (m/s).
    before_m: Vec<f64>,
    rates_mps: Vec<f64>,
    encoder_step_m: f64,
    time_s: f64,
    enabled_at_s: Option<f64>,
}

/// The drives' channels: counts are 0 where a cable has its length on the straight arm of `[arm]`.
///
/// # Errors
/// A drive that cannot carry its cable.
pub fn channels(config: &Config) -> Result<MotorBank, ChannelError> {
    sinew::daemon::motor_channels(config)
}

impl Rig {
    /// The arm at rest between braked drums. `commands_late` is the number of calls of [`Rig::advance`] by which commands
    /// take effect late. Allocates.
    ///
    /// # Errors
    /// [`RigError`].
    pub fn new(config: &Config, plant: &PlantConfig, start: &Start, commands_late: usize) -> Result<Self, RigError> {
        let cables = config.arm.cable_count();
        if start.tensions_n.len() != cables {
            return Err(RigError::Tensions { expected: cables, found: start.tensions_n.len() });
        }
        // In real time the plant takes several steps a tick, and its latency counts steps.
        let settings = TruthSettings { latency_ticks: commands_late, ..plant.truth.clone() };
        let mut truth = Truth::new(&config.arm, &settings);
        truth.start_at_equilibrium(&start.tensions_n, &start.curvatures_1pm)?;
        let drum = |&held_n: &f64| Drum { held_n: Some(held_n), ..Drum::default() };
        Ok(Self {
            channels: channels(config)?,
            drums: start.tensions_n.iter().map(drum).collect(),
            command_n: start.tensions_n.clone(),
            before_m: truth.true_lengths().to_vec(),
            rates_mps: vec![0.0; cables],
            encoder_step_m: plant.truth.encoder_step_m,
            truth,
            time_s: 0.0,
            enabled_at_s: None,
        })
    }

    /// Advances by `dt_s` with what the drives do, one entry per cable.
    ///
    /// # Errors
    /// The integration failed.
    ///
    /// # Panics
    /// With fewer actions than cables.
    pub fn advance(&mut self, actions: &[DriveAction], dt_s: f64) -> Result<(), StepError> {
        for (cable, drum) in self.drums.iter_mut().enumerate() {
            let (action, channel) = (actions[cable], &self.channels.channels()[cable]);
            if action.enabled {
                self.enabled_at_s.get_or_insert(self.time_s);
            }
            // A cable does not push.
            let extra_n = if action.enabled { drum.extra_n } else { 0.0 };
            let motor_n = (channel.decode_tension(action.torque_permille) + extra_n).max(0.0);
            if let Some(held) = drum.held_n {
                let carries = action.enabled && motor_n >= held - channel.tension_quantum_n();
                drum.enabled_s = if action.enabled { drum.enabled_s + dt_s } else { 0.0 };
                if carries || drum.enabled_s > BRAKE_OPENS_S {
                    drum.held_n = None;
                }
            }
            self.command_n[cable] = drum.held_n.unwrap_or(motor_n);
        }
        self.time_s += dt_s;
        if self.drums.iter().all(|drum| drum.held_n.is_some()) {
            return Ok(());
        }
        self.before_m.copy_from_slice(self.truth.true_lengths());
        self.truth.step(&self.command_n, dt_s)?;
        for ((rate, now), before) in self.rates_mps.iter_mut().zip(self.truth.true_lengths()).zip(&self.before_m) {
            *rate = (now - before) / dt_s;
        }
        Ok(())
    }

    /// What a cable's encoder shows (counts) `ahead_s` after the last step, at the rates of that step; the rate (counts/s).
    pub fn encoder(&self, cable: usize, ahead_s: f64) -> (i32, i32) {
        let (drum, channel) = (&self.drums[cable], &self.channels.channels()[cable]);
        let mut moved = self.rates_mps[cable] * ahead_s;
        if self.encoder_step_m > 0.0 {
            moved = (moved / self.encoder_step_m).round() * self.encoder_step_m;
        }
        let length = self.truth.lengths()[cable] + moved + drum.offset_m;
        let rate = -self.rates_mps[cable] / channel.length_quantum_m()
            * if channel.sense == Sense::Reverse { -1.0 } else { 1.0 };
        match drum.stuck {
            Some(counts) => (counts, 0),
            // Out of the counter's range only if the arm has left the finite numbers, which `advance` reports.
            None => (channel.encode_length(length).unwrap_or(i32::MAX), rate.round() as i32),
        }
    }

    /// Torque that a cable's drive reports (per mille of rated torque): its own, or that of the braked drum.
    pub fn torque(&self, cable: usize, own_permille: i16) -> i16 {
        let channel = &self.channels.channels()[cable];
        self.drums[cable]
            .held_n
            .and_then(|held| channel.encode_tension(held))
            .map_or(own_permille, |(torque, _)| torque)
            .saturating_add(extra(channel, self.drums[cable].extra_n))
    }

    /// Breaks what is between a drive and its cable; what a fault does to the drive itself is not the rig's.
    pub fn break_drum(&mut self, cable: usize, kind: FaultKind) {
        match kind {
            FaultKind::Stick => self.drums[cable].stuck = Some(self.encoder(cable, 0.0).0),
            FaultKind::Jump(by_m) => self.drums[cable].offset_m += by_m,
            FaultKind::Pull(by_n) => self.drums[cable].extra_n += by_n,
            FaultKind::Silence | FaultKind::Press | FaultKind::Trip | FaultKind::Dead | FaultKind::Reboot => {}
        }
    }

    /// Simulated time (s).
    pub fn time_s(&self) -> f64 {
        self.time_s
    }

    /// Time since the first drive was enabled (s).
    pub fn since_enabled_s(&self) -> Option<f64> {
        self.enabled_at_s.map(|at| self.time_s - at)
    }

    /// Number of brakes that hold.
    pub fn braked(&self) -> usize {
        self.drums.iter().filter(|drum| drum.held_n.is_some()).count()
    }

    /// Tensions that the drums are told to have (N): the drives' torque, or what a brake holds.
    pub fn commands_n(&self) -> &[f64] {
        &self.command_n
    }

    /// The arm as it is.
    pub fn truth(&self) -> &Truth {
        &self.truth
    }
}

/// Torque (per mille of rated torque) of a tension (N) of either sign, unlimited.
fn extra(channel: &MotorChannel, tension_n: f64) -> i16 {
    let sign = if channel.sense == Sense::Reverse { -1.0 } else { 1.0 };
    (sign * tension_n / channel.tension_quantum_n()).round() as i16
}
