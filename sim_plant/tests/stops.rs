//! A motion between obstacles that is cut off: what the true arm does. The long form is `examples/campaign stops`.
#![allow(clippy::unwrap_used, clippy::expect_used)] // a test

use sim_plant::bench::Bench;
use sim_plant::stops::{Ending, Stopped, stop, trouble};
use sim_plant::truth::TruthSettings;
use sinew::config::{Config, SafeHold, ScenarioConfig};
use sinew::control::{Mode, Request};

/// A run that ends 3 s after the beginning of the paper's curve.
fn ended(ending: Ending, hold: SafeHold) -> Stopped {
    ended_at(3.0, ending, hold, 0.0, 20.0)
}

fn ended_at(at_s: f64, ending: Ending, hold: SafeHold, gravity: f64, watch_s: f64) -> Stopped {
    let mut config = Config::builtin();
    config.arm.gravity_mps2 = [0.0, 0.0, -gravity];
    config.drives.drives.iter_mut().for_each(|drive| drive.safe_hold = hold);
    let scenario = ScenarioConfig::find("tip").unwrap();
    stop(&config, &TruthSettings::study(1), &scenario, at_s, ending, watch_s, |_, _, _, _| ()).expect("it gets so far")
}

#[test]
fn drives_without_a_master_keep_the_arm_where_it_was() {
    for hold in [SafeHold::Hold, SafeHold::Rest] {
        let shown = ended(Ending::Trouble(trouble("kill", 24, 1).unwrap()), hold);
        assert!(shown.distance_m > 0.0, "{hold:?}: {shown:?}");
        assert!(shown.speed_mps < 0.2 && shown.moved_m < 0.1, "{hold:?}: {shown:?}");
    }
    // What it is for: let go, the same arm springs back.
    let sprung = ended(Ending::Trouble(trouble("kill", 24, 1).unwrap()), SafeHold::Ramp);
    assert!(sprung.speed_mps > 1.0, "{sprung:?}");
}

#[test]
fn a_lost_bus_a_silent_encoder_and_late_ticks_leave_the_arm_held() {
    for (kind, number) in [("bus", 2), ("fault", 1), ("fault", 3)] {
        let shown = ended(Ending::Trouble(trouble(kind, 24, number).unwrap()), SafeHold::Hold);
        assert_eq!(shown.mode, Mode::Faulted, "{kind}: {shown:?}");
        assert!(shown.distance_m > 0.0, "{kind}: {shown:?}");
        assert!(shown.speed_mps < 0.2 && shown.moved_m < 0.1, "{kind}: {shown:?}");
    }
}

#[test]
fn a_drive_that_trips_leaves_its_moments_to_the_others() {
    // Without the others' help the arm falls by more than a tenth of a metre, at 0.2 m/s and more. With it 5 to 68 mm remain: the
    // levers are those of the straight arm, and what turns a bent one about itself is not made up for.
    for number in [0, 4, 8] {
        let shown = ended(Ending::Trouble(trouble("fault", 24, number).unwrap()), SafeHold::Hold);
        assert!(shown.fault.is_some() && shown.mode == Mode::Faulted, "{number}: {shown:?}");
        assert!(shown.speed_mps < 0.1 && shown.moved_m < 0.08, "{number}: {shown:?}");
    }
}

#[test]
fn a_stop_under_gravity_lets_go_of_an_arm_that_rests() {
    // Let go of on its way, it hung swinging for a minute and a half.
    let shown = ended_at(1.3, Ending::Stop, SafeHold::Hold, 4.0, 60.0);
    assert!(shown.rest_s.is_some_and(|rest_s| rest_s < 45.0), "{shown:?}");
    assert!(shown.distance_m > 0.0 && shown.mode == Mode::Disarmed, "{shown:?}");
}

#[test]
fn a_stop_while_the_arm_is_armed_in_a_bent_posture_leads_it_down() {
    let config = Config::builtin();
    let scenario = ScenarioConfig::find("tip").unwrap();
    for after_ticks in [1, 20, 60] {
        let mut bench = Bench::at_start_of(&scenario, &config, &TruthSettings::study(1)).unwrap();
        bench.insert(&scenario.obstacles).unwrap();
        bench.place(&scenario.obstacles, 0.0, config.planner.lookahead_s).unwrap();
        bench.step(Some(Request::Arm));
        (0..after_ticks).for_each(|_| _ = bench.step(None));
        assert_eq!(bench.cycle.mode(), Mode::Starting);
        let mut before = bench.truth.tip().position;
        let start = before;
        let (mut fastest, mut moved, mut mode) = (0.0f64, 0.0f64, bench.step(Some(Request::Stop)).mode);
        for _ in 0..8000 {
            bench.place(&scenario.obstacles, 0.0, config.planner.lookahead_s).unwrap();
            mode = bench.step(None).mode;
            let tip = bench.truth.tip().position;
            fastest = fastest.max((tip - before).norm() / config.timing.period_s);
            moved = moved.max((tip - start).norm());
            before = tip;
            if mode == Mode::Disarmed {
                break;
            }
        }
        assert_eq!(mode, Mode::Disarmed, "after {after_ticks} ticks: {:?}", bench.cycle.supervisor().latch());
        // Before, "disarmed" was told at once, and the arm sprang by more than a metre.
        assert!(fastest < 0.2 && moved > 0.3, "after {after_ticks} ticks: {fastest} m/s, {moved} m");
    }
}
