//! The supervision against the true arm: drives that lie are named, sound arms are not accused, what moves too much is said. The
//! study behind it is `examples/lies.rs`.

#![allow(clippy::expect_used)] // a test stops where it cannot go on
use sim_plant::bench::{Bench, Lie};
use sim_plant::poses;
use sim_plant::truth::TruthSettings;
use sinew::config::{Config, SupervisionAnswer};
use sinew::control::supervision::Swing;
use sinew::control::{Fault, Limit, Mode, Request, Settings, Target, TargetInput};

/// Seconds at each pose before the next is asked for.
const POSE_S: f64 = 8.0;

fn tip(pose: &poses::Pose) -> TargetInput {
    let zero = nalgebra::Vector3::zeros();
    let now = Target::Tip {
        position_m: pose.position,
        quaternion: pose.quaternion,
        velocity_mps: zero,
        angular_velocity_radps: zero,
    };
    TargetInput { now, ahead: None, weight: 0.0, sequence: 1, fresh: true }
}

/// Moves an armed arm from pose to pose, until `each` has seen enough or the arm no longer tracks.
fn wander(config: &Config, bench: &mut Bench, seed: u64, seconds: f64, mut each: impl FnMut(&mut Bench) -> bool) {
    let begin = bench.time_s();
    let mut at = u64::MAX;
    let mut request = Some(Request::Track);
    while bench.time_s() < begin + seconds {
        let k = ((bench.time_s() - begin) / POSE_S) as u64;
        if at != k {
            at = k;
            bench.target = Some(tip(&poses::random(config, 1000 * seed + k)));
        }
        let output = bench.step(request.take());
        if each(bench) || output.mode != Mode::Tracking || bench.broken.is_some() {
            return;
        }
    }
}

fn armed(config: &Config, truth: &TruthSettings, lie: Option<(usize, Lie)>) -> Bench {
    let mut bench = Bench::new(config, &Settings::new(config), truth);
    if let Some((cable, lie)) = lie {
        bench.lies[cable] = lie;
    }
    bench.arm(60.0).expect("armed");
    bench
}

fn first_fault(bench: &Bench) -> Option<Fault> {
    bench.cycle.supervisor().latch().first.map(|latched| latched.fault)
}

#[test]
fn a_drive_that_shows_another_motion_is_named_before_its_cable_has_moved_far() {
    let config = Config::builtin();
    for (cable, lie) in [
        (0, Lie::BACKWARDS),
        (14, Lie { shows: 4.0, ..Lie::NONE }),
        (7, Lie { shows: 0.25, ..Lie::NONE }),
        (21, Lie::gear(2.0)),
        (10, Lie::gear(0.5)),
    ] {
        let mut bench = armed(&config, &TruthSettings::study(1), Some((cable, lie)));
        let rest = bench.truth.true_lengths()[cable];
        let mut moved_at = None;
        wander(&config, &mut bench, 1, 60.0, |bench| {
            if moved_at.is_none() && (bench.truth.true_lengths()[cable] - rest).abs() > 0.002 {
                moved_at = Some(bench.time_s());
            }
            false
        });
        let Some(Fault::CableLength { cable: named, factor, unsure, .. }) = first_fault(&bench) else {
            panic!("{cable} {lie:?}: {:?}", first_fault(&bench));
        };
        assert!(usize::from(named) == cable && !unsure, "{cable} {lie:?}: {named}");
        assert!(factor.is_nan() || (factor > 1.0) == (lie.shows > 1.0), "{cable} {lie:?}: {factor}");
        let after_s = moved_at.map_or(0.0, |at| bench.time_s() - at);
        assert!(after_s < 2.0, "{cable} {lie:?}: {after_s} s");
    }
}

#[test]
fn a_sound_arm_is_never_accused() {
    type Change = fn(&mut Config, &mut TruthSettings);
    let changes: [(&str, Change); 5] = [
        ("as shipped", |_, _| ()),
        ("friction made up by half", |config, truth| {
            truth.capstan_friction = 0.1;
            config.friction.coefficient = 0.05;
        }),
        ("damps a twenty-fifth", |_, truth| truth.damping_factor = 0.04),
        ("a tick late", |config, truth| {
            truth.latency_ticks = 1;
            config.observer.latency_ticks = 1;
        }),
        ("gravity, and more load", |config, truth| {
            config.arm.gravity_mps2 = [0.0, 0.0, -9.81];
            truth.extra_payload_kg = 0.2;
        }),
    ];
    for (name, change) in changes {
        let (mut config, mut truth) = (Config::builtin(), TruthSettings::study(2));
        change(&mut config, &mut truth);
        let mut bench = armed(&config, &truth, None);
        let mut most = [0.0f64; 2];
        wander(&config, &mut bench, 2, 24.0, |bench| {
            let evidence = bench.cycle.supervision().evidence();
            most = [0, 1].map(|i| most[i].max(evidence[i]));
            false
        });
        assert_eq!((bench.cycle.mode(), first_fault(&bench)), (Mode::Tracking, None), "{name}");
        assert!(most.iter().all(|e| *e < 0.7), "{name}: {most:?}");
    }
}

