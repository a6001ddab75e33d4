//! The combined planner, figure 3: Newton on the dynamics with the optimal tensions of each iterate inside it.
//!
//! Per iteration: linearise the step at the iterate, reduce (15) to a quadratic of the tensions, decide between safe
//! and warning subspace (17), solve there, move the iterate. Dynamics and optimisation converge together.

mod guess;
mod pairs;

use super::complementarity::{self, Problem, Solver};
use super::deadline::{Deadline, Shares};
use super::problem::{Goal, Quadratic, tension_cost};
use super::swarm::{Pairs, Swarm, Variant};
use crate::collision::{Body, BodyGeometry, ObstacleSet, WarningState, penalty};
use crate::config::{ArmConfig, PlannerConfig, WarningBranch};
use crate::integrator::{AffineMap, Scheme, Stepper};
use crate::math::chain::Singular;
use crate::model::{Arm, Motion, State};
use guess::Guess;
use nalgebra::Vector3;
use pairs::PairBuffers;
use rand_xoshiro::Xoshiro256PlusPlus;

/// Most pairs of body and obstacle that one step plans with; the nearest are kept.
pub const PAIRS_MAX: usize = 256;
/// A pair of a swarm's particle may miss what the complementarity solution misses and this (m): rounding.
const STRICT_M: f64 = 1e-9;
/// A correction of q beyond this (m, 1) ends the step: the iteration has left the arm. NaN does, too.
const DIVERGED: f64 = 1e3;
/// Beyond the warning distance a pair is still watched within this share of the arm's length: no step moves a point farther.
const REACH: f64 = 0.05 / 2.75;

/// What one planning step works from.
#[derive(Debug, Clone, Copy)]
pub struct Inputs<'a> {
    /// State now.
    pub state: &'a State,
    /// Tensions that were sent last (N).
    pub u_previous: &'a [f64],
    /// Tensions that act beside the commanded ones (N): the observer's estimate of disturbances; empty for none.
    pub disturbance: &'a [f64],
    /// Desired outputs at the end of the lookahead.
    pub goal: Goal<'a>,
    /// Obstacles now (the barrier measures the approach from here).
    pub now: &'a ObstacleSet,
    /// The same obstacles at the end of the lookahead, in the same order.
    pub ahead: &'a ObstacleSet,
    /// Where the arm is led to, if it is.
    pub led_to: Option<LedTo<'a>>,
}

/// A posture that an arm is led to. No pair is asked for more than it has there: who leads has weighed what is possible, within
/// limits that the planner does not know.
#[derive(Debug, Clone, Copy)]
pub struct LedTo<'a> {
    /// Coordinates q (7N).
    pub coordinates: &'a [f64],
    /// What the position of each element may be off by (m): it is kept farther away by that.
    pub doubt_m: &'a [f64],
}

/// Which branch gave the tensions.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Branch {
    /// Safe subspace.
    Safe,
    /// Warning subspace.
    Warning,
}

/// How a planning step ended. None of these is an error: the tensions are bounded and finite in every case.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Status {
    /// Dynamics and optimisation converged: the correction is below `newton_tolerance`, and what chose the tensions is
    /// done with them ([`Report::optimal`]).
    Converged,
    /// The iterations ended without convergence: their configured number was used (in receding use the normal end), or a
    /// swarm without seeds found nothing as good as one, so that standing still means nothing. [`Report::correction`]
    /// and [`Report::optimal`] tell how far it is from done.
    IterationLimit,
    /// The time budget ended the step; the best so far goes out.
    BudgetSpent,
    /// State, goal or last tensions are not finite, the tangent is singular, or the iteration diverges (a correction beyond
    /// 1000, or a last one that moves the nodes by an arm's length each and is not half of the one before): the last
    /// tensions are kept, those that are not numbers at their lower bound. [`Planner::planned`] is then no plan.
    Singular,
}

