use super::*;
use crate::config::Config;

const H: f64 = 0.01;

/// What an arm at rest shows, changed; how long it took to be answered (ticks), and how.
fn answered(
    settings: impl Fn(&mut SupervisionConfig),
    ticks: usize,
    change: impl Fn(usize, &mut Shown),
) -> Option<(usize, Verdict, Vec<Fault>)> {
    let config = Config::builtin();
    let arm = Arm::new(&config.arm);
    let mut own = config.supervision;
    settings(&mut own);
    let mut supervision = Supervision::new(&arm, &config.arm, &own, 0, 30);
    let mut lengths = vec![0.0; 24];
    arm.cable_lengths_into(&arm.straight(), &mut lengths);
    (0..ticks).find_map(|k| {
        let mut shown = Shown { tip: Vector3::new(0.0, 0.0, -2.75), speed: 0.0, rates: [0.0; 8], told: [20.0; 24] };
        change(k, &mut shown);
        let seen = Seen {
            h: H,
            tip: shown.tip,
            unseen: None,
            reference_tip: Vector3::new(0.0, 0.0, -2.75),
            tip_speed_mps: shown.speed,
            curvatures: &[0.0; 8],
            curvature_rates: &shown.rates,
            sent_n: &shown.told,
            commanded_n: &shown.told,
            measured_n: &[],
            measured_age_ticks: 0.0,
            lengths_m: &lengths,
            model_m: &lengths,
            disturbance_nm: &[],
            correction_nm: &[],
        };
        let mut faults = FaultList::default();
        let verdict = supervision.check(&seen, &mut faults);
        (verdict != Verdict::default()).then(|| (k, verdict, faults.iter().collect()))
    })
}

struct Shown {
    tip: Vector3<f64>,
    speed: f64,
    rates: [f64; 8],
    told: [f64; 24],
}

fn only(limit: Limit) -> Limits {
    let mut limits = Limits::default();
    limits.insert(limit);
    limits
}

#[test]
fn an_arm_at_rest_is_left_alone() {
    assert_eq!(answered(|_| (), 2000, |_, _| ()), None);
}

#[test]
fn each_answer_includes_those_before_it() {
    use SupervisionAnswer::{Hold, Slow, Stop, Warn};
    for answer in [Warn, Slow, Hold, Stop] {
        let set = |s: &mut SupervisionConfig| s.tip_speed_answer = answer;
        let (k, verdict, faults) = answered(set, 100, |_, shown| shown.speed = 0.7).expect("answered");
        assert_eq!((k, verdict.limits), (5, only(Limit::TipSpeed)), "after the declared time");
        assert_eq!(verdict.slow, answer >= Slow);
        assert_eq!(verdict.hold, (answer >= Hold).then_some(Limit::TipSpeed));
        let fault = Fault::TipSpeed { speed_mps: 0.7 };
        assert_eq!(faults, if answer == Stop { vec![fault] } else { Vec::new() });
    }
}

#[test]
fn a_speed_that_is_no_number_is_too_fast_and_one_that_is_too_fast_for_a_moment_is_not() {
    assert!(answered(|_| (), 100, |_, shown| shown.speed = f64::NAN).is_some());
    assert_eq!(answered(|_| (), 1000, |k, shown| shown.speed = if k.is_multiple_of(5) { 9.0 } else { 0.0 }), None);
}

#[test]
fn a_segment_that_bends_too_fast_is_a_fault() {
    let (_, verdict, faults) = answered(|_| (), 100, |_, shown| shown.rates[5] = -5.0).expect("answered");
    assert_eq!(verdict.limits, only(Limit::BendRate));
    assert!(matches!(faults[..], [Fault::BendRate { rate_radps }] if (rate_radps - 3.25).abs() < 1e-9), "{faults:?}");
    assert_eq!(answered(|_| (), 1000, |_, shown| shown.rates[5] = -4.0), None, "2.6 rad/s");
}

#[test]
fn a_tension_at_its_limit_for_long_is_said() {
    let saturated = |k: usize, shown: &mut Shown| shown.told[17] = if k < 100 { 100.0 } else { 220.0 };
    let (k, verdict, faults) = answered(|_| (), 2000, saturated).expect("answered");
    assert_eq!((verdict.limits, faults), (only(Limit::Saturated), Vec::new()));
    assert!((599..=602).contains(&k), "{k}");
    let stop = |s: &mut SupervisionConfig| s.saturation_answer = SupervisionAnswer::Stop;
    let (_, _, faults) = answered(stop, 2000, saturated).expect("answered");
    assert!(matches!(faults[..], [Fault::Saturated { cable: 17, .. }]), "{faults:?}");
}

#[test]
fn a_tip_that_swings_is_said_with_its_size() {
    let swings = |k: usize, shown: &mut Shown| shown.tip.x = 0.012 * (0.03 * k as f64).sin();
    let stop = |s: &mut SupervisionConfig| s.swing_answer = SupervisionAnswer::Stop;
    let (_, verdict, faults) = answered(stop, 1000, swings).expect("answered");
    assert_eq!(verdict.limits, only(Limit::Swinging));
    assert!(matches!(faults[..], [Fault::Swinging { swing_m }] if swing_m > 0.02), "{faults:?}");
}
