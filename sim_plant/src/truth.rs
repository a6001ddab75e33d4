//! The arm itself, simulated: what the controller never sees but through its encoders.
//!
//! Enters: the arm's configuration, how the real arm differs from it, and tensions tick by tick. Leaves: cable lengths
//! as the encoders show them, and, for judging only, the true pose. It must never read a clock or a random source of
//! its own: a seed gives the same motion bit for bit.
//!
//! It runs the controller's model code on another arm: a finer mesh, another step, perturbed stiffness, damping and
//! masses, tensions that are off, friction. What a refined mesh means: every element becomes `mesh_refinement` elements
//! and every disk as many lighter disks of the same total mass, each with its holes. The cables thus follow the bent
//! backbone more closely than the controller's model believes, which is one of the differences that it has to bear.
//!
//! Friction (capstan): a cable's tension changes by `exp(-mu angle)` along its route, `angle` being the bend that it has
//! passed, and falls where the cable is pulled in, rises where it pays out. The direction is the smoothed sign of the
//! cable's rate, `tanh(-rate / FRICTION_SPEED)`, taken at the start of a step and followed with a lag of
//! [`FRICTION_TIME_S`]: presliding of a real cable, and what keeps an explicit friction stable. Each passage of a cable
//! through an element is then a cable of its own to the model, with the tension that is left there.

use nalgebra::{Vector3, Vector4};
use rand::{RngExt, SeedableRng};
use rand_distr::{Distribution, StandardNormal};
use rand_xoshiro::Xoshiro256PlusPlus;
use serde::Serialize;
use sinew::config::{ArmConfig, Config, Scale};
use sinew::integrator::{Scheme, StaticsError, StepError, Stepper, equilibrium};
use sinew::model::{Arm, State};
use std::collections::VecDeque;

/// Cable rate (m/s) at which friction has three quarters of its full size.
pub const FRICTION_SPEED_MPS: f64 = 1e-3;
/// Lag with which the direction of friction follows the cable (s).
pub const FRICTION_TIME_S: f64 = 0.02;
/// Encoder's step over the arm's length: 0.02 mm on the paper's.
const ENCODER_STEP: f64 = 2e-5 / 2.75;
/// Least number of integration steps in the arm's first period.
const STEPS_OF_PERIOD: f64 = 200.0;
/// Newton iterations of one step; three or four are usual.
const ITERATIONS_MAX: usize = 12;

/// How the true arm differs from the controller's model of it.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct TruthSettings {
    /// Elements per element of the arm's configuration.
    pub mesh_refinement: usize,
    /// Integration step (s).
    pub step_s: f64,
    /// EI and GJ over the arm's.
    pub stiffness_factor: f64,
    /// Damping over the arm's.
    pub damping_factor: f64,
    /// Disk mass over the arm's.
    pub disk_mass_factor: f64,
    /// Each cable's tension is off by a constant factor within `1 +- this`, drawn from the seed.
    pub tension_error_max: f64,
    /// Resolution of cable lengths (m); 0 for none.
    pub encoder_step_m: f64,
    /// Standard deviation of noise on cable lengths before they are rounded (m).
    pub encoder_noise_m: f64,
    /// Capstan friction coefficient mu.
    pub capstan_friction: f64,
    /// Calls of [`Truth::step`] by which commands take effect late.
    pub latency_ticks: usize,
    /// Point mass at the tip beside the configured payload (kg).
    pub extra_payload_kg: f64,
    /// Seed of tension errors and noise.
    pub seed: u64,
}

impl TruthSettings {
    /// The plant of the closed-loop study.
    pub fn study(seed: u64) -> Self {
        Self {
            mesh_refinement: 2,
            step_s: 0.005,
            stiffness_factor: 0.95,
            damping_factor: 1.2,
            disk_mass_factor: 1.05,
            tension_error_max: 0.03,
            encoder_step_m: 2e-5,
            encoder_noise_m: 0.0,
            capstan_friction: 0.0,
            latency_ticks: 0,
            extra_payload_kg: 0.0,
            seed,
        }
    }