/// Report of one planning step.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Report {
    /// How it ended.
    pub status: Status,
    /// Which branch planned.
    pub branch: Branch,
    /// Newton iterations of the outer loop.
    pub iterations: usize,
    /// Norm of the last correction of q.
    pub correction: f64,
    /// KKT residual of the last complementarity problem; NaN where the swarm alone planned.
    pub kkt_residual: f64,
    /// Whether what chose the tensions of the last iteration ended by itself: the complementarity problem is solved (its
    /// residual small), or the swarm searched. False where the problem's iteration limit or the budget came first, and
    /// where a swarm without seeds found nothing as good as one, so that standing still means nothing.
    pub optimal: bool,
    /// True where the distance rows of the last iteration had no common solution and were relaxed, those among them that
    /// tensions move at all.
    pub relaxed: bool,
    /// Pairs of the last iteration that no tensions of the arm bring to the required distance. They are asked for what is
    /// possible; the rest of the plan is not given up for them.
    pub hopeless: usize,
    /// True where the last iteration left pairs out that may matter: more were within reach than [`PAIRS_MAX`] (the nearest
    /// were kept), or more were violated than the complementarity problem works with at once
    /// ([`Solver::WORKING_MAX`]). Such a plan is never [`Report::optimal`].
    pub truncated: bool,
    /// Newton iterations of the complementarity problems of the whole step.
    pub solver_iterations: usize,
    /// Swarm sweeps of the whole step.
    pub sweeps: usize,
    /// Swarm evaluations of the whole step.
    pub evaluations: usize,
    /// Cost (15a) at the planned state.
    pub cost: f64,
    /// Smallest surface distance less the inflation (m) of the state that was looked at last, mostly the iterate before
    /// the last correction; the planned state itself is that much off. Infinite without obstacles.
    pub distance_min: f64,
}

/// The combined planner of one arm; everything is made by [`Planner::new`].
#[derive(Debug, Clone)]
pub struct Planner {
    /// Its arm.
    pub arm: Arm,
    config: PlannerConfig,
    scheme: Scheme,
    stepper: Stepper,
    map: AffineMap,
    quadratic: Quadratic,
    solver: Solver,
    swarm: Swarm,
    body: Body,
    warning: WarningState,
    weight_tension: f64,
    weight_change: Vec<f64>,
    box_low: Vec<f64>,
    box_high: Vec<f64>,
    rate_max: f64,
    /// Norm of a correction that moves every node by the arm's length (m): a last one beyond it is no way to a solution
    /// unless it is half of the one before. Two iterations of the paper's tip example leave 0.09, the norm here is 12.
    far: f64,
    /// Beyond the warning distance a pair is still watched within this (m).
    watch_m: f64,
    low: Vec<f64>,
    high: Vec<f64>,
    /// u_{k-1} inside the box.
    previous: Vec<f64>,
    u: Vec<f64>,
    effective: Vec<f64>,
    candidate: Vec<f64>,
    /// u^(j) as the last swarm had it among its seeds, how many seeds it had, and its bounds of violation, per pair; empty
    /// for none.
    iterate: Vec<f64>,
    seeds: usize,
    strict: Vec<f64>,
    next: State,
    frames: Frames,
    frames_now: Frames,
    frames_led: Frames,
    /// Tangents of the nodes 0..=N at zero tension, and their derivatives, 3 x cables each; the base's stay zero.
    tangent_origin: Vec<Vector3<f64>>,
    tangent: Vec<f64>,
    tangent_known: Vec<bool>,
    pairs: PairBuffers,
    guess: Guess,
    scratch: Vec<f64>,
}

#[derive(Debug, Clone)]
struct Frames {
    r: Vec<Vector3<f64>>,
    t: Vec<Vector3<f64>>,
}

