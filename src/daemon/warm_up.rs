//! Every path of a tick is walked once before the first one: on a twin of the controller that is thrown away, so that
//! the caches, the lazily made tables of libraries and the branch predictor know the way and the controller itself is as
//! new.

use crate::collision::Shape;
use crate::config::{Config, ShapeConfig};
use crate::control::obstacles::Placement;
use crate::control::{
    CURVATURES_MAX, CableMask, Cycle, DrivesInput, DrivesPhase, EncoderReadings, Mode, ObstacleDemand, ObstaclePair,
    Request, Settings, Target, TargetInput, TickInputs,
};
use crate::estimator::Observer;
use crate::model::Arm;
use nalgebra::Vector3;
use rand::SeedableRng;
use rand_xoshiro::Xoshiro256PlusPlus;
use sinew_hal::clock::seconds_to_ns;

/// Ticks at most until the twin holds, and in each of the tasks.
const TICKS: u64 = 30;

/// Walks starting, holding, tip and shape tracking, free and beside an obstacle, home, stop. Allocates; returns the
/// modes that were reached, for the test.
pub(crate) fn warm_up(config: &Config, settings: &Settings) -> Vec<Mode> {
    let mut settings = settings.clone();
    let period_s = config.timing.period_s;
    // The twin has no time to lose.
    settings.timing.ramp_s = period_s;
    settings.observer.settle_time_s = 0.0;
    settings.observer.settle_innovation_rad = 10.0;
    settings.observer.settle_rate_radps = 10.0;
    // Its encoders stand still while its model moves: that must not end the walk.
    settings.observer.innovation_bound_rad = f64::INFINITY;
    settings.observer.innovation_growth_rad = f64::INFINITY;
    settings.guard.encoder_stuck_s = f64::INFINITY;
    settings.supervision = settings.supervision.warning();
    settings.start_tensions_n.fill(settings.arm.tension_n_min);
    let observer = Observer::new(&config.arm, &settings.observer, period_s);
    let mut cycle = Cycle::new(&settings, observer);

    let arm = Arm::new(&config.arm);
    let straight = arm.straight();
    let mut lengths = vec![0.0; arm.cable_count()];
    arm.cable_lengths_into(&straight, &mut lengths);
    let (tip, quaternion) = arm.pose(&straight, arm.node_count());
    let still = Vector3::zeros();
    // A little to the side, so that a straight arm has something to do.
    let tip_target = Target::Tip {
        position_m: tip + Vector3::new(0.05, 0.02, 0.02),
        quaternion,
        velocity_mps: still,
        angular_velocity_radps: still,
    };
    let shape_target = Target::Shape { curvatures_1pm: [0.1; CURVATURES_MAX], rates_1pms: [0.0; CURVATURES_MAX] };

    let free = ObstaclePair::new();
    let mut beside = ObstaclePair::new();
    if let Ok(ball) = Shape::new(&ShapeConfig::Ball { radius_m: 0.1 })
        && beside.insert(0, &ball).is_ok()
    {
        // Beside the tip, within the warning distance.
        let at: [f64; 3] = (tip + Vector3::new(0.1 + config.planner.clearance_m, 0.0, 0.0)).into();
        let placement = Placement {
            position_now_m: at,
            position_ahead_m: at,
            quaternion: [1.0, 0.0, 0.0, 0.0],
            growth_m: config.planner.body_radius_m,
        };
        // Were it refused, it would stay at the base, which is near enough.
        let _ = beside.place(0, &placement);
    }

    let mut rng = Xoshiro256PlusPlus::seed_from_u64(0);
    let drives =
        DrivesInput { phase: DrivesPhase::Enabled, ready: true, fault: None, bus_lost: None, emergency_stop: None };
    let mut modes = Vec::new();
    let tasks = [
        (Some(Request::Arm), None, &free),
        (Some(Request::Track), Some(tip_target), &free),
        (None, Some(tip_target), &beside),
        (Some(Request::Track), Some(shape_target), &free),
        (None, Some(shape_target), &beside),
        (Some(Request::Home), None, &free),
        (Some(Request::Hold), None, &beside),
        (Some(Request::Stop), None, &free),
    ];
    let mut tick = 0;
    for (mut request, target, obstacles) in tasks {
        for _ in 0..TICKS {
            let now_ns = seconds_to_ns(period_s) * (tick + 1);
            let encoders =
                EncoderReadings { lengths_m: &lengths, valid: CableMask::first(lengths.len()), capture_ns: now_ns };
            let target = target.map(|now| TargetInput { now, ahead: None, weight: 0.0, sequence: 0, fresh: true });
            let inputs = TickInputs {
                tick,
                now_ns,
                missed: 0,
                encoders,
                tensions_measured_n: &lengths,
                obstacles,
                demand: ObstacleDemand::Proceed,
                tip: None,
                target,
                drives,
                request: request.take(),
            };
            let output = cycle.tick(&inputs, &mut rng, &mut || false);
            cycle.report(&inputs);
            while cycle.events_mut().pop().is_some() {}
            if modes.last() != Some(&output.mode) {
                modes.push(output.mode);
            }
            tick += 1;
            if tick < TICKS && output.mode == Mode::Holding {
                break;
            }
        }
    }
    modes
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_warm_up_walks_every_mode_without_a_fault() {
        let config = Config::builtin();
        let modes = warm_up(&config, &Settings::new(&config));
        for mode in [Mode::Starting, Mode::Holding, Mode::Tracking, Mode::Stopping] {
            assert!(modes.contains(&mode), "{mode:?} is not in {modes:?}");
        }
        assert!(!modes.contains(&Mode::Faulted), "{modes:?}");
    }
}
