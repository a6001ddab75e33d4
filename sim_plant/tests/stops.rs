//! A motion between obstacles that is cut off: what the true arm does. The long form is `examples/campaign stops`.
#![allow(clippy::unwrap_used, clippy::expect_used)] // a test

use sim_plant::stops::{Ending, Stopped, stop, trouble};
use sim_plant::truth::TruthSettings;
use sinew::config::{Config, SafeHold, ScenarioConfig};
use sinew::control::Mode;

/// A run that ends 3 s after the beginning of the paper's curve.
fn ended(ending: Ending, hold: SafeHold) -> Stopped {
    let mut config = Config::builtin();
    config.drives.drives.iter_mut().for_each(|drive| drive.safe_hold = hold);
    let scenario = ScenarioConfig::find("tip").unwrap();
    stop(&config, &TruthSettings::study(1), &scenario, 3.0, ending, 20.0, |_, _, _, _| ()).expect("it gets so far")
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