impl Planner {
    /// Builds all buffers. `change` is W's diagonal entry per segment, `tension` R's (both as in the paper, for a
    /// period equal to the lookahead; W is multiplied by lookahead/period here). Allocates; [`Planner::plan`] does not.
    pub fn new(arm_config: &ArmConfig, config: &PlannerConfig, tension: f64, change: &[f64]) -> Self {
        let arm = Arm::new(arm_config);
        let (n, nc) = (arm.node_count(), arm.cable_count());
        let body =
            Body::with_capacity(&BodyGeometry::from_arm(arm_config), config.body, config.body_radius_m, PAIRS_MAX);
        let frames = || Frames { r: vec![Vector3::zeros(); n + 1], t: vec![Vector3::zeros(); n + 1] };
        let pace = config.lookahead_s / config.period_s;
        Self {
            config: config.clone(),
            scheme: super::prediction(config, arm_config.rho_inf),
            stepper: Stepper::new(&arm),
            map: AffineMap::new(&arm),
            quadratic: Quadratic::new(&arm),
            solver: Solver::new(nc, PAIRS_MAX),
            swarm: Swarm::new(nc, &config.swarm, 3),
            body,
            warning: WarningState::from_config(config),
            weight_tension: tension,
            weight_change: arm.cable_segment.iter().map(|&s| change[s] * pace).collect(),
            box_low: vec![arm_config.tension_n_min; nc],
            box_high: arm_config.tension_maxima_n(),
            rate_max: arm_config.tension_rate_npsmax * config.period_s,
            far: (n as f64).sqrt() * arm_config.length_m(),
            watch_m: REACH * arm_config.length_m(),
            low: vec![0.0; nc],
            high: vec![0.0; nc],
            previous: vec![0.0; nc],
            u: vec![0.0; nc],
            effective: vec![0.0; nc],
            candidate: vec![0.0; nc],
            iterate: vec![0.0; nc],
            seeds: 0,
            strict: Vec::with_capacity(PAIRS_MAX),
            next: State::at_rest(arm.straight()),
            frames: frames(),
            frames_now: frames(),
            frames_led: frames(),
            tangent_origin: vec![Vector3::zeros(); n + 1],
            tangent: vec![0.0; 3 * (n + 1) * nc],
            tangent_known: vec![false; n + 1],
            pairs: PairBuffers::new(nc),
            guess: Guess::new(),
            scratch: vec![0.0; 4 * arm.segment_count()],
            arm,
        }
    }

    /// Tensions of the last plan (N), inside the box always.
    pub fn tensions(&self) -> &[f64] {
        &self.u
    }

    /// State planned for the end of the lookahead.
    pub fn planned(&self) -> &State {
        &self.next
    }

    /// Settings.
    pub fn config(&self) -> &PlannerConfig {
        &self.config
    }

    /// Takes another branch for the warning subspace from the next step on.
    pub fn set_warning(&mut self, branch: WarningBranch) {
        self.config.warning = branch;
    }

    /// Forgets what earlier steps left: the next one is planned from cold. Does not allocate.
    pub fn forget(&mut self) {
        self.guess.forget();
        self.warning = WarningState::from_config(&self.config);
    }

    /// The body that distances are measured from.
    pub fn body_mut(&mut self) -> &mut Body {
        &mut self.body
    }

    /// How much better the last swarm's answer is than the best of its seeds in the cost (28): never below zero. `None`
    /// where the last plan's last iteration searched with no swarm. `obstacles` is the set that the plan had ahead. An
    /// evaluation of its own, plain and slow, for benches and tests. Does not allocate.
    pub fn seed_margin(&self, obstacles: &ObstacleSet) -> Option<f64> {
        let seeds = [&self.previous, &self.iterate, &self.candidate];
        let best = seeds[..self.seeds].iter().map(|u| self.swarm_cost(u, obstacles)).fold(f64::INFINITY, f64::min);
        let answer = self.swarm_cost(self.swarm.answer(), obstacles);
        // Near a target both are small differences of terms as large as the cost at no tension: rounding is no margin.
        let rounding = 1e-12 * self.quadratic.c.abs();
        // Where no seed has a finite cost, any answer will do.
        let equal = !best.is_finite() || (best - answer).abs() <= rounding;
        (self.seeds > 0).then_some(if equal { 0.0 } else { best - answer })
    }

