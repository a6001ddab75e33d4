//! A scenario that is stopped, or cut off, at seeded instants.

use crate::{Args, World, arms, each_seed};
use rand::{RngExt, SeedableRng};
use rand_xoshiro::Xoshiro256PlusPlus;
use sim_plant::stops::{Ending, stop, trouble};
use sinew::config::{SafeHold, ScenarioConfig};
use std::fs::File;
use std::io::{BufWriter, Write};
use std::path::Path;

/// What is done, and to what.
pub struct Stops<'a> {
    pub scenario: &'a str,
    pub kinds: &'a [String],
    pub gravity: Option<f64>,
    pub hold: Option<&'a str>,
    pub duration_s: Option<f64>,
    pub trace: Option<&'a Path>,
}

pub fn run(args: &Args, what: &Stops<'_>) {
    for kind in what.kinds {
        let all = each_seed(args, |seed| {
            let scenario = ScenarioConfig::find(what.scenario).unwrap_or_else(|error| panic!("{error}"));
            let usual = args.world(seed);
            let own = scenario.arm.name != usual.config.arm.name;
            let World { mut config, truth } = if own { arms::world(args, &scenario, seed) } else { usual };
            if let Some(gravity) = what.gravity {
                config.arm.gravity_mps2 = [0.0, 0.0, -gravity];
            }
            if let Some(name) = what.hold {
                let hold = SafeHold::ALL.into_iter().find(|hold| hold.name() == name).expect("hold, rest, ramp, brake");
                config.drives.drives.iter_mut().for_each(|drive| drive.safe_hold = hold);
            }
            let mut rng = Xoshiro256PlusPlus::seed_from_u64(seed);
            let at_s = rng.random_range(0.0..what.duration_s.unwrap_or(scenario.duration_s));
            let (ending, watch_s) = match kind.as_str() {
                "stop" => (Ending::Stop, 200.0),
                "sigterm" => (Ending::Sigterm, 200.0),
                kind => (Ending::Trouble(trouble(kind, config.arm.cable_count(), seed).expect("a kind")), 30.0),
            };
            let mut file = what.trace.map(|path| {
                BufWriter::new(File::create(path).unwrap_or_else(|error| panic!("{}: {error}", path.display())))
            });
            let shown = stop(&config, &truth, &scenario, at_s, ending, watch_s, |bench, now, speed, distance| {
                let Some(file) = &mut file else { return };
                let (tip, led) = (bench.truth.tip().position, bench.cycle.governor().reference_tip());
                let estimate = bench.cycle.estimated_tip();
                let mode = bench.cycle.mode();
                write!(file, "{now:.2},{mode:?},{speed:.4},{distance:.5}").unwrap();
                for v in [tip, led, estimate] {
                    write!(file, ",{:.5},{:.5},{:.5}", v.x, v.y, v.z).unwrap();
                }
                let most = bench.cycle.tensions_n().iter().copied().fold(0.0, f64::max);
                writeln!(file, ",{most:.2},{}", bench.cycle.governor().is_blocked()).unwrap();
            });
            match &shown {
                Ok(s) => println!(
                    "{kind:8} {seed:4} at {at_s:5.1} s: least {:6.1} mm ({:.1} standing still), fastest {:.3} m/s, moved {:6.1} mm, rest {:5.1} s, {:?} {} ({ending:?})",
                    1e3 * s.distance_m,
                    1e3 * s.still_m,
                    s.speed_mps,
                    1e3 * s.moved_m,
                    s.rest_s.unwrap_or(f64::NAN),
                    s.mode,
                    s.fault.as_deref().unwrap_or("")
                ),
                Err(why) => println!("{kind:8} {seed:4} at {at_s:5.1} s: {why}"),
            }
            shown.ok()
        });
        let failed = all.iter().filter(|s| s.is_none()).count();
        let all: Vec<_> = all.into_iter().flatten().collect();
        let contacts = all.iter().filter(|s| s.distance_m < 0.0).count();
        // By its own motion, where an arm that stood still would have had none.
        let own = all.iter().filter(|s| s.distance_m < 0.0 && s.still_m > 0.0).count();
        let least = all.iter().map(|s| s.distance_m).fold(f64::INFINITY, f64::min);
        let most = |of: &dyn Fn(&sim_plant::stops::Stopped) -> f64| all.iter().map(of).fold(0.0, f64::max);
        let unrested = all.iter().filter(|s| s.rest_s.is_none()).count();
        let mut moved: Vec<f64> = all.iter().map(|s| s.moved_m).collect();
        moved.sort_by(f64::total_cmp);
        println!(
            "= {kind}, gravity {}: {} runs, {failed} not begun, {contacts} contacts ({own} by the arm's own motion), least {:.1} mm, fastest {:.3} m/s, moved {:.0} / {:.0} mm (median, most), rest within {:.1} s, {unrested} not at rest",
            what.gravity.map_or("of the arm".to_owned(), |g| format!("{g} m/s^2")),
            all.len(),
            1e3 * least,
            most(&|s| s.speed_mps),
            1e3 * moved.get(moved.len() / 2).copied().unwrap_or(f64::NAN),
            1e3 * most(&|s| s.moved_m),
            most(&|s| s.rest_s.unwrap_or(0.0)),
        );
    }
}