#[test]
fn a_cable_that_does_not_pull_is_named() {
    // Its motor turns the other way, or its cable has left the drum: nothing is pulled, and the encoder is right.
    let config = Config::builtin();
    let mut bench = armed(&config, &TruthSettings::study(1), Some((0, Lie { pull: 0.0, ..Lie::NONE })));
    let mut off_at = None;
    wander(&config, &mut bench, 1, 60.0, |bench| {
        if off_at.is_none() && bench.cycle.tensions_n()[0] > 20.0 {
            off_at = Some(bench.time_s());
        }
        false
    });
    let Some(Fault::CablePull { cable: 0, factor }) = first_fault(&bench) else {
        panic!("{:?}", first_fault(&bench));
    };
    assert!(factor < 0.4, "{factor}");
    let after_s = off_at.map_or(0.0, |at| bench.time_s() - at);
    assert!(after_s < 5.0, "{after_s} s");
}

#[test]
fn a_tip_that_is_faster_than_declared_is_answered_as_declared() {
    for answer in [SupervisionAnswer::Warn, SupervisionAnswer::Slow, SupervisionAnswer::Hold, SupervisionAnswer::Stop] {
        let mut config = Config::builtin();
        // Half of what the governor permits.
        config.supervision.tip_speed_mps = 0.5 * config.governor.speed_mps;
        config.supervision.tip_speed_answer = answer;
        let mut bench = armed(&config, &TruthSettings::study(1), None);
        let (mut said, mut fastest, mut before) = (false, 0.0f64, bench.truth.tip().position);
        wander(&config, &mut bench, 1, 3.0 * POSE_S, |bench| {
            said |= bench.record().limits.contains(Limit::TipSpeed);
            let now = bench.truth.tip().position;
            fastest = fastest.max((now - before).norm() / config.timing.period_s);
            before = now;
            false
        });
        assert!(said, "{answer:?}");
        let fault = matches!(first_fault(&bench), Some(Fault::TipSpeed { .. }));
        let (mode, faulted) = match answer {
            SupervisionAnswer::Warn | SupervisionAnswer::Slow => (Mode::Tracking, false),
            SupervisionAnswer::Hold => (Mode::Holding, false),
            SupervisionAnswer::Stop => (Mode::Faulted, true),
        };
        assert_eq!((bench.cycle.mode(), fault), (mode, faulted), "{answer:?}");
        // Slowed down it is not much beyond; only warned it is.
        let limit = config.supervision.tip_speed_mps;
        match answer {
            SupervisionAnswer::Warn => assert!(fastest > 1.5 * limit, "{fastest}"),
            _ => assert!(fastest < 1.5 * limit, "{answer:?}: {fastest}"),
        }
    }
}

#[test]
fn an_arm_that_swings_is_never_shown_as_holding_without_saying_so() {
    // A loop that keeps what cables do not see swinging: an observer that answers late, an arm that hardly damps.
    let mut config = Config::builtin();
    config.observer.disturbance_time_s = 0.35;
    config.observer.filter_time_s = 0.4;
    config.governor.swing_damping_1ps = 0.0;
    config.governor.speed_mps *= 3.0;
    config.governor.acceleration_mps2 *= 10.0;
    config.supervision.cable_answer = SupervisionAnswer::Warn;
    config.supervision.tip_speed_answer = SupervisionAnswer::Warn;
    let truth = TruthSettings { damping_factor: 0.04, ..TruthSettings::study(1) };
    let mut bench = armed(&config, &truth, None);
    let ahead = (bench.cycle.lead_s() / config.timing.period_s).round() as usize;
    let mut truly = Swing::new(ahead);
    let (mut swings, mut unsaid) = (0, 0);
    wander(&config, &mut bench, 1, 40.0, |bench| {
        let (tip, reference) = (bench.truth.tip().position, bench.cycle.governor().reference_tip());
        let (swing_m, _) = truly.follow(config.timing.period_s, &tip, None, &reference);
        if swing_m > 0.02 {
            swings += 1;
            unsaid += usize::from(!bench.record().limits.contains(Limit::Swinging));
        }
        false
    });
    assert!(swings > 500, "{swings} ticks: it does not swing");
    assert_eq!(unsaid, 0, "of {swings} ticks");
}