    /// Cost (28) of tensions in the last swarm's problem.
    fn swarm_cost(&self, u: &[f64], obstacles: &ObstacleSet) -> f64 {
        let mut cost = self.quadratic.cost(u);
        for (r, row) in self.pairs.rows.iter().enumerate() {
            let d = obstacles.moved_distance(row, &self.pairs.position(r, u)) - self.pairs.required[r];
            let clearance = self.config.clearance_m;
            cost += self.config.swarm.penalty * penalty(d + clearance, clearance, self.pairs.length[r]).0;
            if self.strict.get(r).is_some_and(|limit| -d > *limit) {
                return f64::INFINITY;
            }
        }
        cost
    }

    /// Plans one step. `deadline` is asked at the begin of each Newton iteration, when it is linearised and when it
    /// ends, and after each piece of work in between: a Newton iteration of the complementarity problem, a sweep. Every
    /// iteration but the last allowed one may use half of what is left, and none is begun whose linearisation would not
    /// fit. After the end at most one such piece of work follows in each branch. Does not allocate.
    pub fn plan(&mut self, inputs: &Inputs<'_>, rng: &mut Xoshiro256PlusPlus, deadline: &mut dyn Deadline) -> Report {
        let mut shares = Shares::new(deadline);
        let eta = self.config.lookahead_s;
        let rates = self.scheme.rates(eta);
        let mut next = std::mem::take(&mut self.next);
        self.scheme.predict(eta, inputs.state, &mut next);
        for i in 0..self.u.len() {
            let u = inputs.u_previous[i];
            let u = if u.is_nan() { self.box_low[i] } else { u.clamp(self.box_low[i], self.box_high[i]) };
            self.low[i] = (u - self.rate_max).max(self.box_low[i]);
            self.high[i] = (u + self.rate_max).min(self.box_high[i]);
            self.previous[i] = u;
        }
        self.u.copy_from_slice(&self.previous);
        let mut report = Report {
            status: Status::IterationLimit,
            branch: Branch::Safe,
            iterations: 0,
            correction: f64::INFINITY,
            kkt_residual: 0.0,
            optimal: false,
            relaxed: false,
            hopeless: 0,
            truncated: false,
            solver_iterations: 0,
            sweeps: 0,
            evaluations: 0,
            cost: f64::NAN,
            distance_min: f64::INFINITY,
        };
        self.seeds = 0;
        let (mut warning, mut before) = (false, f64::INFINITY);
        let obstacles = self.config.avoidance && !inputs.ahead.is_empty();
        self.arm.frames_into(&inputs.state.q, &mut self.frames_now.r, &mut self.frames_now.t);
        if let Some(led) = inputs.led_to {
            self.arm.frames_into(led.coordinates, &mut self.frames_led.r, &mut self.frames_led.t);
            self.body.set_doubt(led.doubt_m);
        }
        // Where the last tensions are unknown there is nothing to plan a change from.
        if inputs.u_previous.iter().any(|u| u.is_nan()) {
            report.status = Status::Singular;
        }
        while report.status != Status::Singular && report.iterations < self.config.newton_iterations_max {
            shares.begin(report.iterations, self.config.newton_iterations_max);
            // A step that once was in the warning subspace stays there.
            if obstacles {
                warning |= self.watch(&next, inputs, &mut report);
            }
            if self.linearize(&next, inputs, rates).is_err() {
                report.status = Status::Singular;
                break;
            }
            self.quadratic.build(
                &self.arm,
                &next,
                rates,
                &self.map,
                &inputs.goal,
                self.weight_tension,
                &self.weight_change,
                &self.previous,
            );
            self.account_for_disturbance(inputs.disturbance);
            if !self.quadratic.is_finite() {
                report.status = Status::Singular;
                break;
            }
            shares.prepared();
            let stop: &mut dyn FnMut() -> bool = &mut || shares.iteration_is_over();
            report.branch = if warning { Branch::Warning } else { Branch::Safe };
            match report.branch {
                Branch::Safe => self.solve_safe(stop, &mut report),
                Branch::Warning => self.solve_warning(&next, inputs, rng, stop, &mut report),
            }
            for i in 0..self.u.len() {
                self.effective[i] = self.u[i] + inputs.disturbance.get(i).copied().unwrap_or(0.0);
            }
            before = report.correction;
            report.correction = self.stepper.advance(&self.arm, &self.effective, rates, &mut next);
            report.iterations += 1;
            if report.correction.is_nan() || report.correction > DIVERGED {
                report.status = Status::Singular;
                break;
            }
            if report.correction < self.config.newton_tolerance {
                // A safe plan may have ended inside the warning distance: then it is not yet a plan.
                if obstacles && !warning {
                    warning = self.watch(&next, inputs, &mut report);
                }
                let planned = warning == (report.branch == Branch::Warning);
                // A problem that ran into its limit goes on from where it is; a swarm that found nothing stands still, and
                // so does what has no room for its pairs.
                let stands = report.truncated || self.config.warning == WarningBranch::StandardSwarm;
                if planned && (report.optimal || stands) {
                    if report.optimal {
                        report.status = Status::Converged;
                    }
                    break;
                }
            }
            if shares.is_over() {
                report.status = Status::BudgetSpent;
                break;
            }
        }
        if report.iterations > 1 && report.correction > self.far && report.correction > 0.5 * before {
            report.status = Status::Singular;
        }
        if report.status == Status::Singular {
            // Nothing that was computed can be trusted: hold what is known to be bounded.
            self.u.copy_from_slice(&self.previous);
            self.guess.forget();
        }
        self.scheme.finish(inputs.state, &mut next);
        report.cost = inputs.goal.error_cost(&self.arm, &next, &mut self.scratch)
            + tension_cost(self.weight_tension, &self.weight_change, &self.u, &self.previous);
        self.next = next;
        report
    }