    /// The same for any arm: the encoders' steps are the same part of its length as the study's of the paper's, and the
    /// integration's are a part of the loop's period, at most the study's and a two-hundredth of the arm's first period.
    pub fn study_of(config: &Config, seed: u64) -> Self {
        let (study, scale) = (Self::study(seed), Scale::of(&config.arm));
        let period_s = config.timing.period_s;
        let most_s = (std::f64::consts::TAU / scale.omega_radps / STEPS_OF_PERIOD).min(study.step_s).min(period_s);
        Self {
            step_s: period_s / (period_s / most_s - 1e-9).ceil(),
            encoder_step_m: ENCODER_STEP * scale.length_m,
            ..study
        }
    }

    /// The controller's own model, with perfect drives and encoders.
    pub fn ideal(step_s: f64) -> Self {
        Self {
            mesh_refinement: 1,
            step_s,
            stiffness_factor: 1.0,
            damping_factor: 1.0,
            disk_mass_factor: 1.0,
            tension_error_max: 0.0,
            encoder_step_m: 0.0,
            encoder_noise_m: 0.0,
            capstan_friction: 0.0,
            latency_ticks: 0,
            extra_payload_kg: 0.0,
            seed: 0,
        }
    }
}

/// Pose of the tip.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct TipPose {
    /// Position (m, base frame).
    pub position: Vector3<f64>,
    /// Quaternion (body to base).
    pub quaternion: Vector4<f64>,
}

/// The simulated arm.
#[derive(Debug, Clone)]
pub struct Truth {
    config: ArmConfig,
    arm: Arm,
    settings: TruthSettings,
    scheme: Scheme,
    stepper: Stepper,
    state: State,
    next: State,
    rng: Xoshiro256PlusPlus,
    /// Factor on each commanded tension.
    gain: Vec<f64>,
    /// Cable of each of the model's cables: itself, or with friction the cable whose passage it is.
    cable_of: Vec<usize>,
    /// Constant part of each cable's length that the passages do not hold (m).
    constant: Vec<f64>,
    /// Element of each passage, for friction.
    element_of: Vec<usize>,
    /// Strain for a newton (1/N) and feed (m) of each cable.
    stretch: Vec<(f64, f64)>,
    /// Direction of each cable: 1 pulled in, -1 paying out.
    direction: Vec<f64>,
    commands: VecDeque<Vec<f64>>,
    applied: Vec<f64>,
    tension: Vec<f64>,
    leg: Vec<f64>,
    length: Vec<f64>,
    shown: Vec<f64>,
}

impl Truth {
    /// Builds the arm, straight and at rest. Allocates.
    pub fn new(arm: &ArmConfig, settings: &TruthSettings) -> Self {
        let cables = arm.cable_count();
        let config = perturbed(arm, settings);
        let mut model = Arm::new(&config);
        let mut constant = vec![0.0; cables];
        let mut cable_of: Vec<usize> = (0..cables).collect();
        let mut element_of = Vec::new();
        let stretch = model.cable_compliance.iter().copied().zip(model.cable_feed.iter().copied()).collect();
        if settings.capstan_friction > 0.0 {
            constant = std::mem::take(&mut model.cable_constant);
            (cable_of, element_of) = split_cables(&mut model);
        }
        let mut rng = Xoshiro256PlusPlus::seed_from_u64(settings.seed);
        let e = settings.tension_error_max;
        let gain = (0..cables).map(|_| 1.0 + if e > 0.0 { rng.random_range(-e..=e) } else { 0.0 }).collect();
        let state = State::at_rest(model.straight());
        let legs = model.cable_count();
        let mut made = Self {
            scheme: Scheme::new(config.rho_inf),
            stepper: Stepper::new(&model),
            next: state.clone(),
            state,
            rng,
            gain,
            cable_of,
            constant,
            element_of,
            stretch,
            direction: vec![0.0; cables],
            commands: VecDeque::with_capacity(settings.latency_ticks + 1),
            applied: vec![0.0; cables],
            tension: vec![0.0; legs],
            leg: vec![0.0; legs],
            length: vec![0.0; cables],
            shown: vec![0.0; cables],
            settings: settings.clone(),
            arm: model,
            config,
        };
        made.command_at_rest(&vec![0.0; cables]);
        made.measure();
        made
    }

