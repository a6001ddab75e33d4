//! The cycle with the real observer and the real planner around an arm that is only seen through its encoders.
#![allow(clippy::unwrap_used)] // helpers of tests
#[path = "support/control.rs"]
mod rig;

use rand::SeedableRng;
use rand_xoshiro::Xoshiro256PlusPlus;
use rig::*;
use sinew::control::*;
use sinew::estimator::Observer;
use sinew::model::Arm;

/// Encoder step (m).
const STEP_M: f64 = 2e-5;

/// An arm 5 % softer and 20 % more damped than the model, encoders in steps, drives that come up when told.
struct World {
    cycle: Cycle<Observer>,
    truth: Mirror,
    arm: Arm,
    obstacles: ObstaclePair,
    target: Option<TargetInput>,
    drives: DrivesInput,
    silent: Option<usize>,
    tick: u64,
    rng: Xoshiro256PlusPlus,
}

impl World {
    fn new() -> Self {
        let mut settings = settings();
        settings.observer.settle_timeout_s = 20.0;
        let mut truth = settings.arm.clone();
        for segment in &mut truth.segments {
            segment.bending_stiffness_nm2 *= 0.95;
            segment.damping_stiffness_s *= 1.2;
        }
        let observer = Observer::new(&settings.arm, &settings.observer, PERIOD_S);
        Self {
            cycle: Cycle::new(&settings, observer),
            arm: Arm::new(&truth),
            truth: Mirror::new(&truth),
            obstacles: ObstaclePair::new(),
            target: None,
            drives: DrivesInput { phase: DrivesPhase::Off, ready: true, fault: None, bus_lost: None },
            silent: None,
            tick: 0,
            rng: Xoshiro256PlusPlus::seed_from_u64(1),
        }
    }

    fn step(&mut self, request: Option<Request>) {
        let mut lengths = vec![0.0; 24];
        self.arm.cable_lengths_into(&self.truth.state().q, &mut lengths);
        lengths.iter_mut().for_each(|l| *l = (*l / STEP_M).round() * STEP_M);
        let mut valid = CableMask::first(24);
        self.silent.into_iter().for_each(|cable| valid.remove(cable));
        self.tick += 1;
        let now_ns = self.tick * PERIOD_NS;
        let inputs = TickInputs {
            tick: self.tick,
            now_ns,
            missed: 0,
            encoders: EncoderReadings { lengths_m: &lengths, valid, capture_ns: now_ns },
            tensions_measured_n: &[],
            obstacles: &self.obstacles,
            demand: ObstacleDemand::Proceed,
            target: self.target,
            drives: self.drives,
            request,
        };
        let out = self.cycle.tick(&inputs, &mut self.rng, &mut || false);
        self.cycle.report(&inputs);
        let on = out.drives == DrivesCommand::On;
        self.drives.phase = if on { DrivesPhase::Enabled } else { DrivesPhase::Off };
        self.truth.update(self.cycle.tensions_n(), &[]).unwrap();
    }

    /// Where the arm's tip truly is (m).
    fn true_tip(&self) -> nalgebra::Vector3<f64> {
        let state = self.truth.state();
        self.arm.tip(&state.q, &state.qd).position
    }

    /// Tracks a point that begins to move at 20 mm/s; the largest error of the true tip (m) after the first second.
    fn follow_line(&mut self, ticks: u32) -> f64 {
        let (v, z, mut worst) = (0.02, -2.74, 0.0f64);
        self.target = Some(tip([0.0, 0.0, z], [0.0; 3]));
        self.step(Some(Request::Track));
        (0..300).for_each(|_| self.step(None));
        for k in 0..ticks {
            let x = v * PERIOD_S * f64::from(k);
            self.target = Some(tip([x, 0.0, z], [v, 0.0, 0.0]));
            self.step(None);
            // The straight arm cannot shorten at first order: it needs a moment to bend.
            if k >= 100 {
                worst = worst.max((self.true_tip() - nalgebra::Vector3::new(x, 0.0, z)).norm());
            }
        }
        worst
    }

    fn arm(&mut self) {
        self.step(Some(Request::Arm));
        for _ in 0..1000 {
            self.step(None);
            if self.cycle.mode() == Mode::Holding {
                return;
            }
        }
        panic!("no hold: {:?}", self.cycle.supervisor().latch());
    }
}

#[test]
fn the_true_tip_follows_a_moving_target_through_encoders_and_observer() {
    let mut world = World::new();
    world.arm();
    let worst = world.follow_line(500);
    assert_eq!(world.cycle.mode(), Mode::Tracking, "{:?}", world.cycle.supervisor().latch());
    assert!(worst < 0.002, "true tip error {worst} m");
    let record = world.cycle.record_mut();
    assert!(record.innovation_max_rad < 0.05 && record.disturbance_nm[0].is_finite());
}

#[test]
fn a_silent_encoder_in_motion_ends_in_a_fault_and_safe_tensions() {
    let mut world = World::new();
    world.arm();
    world.follow_line(100);
    world.silent = Some(9);
    (0..6).for_each(|_| world.step(None));
    let fault = world.cycle.supervisor().latch().first.map(|latched| latched.fault);
    assert!(matches!(fault, Some(Fault::EncoderSilent { cable: 9, .. })), "{fault:?}");
    (0..50).for_each(|_| world.step(None));
    assert_eq!(world.cycle.tensions_n(), [0.0; 24]);
    assert_eq!(world.cycle.mode(), Mode::Faulted);
}