    /// Finds the pairs within reach of the iterate and decides on the subspace: true for the warning subspace.
    fn watch(&mut self, next: &State, inputs: &Inputs<'_>, report: &mut Report) -> bool {
        let c = &self.config;
        self.arm.frames_into(&next.q, &mut self.frames.r, &mut self.frames.t);
        let reach = c.clearance_m + c.warning_margin_m() + c.warning_hysteresis_m + self.watch_m;
        let found = self.body.find(&self.frames.r, &self.frames.t, inputs.ahead, reach);
        report.distance_min = found.minimum;
        self.pairs.rows.clear();
        self.pairs.rows.extend_from_slice(found.rows);
        self.pairs.overflow = found.overflow > 0;
        self.warning.update(found.minimum)
    }

    fn linearize(&mut self, next: &State, inputs: &Inputs<'_>, rates: crate::model::Rates) -> Result<(), Singular> {
        for i in 0..self.u.len() {
            self.effective[i] = self.u[i] + inputs.disturbance.get(i).copied().unwrap_or(0.0);
        }
        self.stepper.linearize(&self.arm, &Motion::from(next), &self.effective, rates)?;
        self.stepper.affine_map_into(&self.arm, &mut self.map);
        Ok(())
    }

    /// The quadratic was built for the tensions that act; shift it to the tensions that are commanded.
    fn account_for_disturbance(&mut self, disturbance: &[f64]) {
        if disturbance.is_empty() {
            return;
        }
        let n = self.u.len();
        for i in 0..n {
            // S_y^T Q S_y w: A without the weights on the commanded tensions.
            let weights = self.weight_tension + self.weight_change[i];
            let row: f64 = self.quadratic.a[i * n..(i + 1) * n].iter().zip(disturbance).map(|(a, w)| a * w).sum();
            self.candidate[i] = row - weights * disturbance[i];
        }
        // (e0 + S(u + w))^T Q (e0 + S(u + w)): linear part gains S^T Q S w, constant part 2 b_y.w + w^T S^T Q S w.
        for i in 0..n {
            let change = &self.weight_change[i];
            let b_output = self.quadratic.b[i] + change * self.previous[i];
            self.quadratic.c += disturbance[i] * (2.0 * b_output + self.candidate[i]);
        }
        for i in 0..n {
            self.quadratic.b[i] += self.candidate[i];
        }
    }

    fn solve_safe(&mut self, stop: &mut dyn FnMut() -> bool, report: &mut Report) {
        let problem = Problem {
            a: &self.quadratic.a,
            b: &self.quadratic.b,
            lower: &self.low,
            upper: &self.high,
            c: &[],
            d: &[],
            price: &[],
        };
        let solved = self.solver.solve(&problem, &mut self.u, stop);
        self.guess.forget();
        report.solver_iterations += solved.iterations;
        report.kkt_residual = solved.kkt_residual;
        report.optimal = solved.status == complementarity::Status::Optimal;
    }

