//! What was computed from the arm, in SI, with the key that overrides each: for `sinew check`.

use super::check::{SummaryLine, line};
use super::{Config, Scale};

impl Config {
    /// Every setting whose default depends on the arm, as it came out, with its key. Weights on tensions are the loop's and
    /// not among them.
    pub fn computed(&self) -> Vec<SummaryLine> {
        let scale = Scale::of(&self.arm);
        let mut lines = vec![line(
            "first frequency",
            format!(
                "{} rad/s ({} s), length {} m",
                short(scale.omega_radps),
                short(scale.time_s(std::f64::consts::TAU)),
                short(scale.length_m)
            ),
        )];
        let (p, o, g, w) = (&self.planner, &self.observer, &self.governor, &self.weights.tip);
        let mut add = |key: &str, value: f64, unit: &str| lines.push(line(key, format!("{} {unit}", short(value))));
        add("arm.tension_rate_npsmax", self.arm.tension_rate_npsmax, "N/s");
        add("loop.period_s", self.timing.period_s, "s");
        add("planner.lookahead_s", p.lookahead_s, "s");
        add("planner.clearance_m", p.clearance_m, "m");
        add("planner.warning_distance_m", p.warning_distance_m, "m");
        add("planner.warning_hysteresis_m", p.warning_hysteresis_m, "m");
        if let Some(barrier) = p.barrier {
            add("planner.barrier_activation_m", barrier.activation_m, "m");
        }
        add("planner.body_radius_m", p.body_radius_m, "m");
        add("planner.swarm.sigma_n", p.swarm.sigma_n, "N");
        add("weights.tip.rate", w.rate, "s^2/m^2");
        add("observer.damping_s", o.damping_s, "s");
        add("observer.filter_time_s", o.filter_time_s, "s");
        add("observer.disturbance_time_s", o.disturbance_time_s, "s");
        add("observer.model_damping_ratio", o.model_damping_ratio, "");
        add("observer.settle_rate_radps", o.settle_rate_radps, "rad/s");
        add("observer.settle_time_s", o.settle_time_s, "s");
        add("observer.settle_timeout_s", o.settle_timeout_s, "s");
        add("governor.speed_mps", g.speed_mps, "m/s");
        add("governor.acceleration_mps2", g.acceleration_mps2, "m/s^2");
        add("governor.bend_rate_radps", g.bend_rate_radps, "rad/s");
        add("governor.turn_rate_radps", g.turn_rate_radps, "rad/s");
        add("governor.evasion_mps", g.evasion_mps, "m/s");
        add("governor.evasion_mps2", g.evasion_mps2, "m/s^2");
        add("governor.approach_1ps", g.approach_1ps, "1/s");
        add("governor.reach_m", g.reach_m, "m");
        add("governor.attitude_length_m", g.attitude_length_m, "m");
        add("governor.swing_damping_1ps", g.swing_damping_1ps, "1/s");
        add("guard.encoder_jump_m", self.guard.encoder_jump_m, "m");
        add("guard.encoder_stuck_motion_m", self.guard.encoder_stuck_motion_m, "m");
        add("guard.encoder_silent_s", self.guard.encoder_silent_s, "s");
        add("guard.box_tolerance_n", self.guard.box_tolerance_n, "N");
        let s = &self.supervision;
        add("supervision.tip_speed_mps", s.tip_speed_mps, "m/s");
        add("supervision.bend_rate_radps", s.bend_rate_radps, "rad/s");
        add("supervision.swing_m", s.swing_m, "m");
        add("supervision.tension_error_n", s.tension_error_n, "N");
        add("supervision.length_error_m", s.length_error_m, "m");
        add("obstacles.growth_mps", self.obstacles.growth_mps, "m/s");
        add("obstacles.growth_m_max", self.obstacles.growth_m_max, "m");
        add("tip_sensor.time_s", self.tip_sensor.time_s, "s");
        add("tip_sensor.error_m", self.tip_sensor.error_m, "m");
        add("friction.speed_mps", self.friction.speed_mps, "m/s");
        lines
    }
}

/// A number in three digits, without an exponent where it needs none.
pub(super) fn short(x: f64) -> String {
    if x == 0.0 || !x.is_finite() {
        return x.to_string();
    }
    let digits = 2 - x.abs().log10().floor() as i32;
    if !(-3..=6).contains(&digits) {
        return format!("{x:.2e}");
    }
    let rounded = format!("{:.*}", digits.max(0) as usize, x);
    if rounded.contains('.') { rounded.trim_end_matches('0').trim_end_matches('.').to_owned() } else { rounded }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::config::ArmConfig;

    #[test]
    fn numbers_have_three_digits() {
        let cases = [(0.1, "0.1"), (2.75, "2.75"), (0.001_234_5, "0.00123"), (1234.5, "1234"), (1.1e-9, "1.10e-9")];
        for (x, wanted) in cases {
            assert_eq!(short(x), wanted);
        }
    }

    /// The paper's arm gets what its file of settings has, to 2 %.
    #[test]
    fn the_papers_arm_alone_gets_what_is_shipped_for_it() {
        let shipped = Config::builtin();
        let alone = Config::of_arm(&shipped.arm, None).unwrap();
        let values = |config: &Config| -> Vec<(String, f64)> {
            let number = |text: &str| text.split(' ').next().and_then(|x| x.parse().ok()).unwrap_or(f64::NAN);
            config.computed().into_iter().skip(1).map(|line| (line.label, number(&line.value))).collect()
        };
        for ((key, one), (_, other)) in values(&shipped).into_iter().zip(values(&alone)) {
            // The paper's arm is a curve; its file says so.
            if key != "planner.body_radius_m" {
                assert!((one - other).abs() <= 0.02 * one.abs(), "{key}: {one} shipped, {other} computed");
            }
        }
    }

    #[test]
    fn similar_arms_have_similar_settings() {
        let arm = ArmConfig::paper();
        let one = Config::of_arm(&arm, None).unwrap();
        for s in [0.03, 0.1, 0.3, 3.0] {
            let other = Config::of_arm(&arm.scaled(s), None).unwrap();
            assert_eq!(one.timing, other.timing);
            let same = |a: f64, b: f64| assert!((a / b - 1.0).abs() < 1e-9, "{a} {b} at {s}");
            same(one.planner.clearance_m * s, other.planner.clearance_m);
            same(one.governor.acceleration_mps2 * s, other.governor.acceleration_mps2);
            same(one.observer.disturbance_time_s, other.observer.disturbance_time_s);
            same(one.guard.box_tolerance_n * s.powi(4), other.guard.box_tolerance_n);
        }
    }
}
