//! Scenarios of any arms, each with its own arm's file and nothing else.

use crate::{Args, World, each_seed};
use sim_plant::follow::{Followed, follow, plant, scaled};
use sinew::config::{Config, ScenarioConfig};
use std::path::{Path, PathBuf};

/// The configuration that an arm's file alone gives: everything else is computed from it. What the body is says the scenario, as
/// in `sinew demo`.
fn alone(scenario: &ScenarioConfig, period: Option<f64>) -> Config {
    let mut config = Config::of_arm(&scenario.arm, period).unwrap_or_else(|error| panic!("{error}"));
    config.planner.body_radius_m = scenario.planner.body_radius_m;
    config
}

pub(crate) fn run(args: &Args, scenarios: &[PathBuf], scales: &[f64], duration: Option<f64>, trace: Option<&Path>) {
    println!("arm                  scale  seed  mean_%  max_% @s  kappa_%  distance_%  rough_%  rate  estimate_%");
    for path in scenarios {
        let original = ScenarioConfig::load(path).unwrap_or_else(|error| panic!("{}", error.report()));
        for scale in scales {
            each_seed(args, |seed| {
                let scenario = scaled(&original, *scale);
                let World { config, mut truth } = args.adapted(alone(&scenario, args.period), seed);
                let own = plant(&config, seed);
                (truth.step_s, truth.encoder_step_m) = (own.step_s, own.encoder_step_m);
                truth.disk_mass_factor = own.disk_mass_factor;
                let mut file = trace.map(|p| std::io::BufWriter::new(std::fs::File::create(p).unwrap()));
                let shown = follow(&config, &truth, &scenario, duration, |bench, now, error| {
                    use std::io::Write;
                    let Some(file) = &mut file else { return };
                    write!(file, "{now:.4},{error:.6}").unwrap();
                    let est = (bench.cycle.estimated_tip() - bench.truth.tip().position).norm();
                    let g = bench.cycle.governor();
                    write!(file, ",{est:.6},{:.6}", (g.reference_tip() - bench.truth.tip().position).norm()).unwrap();
                    let k = bench.truth.curvatures();
                    for i in 0..k.len() {
                        write!(file, ",{:.5},{:.5},{:.5}", g.reference()[i], g.command()[i], k[i]).unwrap();
                    }
                    for u in bench.cycle.tensions_n() {
                        write!(file, ",{u:.5}").unwrap();
                    }
                    writeln!(file).unwrap();
                });
                line(&scenario.name, *scale, seed, &shown);
            });
        }
    }
}

fn line(name: &str, scale: f64, seed: u64, shown: &Result<Followed, String>) {
    match shown {
        Ok(s) => println!(
            "{name:20} {scale:5} {seed:5} {:7.3} {:6.3} {:5.1} {:7.3} {:9.3} {:9.4} {:6.3} {:9.3} {}",
            100.0 * s.error.0,
            100.0 * s.error.1,
            s.worst_s,
            100.0 * s.curvature_error,
            100.0 * s.distance,
            100.0 * s.roughness,
            s.tension_rate,
            100.0 * s.estimate_error,
            s.failed.as_deref().unwrap_or("")
        ),
        Err(why) => println!("{name:20} {scale:5} {seed:5} {why}"),
    }
}