    /// Rests in the equilibrium under commanded tensions `u` (N) that is nearest to a chain of constant curvatures
    /// (1/m; `(y, z)` segment by segment), which choose the branch. Allocates.
    ///
    /// # Errors
    /// No equilibrium was reached.
    pub fn start_at_equilibrium(&mut self, u: &[f64], curvatures: &[f64]) -> Result<(), StaticsError> {
        self.command_at_rest(u);
        self.direction.fill(0.0);
        self.applied.copy_from_slice(u);
        self.load();
        self.state = State::at_rest(self.arm.bent(curvatures));
        equilibrium(&self.arm, &mut self.stepper, &self.tension, &mut self.state)?;
        self.measure();
        Ok(())
    }

    /// Advances by `dt_s` under the commanded tensions `u` (N), in steps of at most the configured one, and measures.
    ///
    /// # Errors
    /// The integration failed; the arm and what the encoders show stay as they were before the call, also if only a later
    /// one of its steps failed. The command counts as given.
    pub fn step(&mut self, u: &[f64], dt_s: f64) -> Result<(), StepError> {
        let before = (self.state.clone(), self.direction.clone());
        let stepped = self.integrate(u, dt_s);
        match stepped {
            Ok(()) => self.measure(),
            Err(_) => (self.state, self.direction) = before,
        }
        stepped
    }

    fn integrate(&mut self, u: &[f64], dt_s: f64) -> Result<(), StepError> {
        self.commands.push_back(u.to_vec());
        if let Some(command) = self.commands.pop_front() {
            self.applied.copy_from_slice(&command);
        }
        let steps = (dt_s / self.settings.step_s - 1e-9).ceil().max(1.0);
        let eta = dt_s / steps;
        for _ in 0..steps as usize {
            self.follow_direction(eta);
            self.load();
            let report = self.stepper.step(
                &self.arm,
                &self.scheme,
                eta,
                &self.state,
                &self.tension,
                ITERATIONS_MAX,
                &mut self.next,
            )?;
            if !report.converged && report.correction > 1e-6 {
                return Err(StepError::Diverged);
            }
            std::mem::swap(&mut self.state, &mut self.next);
        }
        Ok(())
    }

    /// Cable lengths (m) as the encoders show them: those let out by the drums, unstretched, noisy where configured, rounded to the encoder's step.
    pub fn lengths(&self) -> &[f64] {
        &self.shown
    }

    /// Cable lengths (m) as they are.
    pub fn true_lengths(&self) -> &[f64] {
        &self.length
    }

