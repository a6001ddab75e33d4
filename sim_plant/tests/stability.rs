//! What `sinew stability` says of a loop, against runs of it: the daemon's own cycle and the true arm of this crate, kicked at
//! where it is held.

#![allow(clippy::unwrap_used, clippy::expect_used)] // a test stops where it cannot go on
use nalgebra::Vector3;
use sim_plant::bench::Bench;
use sim_plant::follow::divided;
use sim_plant::truth::TruthSettings;
use sinew::config::Config;
use sinew::control::{Mode, Request, Settings, Target, TargetInput};
use sinew::stability::{Differs, Held, LoopMode, Place, Spectrum, random_posture};

/// Time (s) of a kick, and what one cable pulls meanwhile over what it is told.
const KICK_S: f64 = 0.3;

fn place(config: &Config, seed: u64) -> Place {
    let (curvatures, (position, quaternion)) = random_posture(config, seed);
    Place::Pose { position, quaternion, curvatures: Some(curvatures) }
}

fn light(beta_s: f64) -> Config {
    Config::load_changed(&[], |arm| arm.segments.iter_mut().for_each(|s| s.damping_stiffness_s = beta_s)).unwrap()
}

/// The loop at a place, as the tool sees it: what holds it there, and its least stable mode that swings.
fn told(config: &Config, place: &Place, differs: &Differs) -> (Held, Spectrum, LoopMode) {
    let held = Held::at(config, place).unwrap().with(differs).unwrap();
    let spectrum = Spectrum::of(config, &held).unwrap();
    let swings = spectrum.modes.iter().find(|m| m.frequency_hz > 0.05 && m.tension_npm.is_some()).unwrap().clone();
    (held, spectrum, swings)
}

/// Growth (1/s) of the true tip's swing along a mode between two times (s) after a kick of one cable by a share of its tension.
fn run(
    config: &Config,
    place: &Place,
    differs: &Differs,
    held: &Held,
    mode: &LoopMode,
    (kick, cable): (f64, usize),
    (from_s, to_s): (f64, f64),
) -> f64 {
    let mut settings = Settings::new(config);
    settings.supervision = settings.supervision.warning();
    settings.start_tensions_n = held.tensions_n().to_vec();
    let truth = TruthSettings {
        damping_factor: differs.damping,
        stiffness_factor: differs.stiffness,
        latency_ticks: config.observer.latency_ticks + differs.late_ticks,
        ..TruthSettings::ideal(0.005)
    };
    let mut bench = Bench::new(config, &settings, &truth);
    let curvatures = match place {
        Place::Rest => vec![0.0; 2 * config.arm.segments.len()],
        Place::Pose { curvatures, .. } => curvatures.clone().unwrap(),
        Place::Shape(k) => k.clone(),
    };
    bench.truth.start_at_equilibrium(&settings.start_tensions_n, &curvatures).unwrap();
    bench.arm(config.observer.settle_timeout_s + 10.0).unwrap();
    let mut request = None;
    if let Place::Pose { position, quaternion, .. } = place {
        let now = Target::Tip {
            position_m: *position,
            quaternion: *quaternion,
            velocity_mps: Vector3::zeros(),
            angular_velocity_radps: Vector3::zeros(),
        };
        bench.target = Some(TargetInput { now, ahead: None, weight: 0.0, sequence: 1, fresh: true });
        request = Some(Request::Track);
    }
    let begin = bench.time_s();
    let along = Vector3::from(mode.tip);
    let mut seen = Vec::new();
    while bench.time_s() < begin + to_s {
        let kicked = bench.time_s() < begin + KICK_S;
        bench.lies[cable].pull = if kicked { 1.0 + kick } else { 1.0 };
        let output = bench.step(request.take());
        assert!(matches!(output.mode, Mode::Holding | Mode::Tracking), "{:?}", bench.cycle.supervisor().latch().first);
        assert_eq!(bench.broken, None);
        seen.push(along.dot(&bench.truth.tip().position));
    }
    // Without what is slow: second differences over half a period keep a swing and take out a drift.
    let half = (0.5 / mode.frequency_hz / config.timing.period_s).round() as usize;
    let swing: Vec<f64> = (2 * half..seen.len()).map(|k| seen[k] - 2.0 * seen[k - half] + seen[k - 2 * half]).collect();
    let size = |at_s: f64| {
        let end = ((at_s / config.timing.period_s) as usize).min(seen.len()) - 2 * half;
        let window = &swing[end - 2 * half..end];
        (window.iter().map(|x| x * x).sum::<f64>() / window.len() as f64).sqrt()
    };
    (size(to_s) / size(from_s)).ln() / (to_s - from_s)
}

