//! What an arm can do by its own file: where its tip reaches, what it lifts, how far a newton of a cable moves it.

use crate::config::ArmConfig;
use crate::integrator::{AffineMap, Stepper};
use crate::math::block_tridiagonal::COORDINATES;
use crate::model::{Arm, Motion, Rates, State};
use crate::posture::RestingArm;
use nalgebra::Vector3;
use rand::{RngExt, SeedableRng};
use rand_xoshiro::Xoshiro256PlusPlus;

/// Bend of a segment beyond which no slice looks (rad).
const BEND_MAX_RAD: f64 = 2.0;
/// Postures of a slice, and steps of the way from one to the next.
const POSTURES: usize = 400;
const STEPS: u32 = 8;
/// Norm of a posture's last correction, over the arm's length, with which it is one.
const REACHED: f64 = 1e-6;

/// Where the tip reaches with all bends in one plane, and what it took.
#[derive(Debug, Clone, PartialEq)]
pub struct Slice {
    /// Positions of the tip (m): along the straight arm, and across it in the plane of the bends.
    pub tips: Vec<[f64; 2]>,
    /// Largest distance of the tip across (m), and from the straight arm's (m).
    pub across_m: f64,
    /// As named.
    pub from_straight_m: f64,
}

/// The slice: equilibria (gravity and all) at random bends about local y of every segment, as far as tensions hold them. The
/// same arm gives the same slice. Allocates.
pub fn slice(config: &ArmConfig) -> Slice {
    let arm = Arm::new(config);
    let u = vec![config.tension_n_min; arm.cable_count()];
    let count = 2 * arm.segment_count();
    let straight = arm.tip(&arm.straight(), &vec![0.0; COORDINATES * arm.node_count()]).position;
    let (along, across) = axes(config, &arm);
    let mut rng = Xoshiro256PlusPlus::seed_from_u64(1);
    let mut found = Slice { tips: Vec::new(), across_m: 0.0, from_straight_m: 0.0 };
    let mut rest = RestingArm::new(&arm);
    let mut scratch = vec![0.0; count];
    for k in 0..POSTURES {
        // Every bend alike in the first ones: the outline.
        let same = 2.0 * k as f64 / 40.0 - 1.0;
        let wanted: Vec<f64> = (0..count)
            .map(|i| {
                let share = if k <= 40 { same } else { rng.random_range(-1.0..=1.0) };
                if i % 2 == 0 { share * BEND_MAX_RAD / config.segments[i / 2].length_m } else { 0.0 }
            })
            .collect();
        let from = rest.curvatures().to_vec();
        let mut norm = f64::NAN;
        for step in 1..=STEPS + 2 {
            let share = (f64::from(step) / f64::from(STEPS)).min(1.0);
            let between: Vec<f64> = from.iter().zip(&wanted).map(|(a, b)| a + share * (b - a)).collect();
            if rest.linearize(&u).is_err() {
                norm = f64::NAN;
                break;
            }
            norm = rest.advance(&between);
            let position = rest.tip().0;
            let inside = norm < 0.05 * config.length_m()
                && rest.linearize(&u).is_ok()
                && (0..config.segments.len()).all(|s| {
                    rest.load_into(
                        s,
                        config.segment_tension_n_max(&config.segments[s]) - config.tension_n_min,
                        &mut scratch,
                    ) <= 1.0
                });
            // Postures on the way count as well.
            if inside && step >= STEPS / 2 {
                let from_base = position - arm.base_position;
                found.tips.push([from_base.dot(&along), from_base.dot(&across)]);
                found.across_m = found.across_m.max(from_base.dot(&across).abs());
                found.from_straight_m = found.from_straight_m.max((position - straight).norm());
            }
        }
        // NaN, too, starts anew.
        if norm.is_nan() || norm >= REACHED * config.length_m() {
            rest.restart(&vec![0.0; count]);
        }
    }
    found
}

/// Directions along the straight arm, and across it to where positive bends about local y lead.
fn axes(config: &ArmConfig, arm: &Arm) -> (Vector3<f64>, Vector3<f64>) {
    let at = |curvature: f64| {
        let k: Vec<f64> = (0..2 * config.segments.len()).map(|i| if i % 2 == 0 { curvature } else { 0.0 }).collect();
        arm.pose(&arm.bent(&k), arm.node_count()).0
    };
    let along = (at(0.0) - arm.base_position).normalize();
    let bent = at(0.1 / config.length_m()) - at(0.0);
    (along, (bent - along * bent.dot(&along)).normalize())
}