    /// Tensions (N) that act at the drives: the command in effect times the drives' error.
    pub fn drive_tensions(&self) -> impl Iterator<Item = f64> + '_ {
        self.applied.iter().zip(&self.gain).map(|(u, g)| u * g)
    }

    /// True pose of the tip.
    pub fn tip(&self) -> TipPose {
        let (position, quaternion) = self.arm.pose(&self.state.q, self.arm.node_count());
        TipPose { position, quaternion }
    }

    /// True average curvatures (1/m), `(y, z)` segment by segment. Allocates.
    pub fn curvatures(&self) -> Vec<f64> {
        let mut k = vec![0.0; 2 * self.arm.segment_count()];
        let mut kd = k.clone();
        self.arm.curvatures_into(&self.state.q, &self.state.qd, &mut k, &mut kd);
        k
    }

    /// Positions (m) and tangents of the nodes 0..=N of [`Truth::config`]'s mesh, for measuring distances.
    pub fn frames_into(&self, positions: &mut [Vector3<f64>], tangents: &mut [Vector3<f64>]) {
        self.arm.frames_into(&self.state.q, positions, tangents);
    }

    /// The perturbed arm's configuration.
    pub fn config(&self) -> &ArmConfig {
        &self.config
    }

    /// True state, on the mesh of [`Truth::config`].
    pub fn state(&self) -> &State {
        &self.state
    }

    /// Kinetic and elastic energy (J).
    pub fn energy(&self) -> f64 {
        self.arm.kinetic_energy(&self.state.q, &self.state.qd) + self.arm.elastic_energy(&self.state.q)
    }

    fn command_at_rest(&mut self, u: &[f64]) {
        self.commands.clear();
        for _ in 0..self.settings.latency_ticks {
            self.commands.push_back(u.to_vec());
        }
    }

    /// Tensions of the model's cables from the command in effect.
    fn load(&mut self) {
        let drive = |c: usize| self.applied[c] * self.gain[c];
        if self.element_of.is_empty() {
            for (c, t) in self.tension.iter_mut().enumerate() {
                *t = drive(c);
            }
            return;
        }
        let mu = self.settings.capstan_friction;
        let bend: Vec<f64> = (0..self.arm.elements.len())
            .map(|i| {
                let k = self.arm.element_curvature(&self.state.q, &self.state.qd, i).0;
                k[1].hypot(k[2]) * self.arm.elements[i].length
            })
            .collect();
        // Passages come in the order of elements: the angle passed adds up cable by cable.
        let mut passed = vec![0.0; self.applied.len()];
        for (leg, t) in self.tension.iter_mut().enumerate() {
            let c = self.cable_of[leg];
            let own = bend[self.element_of[leg]];
            let angle = passed[c] + own / 2.0;
            passed[c] += own;
            *t = drive(c) * (-mu * angle * self.direction[c]).exp();
        }
    }

    fn follow_direction(&mut self, eta: f64) {
        if self.element_of.is_empty() {
            return;
        }
        self.arm.cable_rates_into(&self.state.q, &self.state.qd, &mut self.leg);
        let mut rate = vec![0.0; self.direction.len()];
        for (leg, v) in self.leg.iter().enumerate() {
            rate[self.cable_of[leg]] += v;
        }
        let share = eta / (eta + FRICTION_TIME_S);
        for (d, v) in self.direction.iter_mut().zip(&rate) {
            *d += share * ((-v / FRICTION_SPEED_MPS).tanh() - *d);
        }
    }

    fn measure(&mut self) {
        self.arm.cable_lengths_into(&self.state.q, &mut self.leg);
        self.length.copy_from_slice(&self.constant);
        for (leg, l) in self.leg.iter().enumerate() {
            self.length[self.cable_of[leg]] += l;
        }
        // What the drums have let out: each passage stretches by the tension that is left there.
        self.load();
        self.shown.copy_from_slice(&self.length);
        for c in 0..self.shown.len() {
            let (compliance, feed) = self.stretch[c];
            if compliance > 0.0 {
                let tension = self.applied[c] * self.gain[c];
                self.shown[c] = (self.constant[c] + feed) / (1.0 + compliance * tension) - feed;
            }
        }
        for (leg, l) in self.leg.iter().enumerate() {
            let c = self.cable_of[leg];
            let (compliance, _) = self.stretch[c];
            if compliance > 0.0 {
                self.shown[c] += l / (1.0 + compliance * self.tension[leg]);
            }
        }
        let (step, noise) = (self.settings.encoder_step_m, self.settings.encoder_noise_m);
        for shown in &mut self.shown {
            if noise > 0.0 {
                let n: f64 = StandardNormal.sample(&mut self.rng);
                *shown += noise * n;
            }
            if step > 0.0 {
                *shown = (*shown / step).round() * step;
            }
        }
    }
}

/// The arm with the settings' factors and mesh; a disk's mass is shared by the disks that it becomes.
fn perturbed(arm: &ArmConfig, settings: &TruthSettings) -> ArmConfig {
    let mut config = arm.clone();
    let refinement = settings.mesh_refinement.max(1);
    for segment in &mut config.segments {
        segment.elements *= refinement;
        segment.bending_stiffness_nm2 *= settings.stiffness_factor;
        segment.torsional_stiffness_nm2 *= settings.stiffness_factor;
        segment.damping_stiffness_s *= settings.damping_factor;
        segment.disk_mass_kg *= settings.disk_mass_factor / refinement as f64;
    }
    config.payload.mass_kg += settings.extra_payload_kg;
    config
}

