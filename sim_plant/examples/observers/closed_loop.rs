//! One closed-loop run: encoders, observer, planner, plant.

use crate::scenario::Scenario;
use clap::ValueEnum;
use nalgebra::Vector3;
use rand::SeedableRng;
use rand_xoshiro::Xoshiro256PlusPlus;
use sim_plant::truth::{Truth, TruthSettings};
use sinew::collision::{Body, BodyGeometry};
use sinew::config::{ArmConfig, BodyModel, FrictionConfig, ObserverConfig, PlannerConfig};
use sinew::control::FrictionCompensation;
use sinew::estimator::Observer;
use sinew::integrator::{Stepper, consistent_start, equilibrium};
use sinew::model::{Arm, State};
use sinew::planner::{Branch, Inputs, Planner};
use std::io::Write;
use std::time::{Duration, Instant};

/// Time for which the start pose is held before a run counts (s).
const APPROACH_S: f64 = 5.0;

/// Length of the run to half of (44) (s).
const HALF_S: f64 = 160.0;

/// A row of the table.
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
pub enum Case {
    /// Holding the start pose.
    Hold,
    /// Along the path without obstacles, with lead.
    Free,
    /// Along the path with obstacles.
    Obstacles,
    /// The same with the demo's clearance of 10 mm.
    Wide,
    /// Capstan friction mu = 0.1, no obstacles, no lead.
    Friction,
    /// The same with friction made up for in the commands.
    Compensated,
    /// Latency (one tick unless told otherwise), compensated; no obstacles, with lead.
    Latency,
    /// Half of (44) held.
    Half,
}

/// What a run needs to know.
pub struct Settings {
    pub scenario: Scenario,
    pub arm: ArmConfig,
    pub observer: ObserverConfig,
    pub planner: PlannerConfig,
    /// Time by which the target is sampled ahead of the end of the lookahead (s).
    pub lead: f64,
    pub open_loop: bool,
    pub compensation: f64,
    /// Ticks of the row with latency.
    pub latency: usize,
    pub duration: f64,
    pub short: f64,
    pub trace: Option<std::path::PathBuf>,
}

/// What a run showed.
#[derive(Debug, Clone, Default)]
pub struct Outcome {
    /// Mean, largest, and last tip error (m).
    pub tip_error: [f64; 3],
    /// Largest quaternion error.
    pub quaternion_error: f64,
    /// Smallest surface distance (m) at the points and along the arm, each with its time (s).
    pub distance_points: (f64, f64),
    pub distance_arm: (f64, f64),
    /// Largest error of the estimated tip (m).
    pub estimate_error: f64,
    /// Root mean square of the change of a tension from tick to tick (N).
    pub roughness: f64,
    /// Largest error of a mean curvature at the end (1/m).
    pub curvature_error: f64,
    /// Largest |z| on the way (rad).
    pub innovation: f64,
    /// Time until the observer had settled (s).
    pub settled_s: f64,
    /// Ticks whose distance rows had no common solution; ticks in the warning subspace; all.
    pub relaxed: usize,
    pub warning: usize,
    pub ticks: usize,
    /// Why the run ended early.
    pub failed: Option<String>,
    /// Mean and largest time of the observer and of the planner per tick.
    pub observer_time: [Duration; 2],
    pub planner_time: [Duration; 2],
}

impl Outcome {
    pub fn line(&self) -> String {
        format!(
            "tip mean {:.2} max {:.2} end {:.2} mm, estimate {:.2} mm, quaternion {:.4}, points {:.2} mm @{:.2}, arm {:.2} mm @{:.2}, rough {:.3} N, curvature {:.4}, z {:.4}, settled {:.2} s, relaxed {}/{}/{}, observer {:?}/{:?}, planner {:?}/{:?} {}",
            1e3 * self.tip_error[0],
            1e3 * self.tip_error[1],
            1e3 * self.tip_error[2],
            1e3 * self.estimate_error,
            self.quaternion_error,
            1e3 * self.distance_points.0,
            self.distance_points.1,
            1e3 * self.distance_arm.0,
            self.distance_arm.1,
            self.roughness,
            self.curvature_error,
            self.innovation,
            self.settled_s,
            self.relaxed,
            self.warning,
            self.ticks,
            self.observer_time[0],
            self.observer_time[1],
            self.planner_time[0],
            self.planner_time[1],
            self.failed.as_deref().unwrap_or("")
        )
    }
}