/// Force (N) across the straight arm that its cables can bear at the tip, whatever its side, and the segment (0-based) that
/// gives way first: the moment of the force at each segment's base against what the segment's own cables can give.
pub fn force_at_tip(config: &ArmConfig) -> (f64, usize) {
    let mut behind_m = 0.0;
    let mut least = (f64::INFINITY, 0);
    for (s, segment) in config.segments.iter().enumerate().rev() {
        behind_m += segment.length_m + if s + 1 < config.segments.len() { segment.connector_length_m } else { 0.0 };
        let range = config.segment_tension_n_max(segment) - config.tension_n_min;
        let hole = |angle: f64| [segment.hole_radius_m * angle.cos(), segment.hole_radius_m * angle.sin()];
        let holes: Vec<[f64; 2]> = segment.hole_angles_rad.iter().map(|a| hole(*a)).collect();
        // The polygon of all moments has its sides parallel to the holes' directions: its least width is across one.
        let across = |n: [f64; 2]| -> f64 {
            range * holes.iter().map(|h| (n[0] * h[0] + n[1] * h[1]).max(0.0)).sum::<f64>() / n[0].hypot(n[1])
        };
        let sides = holes.iter().flat_map(|h| [[-h[1], h[0]], [h[1], -h[0]], *h, [-h[0], -h[1]]]);
        let moment = sides.map(across).fold(f64::INFINITY, f64::min);
        if moment / behind_m < least.0 {
            least = (moment / behind_m, s);
        }
    }
    least
}

/// How far a newton of a cable moves the tip of an arm that rests in `state` under tensions `u` (m/N): of each segment's cables
/// the one that moves it farthest. `None` where the equilibrium is singular. Allocates.
pub fn tip_per_newton(arm: &Arm, state: &State, u: &[f64]) -> Option<Vec<f64>> {
    let mut stepper = Stepper::new(arm);
    stepper.linearize(arm, &Motion::from(state), u, Rates::STATIC).ok()?;
    let mut map = AffineMap::new(arm);
    stepper.affine_map_into(arm, &mut map);
    let last = COORDINATES * (arm.node_count() - 1);
    let mut most = vec![0.0f64; arm.segment_count()];
    for cable in 0..arm.cable_count() {
        let moved = (0..3).map(|r| map.row(last + r)[cable].powi(2)).sum::<f64>().sqrt();
        let of = &mut most[arm.cable_segment[cable]];
        *of = of.max(moved);
    }
    Some(most)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_newton_of_a_cable_moves_the_tip_by_the_beams_closed_form() {
        let config = ArmConfig::paper();
        let arm = Arm::new(&config);
        let none = vec![0.0; arm.cable_count()];
        let most = tip_per_newton(&arm, &State::at_rest(arm.straight()), &none).unwrap();
        // M = r T bends its segment by M L / EI, which turns what is behind it: L/2 of the segment, and the rest.
        for (s, moved) in most.iter().enumerate() {
            let bend = 0.05 * 0.65 / 7.0;
            let behind = 2.75 - 0.7 * (s as f64 + 1.0) + 0.05;
            assert!((moved / (bend * (0.325 + behind)) - 1.0).abs() < 0.01, "segment {s}: {moved}");
        }
    }

    #[test]
    fn the_first_segment_bears_least_of_a_force_at_the_tip() {
        let mut config = ArmConfig::paper();
        let (force, segment) = force_at_tip(&config);
        // Six cables at even angles: across a hole's direction two of them pull with sin 60 degrees each.
        let moment = (config.tension_n_max - config.tension_n_min) * 0.05 * 2.0 * (60f64).to_radians().sin();
        assert_eq!(segment, 0);
        assert!((force / (moment / 2.75) - 1.0).abs() < 1e-9, "{force} N");
        config.segments[2].tension_n_max = Some(20.0);
        assert_eq!(force_at_tip(&config).1, 2, "weak cables give way first");
    }

    #[test]
    fn a_slice_reaches_as_far_as_the_bends_and_less_with_weaker_cables() {
        let config = ArmConfig::paper();
        let whole = slice(&config);
        assert!(whole.tips.len() > 500, "{}", whole.tips.len());
        assert!(whole.tips.iter().all(|[along, across]| along.hypot(*across) < 2.751));
        assert!(whole.across_m > 1.2 && whole.from_straight_m > 1.2, "{whole:?}");
        let mut weak = config.clone();
        weak.segments.iter_mut().for_each(|s| s.tension_n_max = Some(config.tension_n_min + 10.0));
        weak.tension_n_max = config.tension_n_min + 10.0;
        // 10 N bend a segment by 0.08 rad at most: 0.1 m of tip for each.
        assert!(slice(&weak).across_m < 0.5, "{}", slice(&weak).across_m);
    }
}