/// Makes every passage a cable of its own; returns the cable and the element of each.
fn split_cables(arm: &mut Arm) -> (Vec<usize>, Vec<usize>) {
    let (mut cable_of, mut element_of) = (Vec::new(), Vec::new());
    for (i, element) in arm.elements.iter().enumerate() {
        for pass in &mut arm.passes[element.passes.clone()] {
            element_of.push(i);
            cable_of.push(pass.cable);
            pass.cable = cable_of.len() - 1;
        }
    }
    arm.cable_constant = vec![0.0; cable_of.len()];
    arm.cable_elements = element_of.iter().map(|&i| i..i + 1).collect();
    for own in [&mut arm.cable_compliance, &mut arm.cable_feed] {
        *own = cable_of.iter().map(|&c| own[c]).collect();
    }
    arm.cable_segment = cable_of.iter().map(|&c| arm.cable_segment[c]).collect();
    (cable_of, element_of)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn pull() -> Vec<f64> {
        (0..24).map(|c| 15.0 + 12.0 * (c as f64).sin()).collect()
    }

    #[test]
    fn with_the_models_own_parameters_it_is_the_models_own_integration() {
        let config = ArmConfig::paper();
        let mut truth = Truth::new(&config, &TruthSettings::ideal(0.005));
        let arm = Arm::new(&config);
        let (mut stepper, scheme) = (Stepper::new(&arm), Scheme::new(config.rho_inf));
        let mut state = State::at_rest(arm.straight());
        let mut next = state.clone();
        let mut lengths = vec![0.0; 24];
        for _ in 0..50 {
            truth.step(&pull(), 0.01).unwrap();
            for _ in 0..2 {
                stepper.step(&arm, &scheme, 0.005, &state, &pull(), ITERATIONS_MAX, &mut next).unwrap();
                std::mem::swap(&mut state, &mut next);
            }
            assert_eq!(truth.state(), &state);
        }
        arm.cable_lengths_into(&state.q, &mut lengths);
        assert_eq!(truth.lengths(), &lengths[..]);
    }

    #[test]
    fn a_seed_gives_the_same_motion_bit_for_bit_and_another_seed_another() {
        let run = |seed| {
            let mut settings = TruthSettings::study(seed);
            settings.encoder_noise_m = 1e-5;
            settings.capstan_friction = 0.1;
            let mut truth = Truth::new(&ArmConfig::paper(), &settings);
            (0..20).for_each(|_| truth.step(&pull(), 0.01).unwrap());
            (truth.lengths().to_vec(), truth.state().clone())
        };
        assert_eq!(run(3), run(3));
        assert_ne!(run(3).1.q, run(4).1.q);
    }

    #[test]
    fn encoders_show_whole_steps_and_drives_stay_within_their_error() {
        let mut truth = Truth::new(&ArmConfig::paper(), &TruthSettings::study(5));
        (0..10).for_each(|_| truth.step(&pull(), 0.01).unwrap());
        for (shown, true_length) in truth.lengths().iter().zip(truth.true_lengths()) {
            assert!((shown - true_length).abs() <= 1.0001e-5);
            assert!((shown / 2e-5 - (shown / 2e-5).round()).abs() < 1e-6);
        }
        let mut different = 0;
        for (sent, acts) in pull().iter().zip(truth.drive_tensions()) {
            assert!((acts / sent - 1.0).abs() <= 0.03);
            different += usize::from((acts / sent - 1.0).abs() > 0.003);
        }
        assert!(different > 12);
    }

    #[test]
    fn commands_take_effect_after_their_latency() {
        let mut settings = TruthSettings::ideal(0.005);
        settings.latency_ticks = 2;
        let mut truth = Truth::new(&ArmConfig::paper(), &settings);
        let straight = truth.state().q.clone();
        for tick in 0..3 {
            truth.step(&pull(), 0.01).unwrap();
            let moved = truth.state().q.iter().zip(&straight).any(|(a, b)| (a - b).abs() > 1e-9);
            assert_eq!(moved, tick == 2, "tick {tick}");
        }
    }

    #[test]
    fn a_step_that_fails_on_its_way_leaves_the_arm_where_it_was() {
        let mut settings = TruthSettings::study(1);
        settings.capstan_friction = 0.1;
        let mut truth = Truth::new(&ArmConfig::paper(), &settings);
        (0..5).for_each(|_| truth.step(&pull(), 0.01).unwrap());
        // Tensions that the integrator survives for its first step of 5 ms and not for twenty.
        let (sound, mad) = (truth.clone(), |factor: f64| pull().iter().map(|u| factor * u).collect::<Vec<f64>>());
        let fails_later = |factor: &f64| {
            let once = sound.clone().step(&mad(*factor), 0.005).is_ok();
            once && sound.clone().step(&mad(*factor), 0.1).is_err()
        };
        let factor = (0..40).map(|n| 1.5_f64.powi(n)).find(fails_later).expect("no such tension");
        truth.step(&mad(factor), 0.1).unwrap_err();
        assert_eq!(truth.state(), sound.state());
        assert_eq!((truth.lengths(), truth.true_lengths()), (sound.lengths(), sound.true_lengths()));
        assert_eq!(truth.direction, sound.direction);
        truth.step(&pull(), 0.01).unwrap();
    }

    #[test]
    fn a_finer_mesh_keeps_the_masses_and_a_released_arm_loses_energy() {
        let config = ArmConfig::paper();
        let mass = |c: &ArmConfig| Arm::new(c).nodes.iter().map(|n| n.mass).sum::<f64>();
        let mut settings = TruthSettings::ideal(0.005);
        settings.mesh_refinement = 3;
        // The last node carries half an element of backbone, so the backbone's share depends a little on the mesh.
        let fine = Truth::new(&config, &settings);
        assert!((mass(fine.config()) / mass(&config) - 1.0).abs() < 2e-3);
        let mut truth = Truth::new(&config, &TruthSettings::study(1));
        truth.start_at_equilibrium(&pull(), &[0.0; 8]).unwrap();
        let mut energy = truth.energy();
        assert!(energy > 0.01);
        for _ in 0..100 {
            truth.step(&[0.0; 24], 0.01).unwrap();
            assert!(truth.energy() <= energy * (1.0 + 1e-6) + 1e-12);
            energy = truth.energy();
        }
    }

    #[test]
    fn drums_tell_what_they_let_out_and_the_arm_has_what_that_stretches_to() {
        let mut config = ArmConfig::paper();
        for segment in &mut config.segments {
            (segment.cable_stiffness_n, segment.cable_feed_m) = (Some(3e4), 0.8);
        }
        for friction in [0.0, 0.1] {
            let mut settings = TruthSettings::ideal(0.005);
            settings.capstan_friction = friction;
            let mut truth = Truth::new(&config, &settings);
            truth.start_at_equilibrium(&pull(), &[0.0; 8]).unwrap();
            let model = Arm::new(&config);
            for c in 0..24 {
                let want = model.at_drum(c, truth.true_lengths()[c], pull()[c]);
                let stretched = truth.true_lengths()[c] - truth.lengths()[c];
                assert!(stretched > 1e-5 && stretched < 3e-3);
                // Nothing moved: friction holds nothing back.
                assert!((truth.lengths()[c] - want).abs() < 1e-12, "{c} {friction}");
            }
        }
    }

    #[test]
    fn friction_without_bend_changes_nothing_and_in_a_bent_arm_it_slows_the_bending() {
        let config = ArmConfig::paper();
        let mut settings = TruthSettings::ideal(0.005);
        let even = vec![30.0; 24];
        let bend: Vec<f64> = (0..24).map(|c| if c % 6 == 1 { 40.0 } else { 5.0 }).collect();
        let run = |settings: &TruthSettings, start: f64, u: &[f64]| {
            let mut truth = Truth::new(&config, settings);
            truth.start_at_equilibrium(&bend.iter().map(|u| start * u).collect::<Vec<_>>(), &[0.0; 8]).unwrap();
            let before: f64 = truth.curvatures().iter().map(|k| k.abs()).sum();
            (0..20).for_each(|_| truth.step(u, 0.01).unwrap());
            (truth.curvatures().iter().map(|k| k.abs()).sum::<f64>() - before, truth.true_lengths().to_vec())
        };
        let pulled: Vec<f64> = bend.iter().map(|u| 1.3 * u).collect();
        let free = run(&settings, 1.0, &pulled).0;
        settings.capstan_friction = 0.1;
        let held = run(&settings, 1.0, &pulled).0;
        // The loaded cables turn by about 0.25 rad: capstan takes 2.5 % of 52 N at the far end, half of it on average,
        // from an increment of 12 N, which is 5 % of the movement.
        assert!(free > 0.05 && held > 0.0 && held < 0.97 * free, "{held} of {free}");
        let (curvature, split) = run(&settings, 0.0, &even);
        assert!(curvature.abs() < 1e-9);
        settings.capstan_friction = 0.0;
        let whole = run(&settings, 0.0, &even).1;
        assert!(split.iter().zip(&whole).all(|(a, b)| (a - b).abs() < 1e-9));
    }
}