/// Runs a loop and compares: within a tenth, or where both are small 0.004 1/s.
fn compare(config: &Config, place: &Place, differs: &Differs, kick: f64, window_s: (f64, f64)) -> Spectrum {
    let (held, spectrum, mode) = told(config, place, differs);
    let shown = run(config, place, differs, &held, &mode, (kick, 0), window_s);
    let off = (shown - mode.growth_1ps).abs();
    assert!(off < (0.1 * mode.growth_1ps.abs()).max(0.004), "the run grows by {shown} 1/s, told was {mode:?}");
    spectrum
}

#[test]
fn where_the_loop_is_stable_a_kick_fades_as_told() {
    let config = light(0.05);
    let strongly_bent = compare(&config, &place(&config, 2), &Differs::NONE, 0.05, (40.0, 70.0));
    assert!(strongly_bent.is_stable());
    let late = Differs { late_ticks: 6, ..Differs::NONE };
    assert!(compare(&config, &place(&config, 1), &late, 0.05, (40.0, 70.0)).is_stable());
}

#[test]
fn where_it_is_not_stable_a_kick_grows_as_told() {
    let config = light(0.05);
    let late = Differs { late_ticks: 30, ..Differs::NONE };
    let spectrum = compare(&config, &Place::Rest, &late, 0.01, (3.5, 5.0));
    assert!(!spectrum.is_stable() && spectrum.growth_1ps() > 1.0, "{:?}", spectrum.modes[0]);
}

/// The first frequency says nothing of how many segments share it: what holds four of them made sixteen swing up.
#[test]
fn an_arm_of_many_segments_is_stable_straight_and_bent() {
    for count in [8, 12, 16] {
        let config = Config::of_arm(&divided(count, &[30.0, 150.0, 270.0]), None).unwrap();
        let bends: Vec<f64> = (0..count).flat_map(|s| [0.4, if 2 * s < count { -1.2 } else { 0.3 }]).collect();
        for place in [Place::Rest, Place::Shape(bends)] {
            let spectrum = Spectrum::of(&config, &Held::at(&config, &place).unwrap()).unwrap();
            assert!(spectrum.is_stable(), "{count} segments, {place:?}: {:?}", spectrum.modes[0]);
        }
    }
    let three = [30.0, 150.0, 270.0];
    let mut unequal = divided(10, &three);
    unequal.segments[..4].iter_mut().for_each(|s| (s.length_m, s.elements) = (0.45, 4));
    unequal.segments[4..].iter_mut().for_each(|s| s.length_m = 0.1);
    let mut long = divided(16, &three);
    long.segments.iter_mut().for_each(|s| s.length_m *= 2.0);
    let six = divided(16, &[0.0, 60.0, 120.0, 180.0, 240.0, 300.0]);
    for (name, arm) in [("unequal", unequal), ("small", divided(12, &three).scaled(0.1)), ("long", long), ("six", six)]
    {
        let config = Config::of_arm(&arm, None).unwrap();
        let spectrum = Spectrum::of(&config, &Held::at(&config, &Place::Rest).unwrap()).unwrap();
        assert!(spectrum.is_stable(), "{name}: {:?}", spectrum.modes[0]);
    }
}

#[test]
fn a_place_that_cannot_be_held_is_told_as_such() {
    let config = light(0.05);
    let far = Place::Pose {
        position: Vector3::new(3.0, 3.0, 0.0),
        quaternion: nalgebra::Vector4::new(1.0, 0.0, 0.0, 0.0),
        curvatures: None,
    };
    assert!(Held::at(&config, &far).unwrap_err().to_string().contains("out of reach"));
    let short = Held::at(&config, &Place::Shape(vec![0.1; 3])).unwrap_err();
    assert_eq!(short.to_string(), "a shape of this arm has 8 finite curvatures, two for each segment, not 3");
    let bent = Held::at(&config, &Place::Shape(vec![9.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0]));
    assert!(bent.is_err(), "5.9 rad of one segment");
}
