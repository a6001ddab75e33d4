//! What of the settings does not fit the arm: the likely causes of a loop that swings up, fails or does not settle, in words,
//! each with what was found, the key, and a value that would do.

use super::fault::Fault;
use super::settings::Settings;
use super::steering::Steering;
use crate::config::Scale;

/// W over the arm's own answer: more lags and swings up, less leaves the planner's linearisation.
const CHANGE: (f64, f64) = (1e-6, 0.03);
/// W over the arm's own answer that does on every arm that was tried.
const CHANGE_GOOD: f64 = 1e-3;
/// Lookahead over the inverse of the first angular frequency, that was tried, and what is computed.
const LOOKAHEAD: (f64, f64) = (0.03, 0.9);
const LOOKAHEAD_GOOD: f64 = 0.0784;
/// Observer's times over those that are computed.
const TIMES: f64 = 4.0;
const DAMPING_GOOD: f64 = 1.57;
const DISTURBANCE_GOOD: f64 = 0.78;
/// Damping ratio of the first mode below which no arm was tried.
const RATIO_MIN: f64 = 2e-4;

/// Sentences, the likeliest cause first; empty where everything is as it was tried. Allocates.
pub fn doubts(settings: &Settings) -> Vec<String> {
    let scale = Scale::of(&settings.arm);
    let mut found = Vec::new();
    let steering = Steering::new(settings);
    let ratios = steering.change.iter().zip(&steering.sensitivity).map(|(w, a)| w / a).enumerate();
    let far = |r: f64| r > CHANGE.1 || r < CHANGE.0;
    if let Some((segment, ratio)) = ratios.filter(|(_, r)| far(*r)).max_by(|a, b| off(a.1).total_cmp(&off(b.1))) {
        let good = CHANGE_GOOD * steering.sensitivity[segment];
        let does = if ratio > CHANGE.1 { "lags, and swings up" } else { "jumps farther than its plan is good for" };
        found.push(format!(
            "weights.tip.tension_change of segment {} is {ratio:.1e} of what the arm answers with, and the loop {does}; leave the key \
             out, or set it to {good:.2e}",
            segment + 1
        ));
    }
    let planner = &settings.planner;
    let lookahead = planner.lookahead_s * scale.omega_radps;
    if lookahead < LOOKAHEAD.0 || lookahead > LOOKAHEAD.1 {
        found.push(format!(
            "planner.lookahead_s = {} s is {:.2} of the inverse of the first frequency ({:.3} rad/s), {} to {} were tried; leave it \
             out, or set it to about {:.2e} s",
            planner.lookahead_s,
            lookahead,
            scale.omega_radps,
            LOOKAHEAD.0,
            LOOKAHEAD.1,
            scale.time_s(LOOKAHEAD_GOOD)
        ));
    }
    let observer = &settings.observer;
    for (key, value, good) in [
        ("damping_s", observer.damping_s, scale.time_s(DAMPING_GOOD)),
        ("disturbance_time_s", observer.disturbance_time_s, scale.time_s(DISTURBANCE_GOOD)),
    ] {
        let share = value / good;
        if !(1.0 / TIMES..=TIMES).contains(&share) {
            found.push(format!(
                "observer.{key} = {value} s is {share:.2} times what suits the arm's first period of {:.3} s; leave it out, or set it \
                 to {good:.2e} s",
                scale.time_s(std::f64::consts::TAU)
            ));
        }
    }
    for (index, segment) in settings.arm.segments.iter().enumerate() {
        let ratio = 0.5 * segment.damping_stiffness_s * scale.omega_radps;
        if ratio < RATIO_MIN {
            found.push(format!(
                "segment {}: damping_stiffness_s = {} s damps the first mode by {ratio:.1e} of critical; less than {RATIO_MIN:.0e} \
                 was never tried, and {:.1e} s would be 2 %",
                index + 1,
                segment.damping_stiffness_s,
                0.04 / scale.omega_radps
            ));
        }
    }
    found
}

fn off(ratio: f64) -> f64 {
    (ratio / CHANGE_GOOD).ln().abs()
}

/// What is the likely cause of a fault among the settings; `None` where they fit the arm, or the fault is none that settings
/// cause. Allocates.
pub fn likely_cause(fault: &Fault, settings: &Settings) -> Option<String> {
    let from_settings = matches!(
        fault,
        Fault::EncoderJump { .. }
            | Fault::InnovationBound { .. }
            | Fault::InnovationGrowth { .. }
            | Fault::NotSettled { .. }
            | Fault::EstimateLost
            | Fault::TensionNotFinite { .. }
            | Fault::PlanSingular { .. }
    );
    from_settings.then(|| doubts(settings).into_iter().next()).flatten()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::config::{ArmConfig, Config};

    #[test]
    fn what_fits_the_arm_raises_no_doubt() {
        assert_eq!(doubts(&Settings::new(&Config::builtin())), [""; 0]);
        for s in [0.03, 3.0] {
            let config = Config::of_arm(&ArmConfig::paper().scaled(s), None).unwrap();
            assert_eq!(doubts(&Settings::new(&config)), [""; 0]);
        }
    }

    #[test]
    fn what_does_not_is_named_with_a_value_that_does() {
        let mut config = Config::of_arm(&ArmConfig::paper().scaled(0.1), None).unwrap();
        config.weights.tip.tension_change = Some(vec![1e4; 4]);
        config.planner.lookahead_s = 2.0;
        config.observer.disturbance_time_s = 0.02;
        config.arm.segments[2].damping_stiffness_s = 0.0;
        let found = doubts(&Settings::new(&config));
        let parts = [
            "weights.tip.tension_change",
            "planner.lookahead_s = 2",
            "observer.disturbance_time_s = 0.02",
            "segment 3: damping",
        ];
        assert_eq!(found.len(), parts.len(), "{found:#?}");
        for (text, part) in found.iter().zip(parts) {
            assert!(text.contains(part), "{part} is not in {text}");
        }
        let settings = Settings::new(&config);
        let cause = likely_cause(&Fault::PlanSingular { count: 5 }, &settings);
        assert!(cause.is_some_and(|text| text.contains("weights.tip.tension_change")));
        assert_eq!(likely_cause(&Fault::BusLost { bus: 0 }, &settings), None);
    }
}
