//! The control thread's claim: after start-up a cycle allocates nothing, in any mode, branch or fault.
#![allow(clippy::unwrap_used, clippy::expect_used, clippy::print_stdout)] // a test may panic and print
#[path = "support/control.rs"]
mod rig;

use assert_no_alloc::{AllocDisabler, assert_no_alloc};
use rand_xoshiro::Xoshiro256PlusPlus;
use rig::*;
use sinew::collision::Shape;
use sinew::config::ShapeConfig;
use sinew::control::*;
use sinew::planner::{Branch, Deadline, Inputs, Report};

#[global_allocator]
static GUARD: AllocDisabler = AllocDisabler;

/// Ticks of the claim.
const TICKS: u64 = 10_000;

/// What a run went through: a claim about branches that never ran would be empty.
#[derive(Debug, Default)]
struct Seen {
    modes: [bool; 7],
    safe: bool,
    warning: bool,
    sweeps: usize,
    faults: u32,
    bridged: bool,
    late: bool,
}

impl Seen {
    fn note(&mut self, rig: &mut Rig) {
        let record = rig.cycle.record_mut();
        self.modes[record.mode as usize] = true;
        if let Some(plan) = record.plan {
            self.safe |= plan.branch == Branch::Safe;
            self.warning |= plan.branch == Branch::Warning;
            self.sweeps += plan.sweeps;
        }
        self.faults = self.faults.max(record.fault_count);
        self.bridged |= record.limits.contains(Limit::EncoderBridged);
        self.late |= record.limits.contains(Limit::OverrunHold);
    }
}

/// One tick of a day in the life of an arm, 2,000 ticks long: arm, hold, track a moving tip among moving obstacles, a
/// shape, home, a lost client, missed deadlines, ticks left out, missing readings, a fault, clear, stop, disarm.
fn live(rig: &mut Rig, seen: &mut Seen) {
    if rig.tick % 2000 == 950 {
        rig.tick += 7;
    }
    let k = rig.tick % 2000;
    let t = k as f64 * PERIOD_S;
    let x = 0.28 + 0.1 * (0.5 * t).cos();
    // In the evening they are far away.
    let away = if k < 1200 { 0.0 } else { 0.5 };
    rig.move_to(0, [x + away, 0.05, -2.1], [-0.05 * (0.5 * t).sin(), 0.0, 0.0]);
    rig.move_to(1, [-0.25 - away, 0.0, -1.5], [0.0; 3]);
    rig.target = Some(match k {
        0..600 => tip([0.08 * (0.4 * t).sin(), 0.05, -2.72], [0.032 * (0.4 * t).cos(), 0.0, 0.0]),
        _ => shape([0.2, 0.1, -0.2, 0.0, 0.1, 0.1, 0.0, 0.2]),
    });
    rig.missed = u32::from((900..905).contains(&k));
    rig.valid = CableMask::first(24);
    if (1000..1003).contains(&k) || (1500..1520).contains(&k) {
        rig.valid.remove(5);
    }
    rig.demand = if k == 1100 { ObstacleDemand::Hold { source: 1 } } else { ObstacleDemand::Proceed };
    let request = match k {
        1 => Some(Request::Arm),
        150 | 700 | 1150 => Some(Request::Track),
        800 => Some(Request::Hold),
        850 | 1300 => Some(Request::Home),
        1650 => Some(Request::Clear),
        1700 => Some(Request::Arm),
        1850 => Some(Request::Stop),
        1950 => Some(Request::Disarm),
        _ => None,
    };
    rig.step(request);
    seen.note(rig);
}

#[test]
fn ten_thousand_ticks_of_the_cycle_do_not_allocate() {
    let mut rig = Rig::real(&settings(), 42);
    rig.ball(1, 0.1, [0.38, 0.05, -2.1]);
    let corners = [[0.1, 0.0, 0.0], [-0.1, 0.0, 0.0], [0.0, 0.1, 0.0], [0.0, -0.1, 0.0], [0.0, 0.0, 0.1]];
    let hull = Shape::new(&ShapeConfig::Hull { points_m: corners.to_vec() }).unwrap();
    let index = rig.obstacles.insert(2, &hull).unwrap();
    rig.move_to(index, [-0.25, 0.0, -1.5], [0.0; 3]);
    let mut seen = Seen::default();
    assert_no_alloc(|| (0..TICKS).for_each(|_| live(&mut rig, &mut seen)));
    assert_eq!(seen.modes, [true; 7], "every mode was lived through: {seen:?}");
    assert!(seen.safe && seen.warning && seen.sweeps > 0, "every branch planned: {seen:?}");
    assert!(seen.faults > 0 && seen.bridged && seen.late, "faults and limits acted: {seen:?}");
}

/// A planner that allocates, once.
struct Wasteful(Told);

impl Plan for Wasteful {
    fn plan(&mut self, i: &Inputs<'_>, rng: &mut Xoshiro256PlusPlus, deadline: &mut dyn Deadline) -> Report {
        self.0.tensions = self.0.tensions.clone();
        self.0.plan(i, rng, deadline)
    }

    fn tensions(&self) -> &[f64] {
        self.0.tensions()
    }
}

/// Not a test of its own: a cycle whose planner allocates, where that is forbidden.
#[test]
#[ignore = "run by `an_allocation_inside_the_cycle_is_detected`"]
fn a_wasteful_cycle_under_the_guard() {
    let settings = settings();
    let told = || Wasteful(Told::constant(10.0));
    let cycle = Cycle::with_planner(&settings, Mirror::new(&settings.arm), told());
    let mut rig = Rig::around(cycle, &settings.arm, 1);
    rig.arm();
    println!("armed");
    assert_no_alloc(|| rig.run(2));
    println!("unnoticed");
}

#[test]
fn an_allocation_inside_the_cycle_is_detected() {
    let probe = std::process::Command::new(std::env::current_exe().unwrap())
        .args(["--ignored", "--exact", "--nocapture", "a_wasteful_cycle_under_the_guard"])
        .output()
        .unwrap();
    let out = String::from_utf8_lossy(&probe.stdout);
    assert!(out.contains("armed"), "the probe did not get as far as the guard: {out}");
    assert!(!probe.status.success() && !out.contains("unnoticed"), "an allocation went unnoticed: {out}");
}