/// Runs one case with one seed.
pub fn run(settings: &Settings, case: Case, seed: u64) -> Outcome {
    let half = Scenario::half_shape();
    let scenario = if case == Case::Half { &half } else { &settings.scenario };
    let arm = Arm::new(&settings.arm);
    let mut planner_config = settings.planner.clone();
    let avoids = matches!(case, Case::Obstacles | Case::Wide);
    planner_config.avoidance = avoids;
    if case == Case::Wide {
        planner_config.clearance_m = 0.01;
    }
    let mut observer_config = settings.observer.clone();
    let mut plant = TruthSettings::study(seed);
    plant.step_s = plant.step_s.min(planner_config.period_s);
    let mut friction_config = FrictionConfig::NONE;
    match case {
        Case::Friction => plant.capstan_friction = 0.1,
        Case::Compensated => {
            plant.capstan_friction = 0.1;
            friction_config.coefficient = settings.compensation;
        }
        Case::Latency => {
            plant.latency_ticks = settings.latency;
            observer_config.latency_ticks = settings.latency;
        }
        _ => (),
    }
    let h = planner_config.period_s;
    let lead = match case {
        Case::Friction | Case::Compensated => 0.0,
        _ if scenario.is_tip() => settings.lead,
        _ => 0.0,
    };
    let duration = match case {
        Case::Obstacles | Case::Wide | Case::Friction | Case::Compensated => settings.duration,
        // The rate weights make the shape task approach its target with a time constant of 20 s.
        Case::Half => HALF_S,
        _ => settings.short,
    };
    let start = scenario.start(&arm);
    let mut truth = Truth::new(&settings.arm, &plant);
    truth.start_at_equilibrium(&start.tensions, &start.curvatures).expect("the plant rests");
    let mut observer = Observer::new(&settings.arm, &observer_config, h);
    let blind = vec![f64::NAN; arm.cable_count()];
    if settings.open_loop {
        // Its own equilibrium under the same tensions is all that it knows.
        let mut state = State::at_rest(arm.bent(&start.curvatures));
        let mut stepper = Stepper::new(&arm);
        equilibrium(&arm, &mut stepper, &start.tensions, &mut state).expect("the model rests");
        consistent_start(&arm, &mut stepper, &start.tensions, &mut state).expect("the model rests");
        observer.resume(&state);
    } else {
        observer.start(truth.lengths(), &start.tensions).expect("the observer starts");
    }
    let mut planner = Planner::new(&settings.arm, &planner_config, 1.0, &scenario.change());
    let mut rng = Xoshiro256PlusPlus::seed_from_u64(seed);
    let geometry = BodyGeometry::from_arm(truth.config());
    let mut body = Body::with_capacity(&geometry, BodyModel::Arm, 0.0, 16);
    // The paper's points are those of the controller's mesh: mid-points and nodes, which the finer mesh has as nodes.
    let nodes = truth.config().node_count() + 1;
    let (mut r, mut t) = (vec![Vector3::zeros(); nodes], vec![Vector3::zeros(); nodes]);
    let (mut now, mut ahead, mut here) = (scenario.obstacles(), scenario.obstacles(), scenario.obstacles());
    let mut trace = settings.trace.as_ref().map(|p| std::io::BufWriter::new(std::fs::File::create(p).unwrap()));

    let mut friction = FrictionCompensation::new(&friction_config, &arm, h);
    let mut command = start.tensions.clone();
    let mut u = start.tensions.clone();
    let mut outcome =
        Outcome { distance_points: (f64::INFINITY, 0.0), distance_arm: (f64::INFINITY, 0.0), ..Default::default() };
    let mut settled = false;
    let approach_ticks = if scenario.is_tip() { (APPROACH_S / h).round() as usize } else { 0 };
    let mut approached = 0;
    let (mut k, mut before) = (0usize, 0usize);
    let (mut squares, mut sum) = (0.0, 0.0);
    let mut times = [Duration::ZERO; 2];
    while (k as f64) * h < duration {
        let time = k as f64 * h;
        let clock = Instant::now();
        let update = observer.update(&u, if settings.open_loop { &blind } else { truth.lengths() });
        let spent = clock.elapsed();
        times[0] += spent;
        outcome.observer_time[1] = outcome.observer_time[1].max(spent);
        outcome.innovation = outcome.innovation.max(update.innovation_max);
        if update.failed || update.innovation_max.is_nan() || update.innovation_max >= 1.0 {
            outcome.failed = Some(format!("observer failed at {time:.2} s, z {:.3}", update.innovation_max));
            break;
        }
        // Until the observer has settled the tensions are held.
        settled |= update.settled;
        if !settled {
            before += 1;
            outcome.settled_s = before as f64 * h;
            if outcome.settled_s > settings.observer.settle_timeout_s {
                outcome.failed = Some("the observer did not settle".into());
                break;
            }
            if let Err(error) = truth.step(&u, h) {
                outcome.failed = Some(format!("plant while settling: {error}"));
                break;
            }
            continue;
        }
        let approaching = approached < approach_ticks;
        let hold = case == Case::Hold || approaching;
        let begins = time + observer.prediction_s();
        let target = if hold { 0.0 } else { begins + planner_config.lookahead_s + lead };
        scenario.move_obstacles(begins, &mut now);
        scenario.move_obstacles(begins + planner_config.lookahead_s, &mut ahead);
        let clock = Instant::now();
        // Half of (44) is held with the full weight: the ramp of (46) belongs to the paper's example.
        let report = planner.plan(
            &Inputs {
                state: observer.predicted(),
                u_previous: &u,
                disturbance: observer.disturbance(),
                led_to: None,
                goal: scenario.goal(if case == Case::Half { 100.0 } else { target }),
                now: &now,
                ahead: &ahead,
            },
            &mut rng,
            &mut || false,
        );
        let spent = clock.elapsed();
        let estimate = observer.arm().pose(&observer.state().q, arm.node_count()).0;
        let estimate_error = (truth.tip().position - estimate).norm();
        outcome.estimate_error = outcome.estimate_error.max(estimate_error);
        let next = planner.tensions();
        let change: f64 = next.iter().zip(&u).map(|(a, b)| (a - b).powi(2)).sum();
        friction.update(&arm, observer.predicted(), planner.planned());
        for ((command, u), (next, factor)) in command.iter_mut().zip(&mut u).zip(next.iter().zip(friction.factors())) {
            *command = (next / factor).clamp(settings.arm.tension_n_min, settings.arm.tension_n_max);
            *u = *command * factor;
        }
        if let Err(error) = truth.step(&command, h) {
            outcome.failed = Some(format!("plant at {time:.2} s: {error}"));
            break;
        }
        if approaching {
            // The plant rests elsewhere than the model under the same tensions; this brings it to the task's start.
            approached += 1;
            continue;
        }
        times[1] += spent;
        outcome.planner_time[1] = outcome.planner_time[1].max(spent);
        outcome.relaxed += usize::from(report.relaxed);
        outcome.warning += usize::from(report.branch == Branch::Warning);
        k += 1;
        let time = k as f64 * h;
        squares += change / u.len() as f64;
        let tip = truth.tip();
        let error = (tip.position - scenario.position(if hold { 0.0 } else { time })).norm();
        if scenario.is_tip() {
            sum += error;
            outcome.tip_error[1] = outcome.tip_error[1].max(error);
            outcome.tip_error[2] = error;
            let p = tip.quaternion;
            let wanted = Scenario::quaternion();
            outcome.quaternion_error = outcome.quaternion_error.max((p - wanted).norm().min((p + wanted).norm()));
        }
        if avoids {
            truth.frames_into(&mut r, &mut t);
            scenario.move_obstacles(time, &mut here);
            let measured = body.measure(&r, &t, &here);
            let least = |d: &[f64]| d.iter().copied().fold(f64::INFINITY, f64::min);
            let (points, along) = (least(measured.at_points), least(measured.along_arm));
            if points < outcome.distance_points.0 {
                outcome.distance_points = (points, time);
            }
            if along < outcome.distance_arm.0 {
                outcome.distance_arm = (along, time);
            }
        }
        if let Some(file) = &mut trace {
            writeln!(
                file,
                "{time:.3},{error:.6},{:.6},{estimate_error:.6},{:.6},{},{},{:.4},{:.4}",
                report.distance_min,
                update.innovation_max,
                u8::from(report.branch == Branch::Warning),
                u8::from(report.relaxed),
                change.sqrt(),
                report.kkt_residual,
            )
            .unwrap();
        }
        if !scenario.is_tip() {
            let wanted = scenario.curvatures();
            let error = truth.curvatures().iter().zip(wanted).map(|(k, w)| (k - w).abs()).fold(0.0, f64::max);
            outcome.curvature_error = error;
        }
    }
    outcome.ticks = k;
    let n = k.max(1) as f64;
    outcome.tip_error[0] = sum / n;
    outcome.roughness = (squares / n).sqrt();
    outcome.observer_time[0] = times[0].div_f64((k + before).max(1) as f64);
    outcome.planner_time[0] = times[1].div_f64(n);
    outcome
}
