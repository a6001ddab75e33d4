//! One run of a scenario, step by step.

use super::goals::{Course, CourseError};
use crate::collision::{Body, BodyGeometry, ObstacleSet};
use crate::config::{ScenarioConfig, WarningBranch};
use crate::integrator::{Scheme, Stepper};
use crate::model::{Outputs, State};
use crate::planner::{Deadline, Goal, Inputs, Planner, Report, Status};
use crate::report::{Collector, Tick, tip_error};
use nalgebra::Vector3;
use rand::SeedableRng;
use rand_xoshiro::Xoshiro256PlusPlus;

/// Why a run ended before its time.
#[derive(Debug, thiserror::Error)]
pub enum RunError {
    /// It could not be set up.
    #[error(transparent)]
    Course(#[from] CourseError),
    /// The planned state left the finite numbers.
    #[error("the motion diverged at {0} s")]
    Diverged(f64),
}

/// What happened in one step.
#[derive(Debug, Clone, Copy)]
pub struct Step {
    /// Time at its end (s).
    pub time_s: f64,
    /// The planner's report.
    pub report: Report,
    /// Tip pose and twist reached.
    pub tip: Outputs,
    /// Computing time of the planner (ns).
    pub plan_ns: u64,
}

/// A run in open loop.
#[derive(Debug)]
pub struct Run {
    course: Course,
    planner: Planner,
    /// The model as the plant, where a period is shorter than the lookahead.
    scheme: Scheme,
    stepper: Stepper,
    state: State,
    next: State,
    u: Vec<f64>,
    now: ObstacleSet,
    ahead: ObstacleSet,
    measure: Body,
    positions: Vec<Vector3<f64>>,
    tangents: Vec<Vector3<f64>>,
    along_arm: Vec<f64>,
    at_points: Vec<f64>,
    rng: Xoshiro256PlusPlus,
    steps: u64,
    total: u64,
    seed: u64,
}

/// Most Newton iterations of the model as the plant; a few do.
const PLANT_ITERATIONS_MAX: usize = 30;

/// Time of one step on the caller's clock (ns); without a budget none is ever used.
struct Elapsed<'a> {
    clock: &'a mut dyn FnMut() -> u64,
    begin: u64,
    budget_ns: Option<f64>,
}

impl Deadline for Elapsed<'_> {
    fn used(&mut self) -> f64 {
        self.budget_ns.map_or(0.0, |budget_ns| ((self.clock)() - self.begin) as f64 / budget_ns)
    }
}

impl Run {
    /// Sets a run up at t = 0. Allocates; [`Run::step`] does not.
    ///
    /// # Errors
    /// No start, or an obstacle that cannot be.
    pub fn new(scenario: &ScenarioConfig, seed: u64) -> Result<Self, RunError> {
        let course = Course::new(scenario);
        let arm = &scenario.arm;
        let (state, u) = course.start(arm)?;
        let now = course.obstacles()?;
        let ahead = course.obstacles()?;
        let planner_config = &scenario.planner;
        let (tension, change) = course.tension_weights()?;
        let planner = Planner::new(arm, planner_config, tension, &change);
        let n = arm.node_count();
        Ok(Self {
            measure: Body::with_capacity(
                &BodyGeometry::from_arm(arm),
                planner_config.body,
                planner_config.body_radius_m,
                1,
            ),
            scheme: Scheme::new(arm.rho_inf),
            stepper: Stepper::new(&planner.arm),
            next: state.clone(),
            planner,
            state,
            u,
            positions: vec![Vector3::zeros(); n + 1],
            tangents: vec![Vector3::zeros(); n + 1],
            along_arm: vec![0.0; scenario.obstacles.len()],
            at_points: vec![0.0; scenario.obstacles.len()],
            rng: Xoshiro256PlusPlus::seed_from_u64(seed),
            steps: 0,
            total: (scenario.duration_s / planner_config.period_s).round() as u64,
            seed,
            now,
            ahead,
            course,
        })
    }

    /// Number of steps of the whole run.
    pub fn total(&self) -> u64 {
        self.total
    }

    /// Steps done.
    pub fn steps(&self) -> u64 {
        self.steps
    }

    /// State reached.
    pub fn state(&self) -> &State {
        &self.state
    }

    /// Tensions of the last step (N).
    pub fn tensions(&self) -> &[f64] {
        &self.u
    }

    /// Surface distances per obstacle after the last step: along the whole arm, at the paper's points (m).
    pub fn distances(&self) -> (&[f64], &[f64]) {
        (&self.along_arm, &self.at_points)
    }

    /// Obstacles at the time reached.
    pub fn obstacles(&self) -> &ObstacleSet {
        &self.ahead
    }

    /// The planner.
    pub fn planner(&self) -> &Planner {
        &self.planner
    }

    /// Goals and obstacles over time.
    pub fn course(&self) -> &Course {
        &self.course
    }

    /// Takes another branch for the warning subspace from the next step on.
    pub fn set_warning(&mut self, branch: WarningBranch) {
        self.planner.set_warning(branch);
    }