    fn solve_warning(
        &mut self,
        next: &State,
        inputs: &Inputs<'_>,
        rng: &mut Xoshiro256PlusPlus,
        stop: &mut dyn FnMut() -> bool,
        report: &mut Report,
    ) {
        self.linearize_pairs(next, inputs, report);
        let rows = self.pairs.rows.len();
        let nc = self.u.len();
        let branch = self.config.warning;
        let complementarity = matches!(branch, WarningBranch::Seeded | WarningBranch::Complementarity);
        self.strict.clear();
        if complementarity {
            self.candidate.copy_from_slice(&self.u);
            let problem = Problem {
                a: &self.quadratic.a,
                b: &self.quadratic.b,
                lower: &self.low,
                upper: &self.high,
                c: &self.pairs.c[..rows * nc],
                d: &self.pairs.d[..rows],
                price: &self.pairs.price[..rows],
            };
            self.guess.guess_into(&self.pairs.rows, inputs.ahead, &mut self.pairs.multiplier);
            let solved = self.solver.solve_warm(&problem, &self.pairs.multiplier[..rows], &mut self.candidate, stop);
            let multipliers = self.solver.multipliers();
            // A pair that gave way where it may is as good as any; a hard row that did is a conflict.
            let sold = solved.status == complementarity::Status::Relaxed
                && multipliers[..rows].iter().any(|multiplier| *multiplier >= self.pairs.hard * (1.0 - 1e-9));
            let status = match solved.status {
                complementarity::Status::Relaxed if !sold => complementarity::Status::Optimal,
                status => status,
            };
            self.guess.keep(&self.pairs.rows, inputs.ahead, multipliers, status);
            report.solver_iterations += solved.iterations;
            report.truncated |= solved.status == complementarity::Status::Overfull;
            report.optimal = solved.status.is_optimal() && !report.truncated;
            report.kkt_residual = solved.kkt_residual;
            report.relaxed |= sold;
            if branch == WarningBranch::Complementarity {
                self.u.copy_from_slice(&self.candidate);
                return;
            }
            // A candidate that was not solved to its end may ignore rows: a seed like any other, no measure of what can
            // be kept.
            if solved.status.is_optimal() {
                for (r, row) in self.pairs.rows.iter().enumerate() {
                    let at = self.pairs.position(r, &self.candidate);
                    let missing = self.pairs.required[r] - inputs.ahead.moved_distance(row, &at);
                    self.strict.push(missing.max(0.0) + STRICT_M);
                }
            }
        } else {
            report.kkt_residual = f64::NAN;
            report.optimal = !report.truncated;
        }
        let pairs = Pairs {
            rows: &self.pairs.rows,
            required: &self.pairs.required,
            length: &self.pairs.length,
            clearance: self.config.clearance_m,
            origin: &self.pairs.origin[..3 * rows],
            slope: &self.pairs.slope[..3 * rows * nc],
            obstacles: inputs.ahead,
        };
        self.iterate.copy_from_slice(&self.u);
        let all: [&[f64]; 3] = [&self.previous, &self.iterate, &self.candidate];
        let seeds = if complementarity { &all[..] } else { &all[..2] };
        self.seeds = seeds.len();
        let variant = if branch == WarningBranch::StandardSwarm { Variant::Standard } else { Variant::Improved };
        let found = self.swarm.search(
            variant,
            &self.config.swarm,
            &self.quadratic,
            &pairs,
            &self.low,
            &self.high,
            seeds,
            &self.strict,
            rng,
            stop,
        );
        report.sweeps += found.sweeps;
        report.evaluations += found.evaluations;
        // A swarm that knows no seeds and found nothing as good as one cannot confirm it.
        report.optimal &= found.found();
        if found.cost.is_finite() {
            self.u.copy_from_slice(self.swarm.answer());
        }
    }
}