    /// A collector that fits this run.
    pub fn collector(&self) -> Collector {
        let scenario = self.course.scenario();
        let names: Vec<String> = scenario.obstacles.iter().map(|o| o.id.clone()).collect();
        let cables: Vec<usize> = scenario.arm.segments.iter().map(|s| s.hole_angles_rad.len()).collect();
        Collector::new(&names, &cables, &scenario.arm.tension_maxima_n())
    }

    /// What `plan` would give for the next step with another planner, without moving on: `(cost, report)`.
    pub fn probe(&mut self, planner: &mut Planner) -> Report {
        let (_, goal) = self.look_ahead();
        let inputs = Inputs {
            state: &self.state,
            u_previous: &self.u,
            disturbance: &[],
            led_to: None,
            goal: self.course.goal(goal),
            now: &self.now,
            ahead: &self.ahead,
        };
        planner.plan(&inputs, &mut self.rng.clone(), &mut || false)
    }

    /// Places the obstacles now and at the end of the lookahead; gives the time of the next step's end and that of its
    /// goal (s).
    fn look_ahead(&mut self) -> (f64, f64) {
        let config = self.planner.config();
        let reached = (self.steps + 1) as f64 * config.period_s;
        // Exactly the step's end where it is as long as the lookahead.
        let ahead = reached + (config.lookahead_s - config.period_s);
        let goal = ahead + config.lead_s.unwrap_or(0.0);
        self.course.place(&mut self.now, reached - config.period_s);
        self.course.place(&mut self.ahead, ahead);
        (reached, goal)
    }

    /// Plans over a lookahead and takes one step of a period; `clock` gives nanoseconds and only measures (and ends a step
    /// where the scenario sets a budget).
    ///
    /// # Errors
    /// The motion diverged.
    pub fn step(&mut self, clock: &mut dyn FnMut() -> u64) -> Result<Step, RunError> {
        let (t, goal) = self.look_ahead();
        let begin = clock();
        let budget_ns = self.planner.config().budget_s.map(|b| b * 1e9);
        let inputs = Inputs {
            state: &self.state,
            u_previous: &self.u,
            disturbance: &[],
            led_to: None,
            goal: self.course.goal(goal),
            now: &self.now,
            ahead: &self.ahead,
        };
        let report = self.planner.plan(&inputs, &mut self.rng, &mut Elapsed { clock, begin, budget_ns });
        let plan_ns = clock() - begin;
        self.u.copy_from_slice(self.planner.tensions());
        let (period_s, lookahead_s) = (self.planner.config().period_s, self.planner.config().lookahead_s);
        if period_s == lookahead_s {
            // The paper's setting: what is planned is what happens.
            self.state.copy_from(self.planner.planned());
        } else {
            let (arm, scheme) = (&self.planner.arm, &self.scheme);
            self.stepper
                .step(arm, scheme, period_s, &self.state, &self.u, PLANT_ITERATIONS_MAX, &mut self.next)
                .map_err(|_| RunError::Diverged(t))?;
            self.state.copy_from(&self.next);
            self.course.place(&mut self.ahead, t);
        }
        self.steps += 1;
        if !self.state.is_finite() || report.status == Status::Singular {
            return Err(RunError::Diverged(t));
        }
        self.planner.arm.frames_into(&self.state.q, &mut self.positions, &mut self.tangents);
        let measured = self.measure.measure(&self.positions, &self.tangents, &self.ahead);
        self.along_arm.copy_from_slice(measured.along_arm);
        self.at_points.copy_from_slice(measured.at_points);
        Ok(Step { time_s: t, report, tip: self.planner.arm.tip(&self.state.q, &self.state.qd), plan_ns })
    }

    /// Adds a step to a collector.
    pub fn collect(&self, step: &Step, collector: &mut Collector) {
        let goal = self.course.goal(step.time_s);
        let curvature_error = if let Goal::Shape { curvatures, .. } = goal {
            let mut k = vec![0.0; curvatures.len()];
            let mut kd = k.clone();
            self.planner.arm.curvatures_into(&self.state.q, &self.state.qd, &mut k, &mut kd);
            Some(k.iter().zip(curvatures).fold(0.0f64, |a, (k, d)| a.max((k - d).abs())))
        } else {
            None
        };
        collector.add_report(&step.report);
        let converged = step.report.status == Status::Converged;
        collector.add(&Tick {
            time_s: step.time_s,
            tensions: &self.u,
            along_arm: &self.along_arm,
            at_points: &self.at_points,
            tip_error: tip_error(&goal, &step.tip),
            curvature_error,
            step: Some((step.report.branch, step.report.iterations, converged)),
            swarm_evaluations: step.report.evaluations,
            plan_us: Some(step.plan_ns as f64 / 1e3),
            cycle_us: None,
            wakeup_us: None,
        });
    }

    /// Seed of this run.
    pub fn seed(&self) -> u64 {
        self.seed
    }
}
