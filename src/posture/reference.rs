//! A posture that moves as it is told, and around obstacles.
//!
//! Each step solves, for the change `delta` of the mean curvatures,
//!
//! ```text
//! minimise   |J delta - t|^2 (tip)  +  w |delta - drift|^2
//! subject to n . J_p delta >= -(rate of the obstacle) h - alpha h (d - d_s)     every pair within reach
//!            no point of the arm faster, and no faster sped up, than evasion permits
//! ```
//!
//! at the equilibrium that it is at. The rows are a barrier (Ames et al. 2019): the share `alpha` of the distance that is
//! left may be used up per second, and what the obstacle takes by its own motion is given way for. What cannot be had is
//! given up at the price of distance, never at the price of speed.

use super::rest::{POSE, RestingArm};
use crate::collision::{Body, BodyGeometry, OBSTACLES_MAX, Obstacle, ObstacleSet, Proximity};
use crate::config::{ArmConfig, BodyModel};
use crate::math::block_tridiagonal::COORDINATES;
use crate::math::chain::Singular;
use crate::math::dense;
use crate::math::quaternion::rotation_jacobians;
use crate::model::Arm;
use crate::planner::complementarity::{Problem, Solver, exact_price};
use nalgebra::Vector3;

/// Limits of a reference.
#[derive(Debug, Clone, PartialEq)]
pub struct ReferenceSettings {
    /// Distance kept between surfaces (m).
    pub clearance_m: f64,
    /// Share of the distance above it that may be used up per second (1/s).
    pub approach_1ps: f64,
    /// Pairs farther apart than this above the clearance are not looked at (m).
    pub reach_m: f64,
    /// Largest speed of any point of the arm (m/s) ...
    pub evasion_mps: f64,
    /// ... and change of it (m/s^2).
    pub evasion_mps2: f64,
    /// Speed with which it withdraws from an obstacle that is too near but does not come nearer (m/s).
    pub withdrawal_mps: f64,
    /// Root mean square speed of the arm's mass up to which the tip keeps its task (m/s): what an obstacle asks for beyond it
    /// costs the task, for a posture that turns over itself to hold a tip still swings.
    pub quiet_mps: f64,
    /// Range of the tensions of each segment's cables that a posture may need (N).
    pub tension_range_n: Vec<f64>,
}

/// What a step is to do.
#[derive(Debug, Clone, Copy)]
pub struct Wanted<'a> {
    /// Change of the mean curvatures over the step (1/m), where nothing else counts.
    pub drift: &'a [f64],
    /// Its weight against the tip's (m^2 per squared bend angle).
    pub drift_weight: f64,
    /// Change of the tip's pose over the step (m, base frame; rad, tip frame), and weights of its rows; `None` for none.
    pub tip: Option<([f64; POSE], [f64; POSE])>,
}

/// Obstacles as a step sees them.
#[derive(Debug, Clone, Copy)]
pub struct Surroundings<'a> {
    /// At one time ...
    pub now: &'a ObstacleSet,
    /// ... and `span_s` later, in the same order.
    pub ahead: &'a ObstacleSet,
    /// Between them (s).
    pub span_s: f64,
    /// Time of the step's beginning after `ahead` (s).
    pub beyond_s: f64,
}

/// What a step met.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Met {
    /// Smallest distance of the reference (m); infinite without obstacles.
    pub distance_min: f64,
    /// Rows that had to be given up in part.
    pub given_up: usize,
    /// Largest load of a segment's cables; 1 is all that they can give.
    pub load_max: f64,
    /// Whether some row held the step back.
    pub held_back: bool,
    /// Whether an obstacle did.
    pub hindered: bool,
}

/// Loads are looked at when less than this share is left.
const LOAD_NEAR: f64 = 0.3;
/// Share of what is left of a load that may be used up, over the share of a distance.
const APPROACH_BOUND: f64 = 4.0;
/// Time over which the speed of the arm's mass is looked at, times the approach.
const PACE: f64 = 0.1;
/// Keeps the projection of a swing regular where curvatures move hardly any mass, over the mean of the diagonal.
const SWING_DAMPED: f64 = 1e-3;
/// What the mean squared displacement of the arm's mass costs, over that of the tip.
const MOTION_SHARE: f64 = 2.5e-4;
/// What its change from one step to the next costs, times the approach and the step's time: accelerations make the arm swing.
const CHANGE_SHARE: f64 = 2e-4;
/// The same with obstacles around: what gives way to them does so smoothly, and what does not is not in a hurry.
const CHANGE_SHARE_AROUND: f64 = 4e-4;
/// What a tip's error is counted in, over the arm's length: 1 m on the paper's.
const UNIT: f64 = 1.0 / 2.75;
/// Most pairs that a step looks at.
const PAIRS_MAX: usize = 128;
/// Share of the distance that a slow obstacle may take by its own motion, over that of the approach: what begins early begins
/// softly.
const GIVING_WAY: f64 = 0.6;
/// Growth of an obstacle by more than this share of the reach per second is a jump, of which the barrier takes its share.
const GROWTH_MAX_1PS: f64 = 1.65;
/// Share of the distance above the clearance that a ball which is dodged may use up, over that of the approach ...
const CLOSING: f64 = 6.0;
/// ... once its way in this time is taken off, times the approach: until the arm has answered.
const REACTION: f64 = 0.1;
/// Largest rate of a bend angle where there is nothing to give way to, over the approach (rad).
const FREE_RAD: f64 = 3.0;
/// By how much an obstacle's speed raises that of giving way.
const URGENCY: f64 = 3.0;
/// Balls slower than this share of the withdrawal's speed are given way to as they come.
const DODGE_SLOWEST: f64 = 0.5;
/// A ball that meets the body within this time is given way to aside, times the approach ...
const DODGE: f64 = 1.25;
/// ... by the clearance and its way in this time, times the approach.
const DODGE_MARGIN: f64 = 0.1;
/// Moving obstacles are looked for so much farther away than resting ones, at most.
const FARTHER: f64 = 6.6;
/// A pair that bends of this much cannot bring to the clearance (rad) is only kept from getting nearer.
const HOPELESS_RAD: f64 = 1.5;

/// The reference of one arm. [`Reference::new`] allocates, nothing else does.
#[derive(Debug, Clone)]
pub struct Reference {
    settings: ReferenceSettings,
    rest: RestingArm,
    body: Body,
    positions: Vec<Vector3<f64>>,
    tangents: Vec<Vector3<f64>>,
    rows: Vec<Proximity>,
    /// Growth of the obstacles in the step before (m).
    growth: Vec<f64>,
    solver: Solver,
    /// Length of the segment of each curvature (m).
    length: Vec<f64>,
    a: Vec<f64>,
    b: Vec<f64>,
    low: Vec<f64>,
    high: Vec<f64>,
    c: Vec<f64>,
    d: Vec<f64>,
    price: Vec<f64>,
    sensitivity: Vec<f64>,
    /// Derivatives of the segments' ends by the curvatures, three rows for each (m per 1/m).
    ends: Vec<f64>,
    delta: Vec<f64>,
    next: Vec<f64>,
    /// Root mean square speed of the arm's mass, lately, while obstacles or loads hold it back (m/s).
    pace_mps: f64,
    /// What a tip's error is counted in (m).
    unit_m: f64,
    /// Mass of the arm (kg), and its distribution over the curvatures (kg m^4).
    mass: f64,
    inertia: Vec<f64>,
}

impl Reference {
    /// For an arm. Allocates.
    pub fn new(arm: &Arm, config: &ArmConfig, body_radius_m: f64, settings: &ReferenceSettings) -> Self {
        let count = 2 * arm.segment_count();
        let n = arm.node_count();
        Self {
            settings: settings.clone(),
            rest: RestingArm::new(arm),
            body: Body::with_capacity(&BodyGeometry::from_arm(config), BodyModel::Arm, body_radius_m, PAIRS_MAX),
            positions: vec![Vector3::zeros(); n + 1],
            tangents: vec![Vector3::zeros(); n + 1],
            rows: Vec::with_capacity(PAIRS_MAX),
            growth: Vec::with_capacity(OBSTACLES_MAX),
            solver: Solver::new(count, PAIRS_MAX + count),
            length: segment_lengths(arm),
            a: vec![0.0; count * count],
            b: vec![0.0; count],
            low: vec![0.0; count],
            high: vec![0.0; count],
            c: vec![0.0; (PAIRS_MAX + count) * count],
            d: vec![0.0; PAIRS_MAX + count],
            price: vec![0.0; PAIRS_MAX + count],
            sensitivity: vec![0.0; count],
            ends: vec![0.0; 3 * arm.segment_count() * count],
            delta: vec![0.0; count],
            next: vec![0.0; count],
            pace_mps: 0.0,
            unit_m: UNIT * config.length_m(),
            mass: arm.nodes.iter().map(|node| node.mass).sum(),
            inertia: vec![0.0; count * count],
        }
    }

    /// Takes over what friction leaves of the tensions at each passage, see [`Arm::take_shares`].
    pub fn take_shares(&mut self, shares: &[f64]) {
        self.rest.take_shares(shares);
    }

    /// The equilibrium that it is at.
    pub fn rest(&self) -> &RestingArm {
        &self.rest
    }

    /// The equilibrium, to start from another one.
    pub fn rest_mut(&mut self) -> &mut RestingArm {
        &mut self.rest
    }

    /// Sensitivity of the segments' ends to the curvatures by the last linearisation (m per 1/m), three rows for each.
    pub fn ends(&self) -> &[f64] {
        &self.ends
    }

    /// What the position of each element may be off by (m): it keeps so much farther away.
    pub fn set_doubt(&mut self, doubt_m: &[f64]) {
        self.body.set_doubt(doubt_m);
    }

    /// Change of the mean curvatures in the last step (1/m).
    pub fn delta(&self) -> &[f64] {
        &self.delta
    }

    /// Linearises at the present posture under tensions `u` (N); before [`Reference::step`]. Writes the swing of an arm of
    /// coordinates `q` and mean curvatures `kappa` beside it, as the motion in curvatures that is nearest to it (1/m).
    ///
    /// # Errors
    /// The static tangent is singular.
    pub fn linearize(&mut self, u: &[f64], q: &[f64], kappa: &[f64], swing: &mut [f64]) -> Result<(), Singular> {
        self.rest.linearize(u)?;
        let count = swing.len();
        self.rest.swing_into(q, kappa, &mut self.inertia, swing, &mut self.sensitivity);
        for (segment, range) in self.rest.arm().segment_elements.iter().enumerate() {
            for x in 0..3 {
                self.rest.coordinate_into(COORDINATES * (range.end - 1) + x, &mut self.sensitivity);
                let at = (3 * segment + x) * count;
                self.ends[at..at + count].copy_from_slice(&self.sensitivity);
            }
        }
        self.a.copy_from_slice(&self.inertia);
        let trace: f64 = (0..count).map(|i| self.inertia[i * count + i]).sum();
        for i in 0..count {
            self.a[i * count + i] += SWING_DAMPED * trace / count as f64;
        }
        if !dense::solve_in_place(count, &mut self.a, swing) {
            swing.fill(0.0);
        }
        Ok(())
    }

    /// One step of `h` seconds from the last linearisation. Does not allocate.
    pub fn step(&mut self, h: f64, wanted: &Wanted<'_>, around: Option<&Surroundings<'_>>) -> Met {
        let count = self.delta.len();
        let mut met = Met { distance_min: f64::INFINITY, ..Met::default() };
        self.a.fill(0.0);
        for i in 0..count {
            let w = wanted.drift_weight * self.length[i] * self.length[i];
            self.a[i * count + i] = w;
            self.b[i] = -w * wanted.drift[i];
        }
        let threat_mps = around.map_or(0.0, |around| self.threat(h, around));
        let (mut pairs, mut share) = (0, CHANGE_SHARE);
        if let Some(around) = around.filter(|around| !around.ahead.is_empty()) {
            share = CHANGE_SHARE_AROUND;
            self.bound_motion(h);
            pairs = self.pair_rows(h, around, &mut met);
        } else {
            for (i, length) in self.length.iter().enumerate() {
                (self.low[i], self.high[i]) = (
                    -FREE_RAD * self.settings.approach_1ps * h / length,
                    FREE_RAD * self.settings.approach_1ps * h / length,
                );
            }
        }
        if wanted.tip.is_some() {
            // Of all ways to move the tip the one that moves least mass, and changes its motion least.
            let motion = MOTION_SHARE * (self.pace_mps / self.settings.quiet_mps).max(1.0).powi(4);
            let change = share / (self.settings.approach_1ps * h);
            for i in 0..count {
                for j in 0..count {
                    let m = self.inertia[i * count + j] / self.mass;
                    self.a[i * count + j] += (motion + change) * m;
                    self.b[i] -= change * m * self.delta[j];
                }
            }
        }
        if let Some((change, weights)) = &wanted.tip {
            for r in 0..POSE {
                let row = &self.rest.jacobian()[r * count..(r + 1) * count];
                for i in 0..count {
                    let f = weights[r] * row[i];
                    self.b[i] -= f * change[r];
                    for j in 0..count {
                        self.a[i * count + j] += f * row[j];
                    }
                }
            }
        }
        if wanted.tip.is_some() {
            // In squares of a length until here; the price of rows is for numbers without a unit.
            let share = self.unit_m.powi(-2);
            self.a.iter_mut().chain(&mut self.b).for_each(|x| *x *= share);
        }
        let rows = self.tension_rows(h, pairs, &mut met);
        self.delta.copy_from_slice(wanted.drift);
        for i in 0..count {
            self.delta[i] = self.delta[i].clamp(self.low[i], self.high[i]);
        }
        let hard = exact_price(&self.a, &self.b, (0..rows).map(|r| &self.c[r * count..(r + 1) * count]));
        self.price[..rows].fill(hard);
        let problem = Problem {
            a: &self.a,
            b: &self.b,
            lower: &self.low,
            upper: &self.high,
            c: &self.c[..rows * count],
            d: &self.d[..rows],
            price: &self.price[..rows],
        };
        let _ = self.solver.solve(&problem, &mut self.delta, &mut || false);
        for r in 0..rows {
            let multiplier = self.solver.multipliers()[r];
            met.held_back |= multiplier > 0.0;
            met.hindered |= multiplier > 0.0 && r < pairs;
            met.given_up += usize::from(multiplier >= hard * (1.0 - 1e-9));
        }
        // Each bend by itself keeps to the limit; together they may not. Where nothing comes nearer there is no hurry.
        let evasion_mps = self.settings.evasion_mps;
        let unhurried = (self.settings.withdrawal_mps + URGENCY * threat_mps).min(evasion_mps);
        let most_mps = if met.held_back && rows > 0 { unhurried } else { evasion_mps };
        let fastest = self.farthest(&self.delta) / h;
        if fastest > most_mps {
            self.delta.iter_mut().for_each(|d| *d *= most_mps / fastest);
        }
        let mut energy = 0.0;
        for i in 0..count {
            self.next[i] = self.rest.curvatures()[i] + self.delta[i];
            energy += (0..count).map(|j| self.delta[i] * self.inertia[i * count + j] * self.delta[j]).sum::<f64>();
        }
        // What the task itself asks for is no hurry.
        let pace_mps = if met.held_back { (energy.max(0.0) / self.mass).sqrt() / h } else { 0.0 };
        self.pace_mps += (h * self.settings.approach_1ps / PACE).min(1.0) * (pace_mps - self.pace_mps);
        self.rest.advance(&self.next);
        met
    }

    /// Writes how the body point of a pair moves along `direction` with the curvatures to row `at`; returns how far the last
    /// linearisation still moves it that way (m).
    fn point_row(&mut self, row: &Proximity, direction: &Vector3<f64>, at: usize) -> f64 {
        let count = self.delta.len();
        let c = &mut self.c[at * count..(at + 1) * count];
        c.fill(0.0);
        let mut moved = 0.0;
        let (n, w, i) = (direction, row.point.weights, row.point.element);
        for (side, node) in [i, i + 1].into_iter().enumerate() {
            // The base does not move.
            if node == 0 {
                continue;
            }
            let tangent = rotation_jacobians(&self.rest.arm().pose(&self.rest.state().q, node).1)[0];
            for k in 0..COORDINATES {
                let f = if k < 3 {
                    n[k] * w[2 * side]
                } else {
                    (0..3).map(|x| n[x] * tangent[(x, k - 3)]).sum::<f64>() * w[2 * side + 1]
                };
                let shift = self.rest.coordinate_into(COORDINATES * (node - 1) + k, &mut self.sensitivity);
                moved += f * shift;
                c.iter_mut().zip(&self.sensitivity).for_each(|(c, s)| *c += f * s);
            }
        }
        let (kappa, origin) = (self.rest.curvatures(), self.rest.origin());
        moved + c.iter().zip(kappa.iter().zip(origin)).map(|(c, (k, o))| c * (k - o)).sum::<f64>()
    }

    /// The least that row `at` can be within the step's box.
    fn least(&self, at: usize) -> f64 {
        let count = self.delta.len();
        let c = &self.c[at * count..(at + 1) * count];
        let within = self.low.iter().zip(&self.high);
        self.d[at] + c.iter().zip(within).map(|(c, (l, u))| (c * l).min(c * u)).sum::<f64>()
    }

    /// Box of the change: what every bend by itself may do so that no segment's end exceeds the limits of giving way.
    fn bound_motion(&mut self, h: f64) {
        let s = &self.settings;
        for (i, length) in self.length.iter().enumerate() {
            let moves = self.moves(i).max(0.1 * length * length);
            let (most, change) = (s.evasion_mps * h / moves, s.evasion_mps2 * h * h / moves);
            let before = self.delta[i].clamp(-most, most);
            (self.low[i], self.high[i]) = ((before - change).max(-most), (before + change).min(most));
        }
    }

    /// Speed of the fastest obstacle, or with which one grows (m/s): from what stands still nobody has to hurry away.
    fn threat(&self, h: f64, around: &Surroundings<'_>) -> f64 {
        let grown = |k: usize, now: &Obstacle| self.growth.get(k).map_or(0.0, |before| (now.growth() - before) / h);
        let sets = around.now.as_slice().iter().zip(around.ahead.as_slice()).enumerate();
        sets.map(|(k, (now, ahead))| {
            (ahead.position() - now.position()).norm() / around.span_s
                + grown(k, now).clamp(0.0, GROWTH_MAX_1PS * self.settings.reach_m)
        })
        .fold(0.0, f64::max)
    }

    /// How far a mean curvature moves the segment's end that it moves most (m per 1/m).
    fn moves(&self, curvature: usize) -> f64 {
        let ends = self.ends.chunks_exact(3 * self.delta.len());
        ends.map(|end| (0..3).map(|x| end[x * self.delta.len() + curvature].powi(2)).sum::<f64>().sqrt())
            .fold(0.0, f64::max)
    }

    /// How far a change of the mean curvatures (1/m) moves the segment's end that it moves most (m), by the last
    /// linearisation.
    pub fn farthest(&self, change: &[f64]) -> f64 {
        let count = self.delta.len();
        let along = |row: &[f64]| row.iter().zip(change).map(|(s, d)| s * d).sum::<f64>();
        let ends = self.ends.chunks_exact(3 * count);
        ends.map(|end| end.chunks_exact(count).map(|row| along(row).powi(2)).sum::<f64>().sqrt()).fold(0.0, f64::max)
    }

    /// Adds rows that keep the cables' tensions inside their box; how many rows there are then. A posture beyond it would
    /// only be asked for: at their bounds the cables cannot answer anything else.
    fn tension_rows(&mut self, h: f64, mut rows: usize, met: &mut Met) -> usize {
        let count = self.delta.len();
        for segment in 0..count / 2 {
            let c = &mut self.c[rows * count..(rows + 1) * count];
            let load = self.rest.load_into(segment, self.settings.tension_range_n[segment], c);
            met.load_max = met.load_max.max(load);
            // As a distance: a whole load is as long as the reach.
            let scale = self.settings.reach_m;
            if load > 1.0 - LOAD_NEAR {
                c.iter_mut().for_each(|c| *c *= -scale);
                self.d[rows] = scale * (1.0 - load) * (APPROACH_BOUND * self.settings.approach_1ps * h).min(1.0);
                rows += 1;
            }
        }
        rows
    }

    /// Rows of all pairs within reach; how many.
    fn pair_rows(&mut self, h: f64, around: &Surroundings<'_>, met: &mut Met) -> usize {
        let count = self.delta.len();
        let ReferenceSettings { clearance_m, approach_1ps, withdrawal_mps, reach_m, .. } = self.settings;
        let q = &self.rest.state().q;
        self.rest.arm().frames_into(q, &mut self.positions, &mut self.tangents);
        // A barrier that sees an obstacle when it begins to bind gives way to it smoothly, however fast it is.
        let moved = around.now.as_slice().iter().zip(around.ahead.as_slice());
        let fastest = moved.map(|(now, ahead)| (ahead.position() - now.position()).norm()).fold(0.0, f64::max);
        let reach = (fastest / around.span_s / approach_1ps).clamp(reach_m, FARTHER * reach_m);
        let found = self.body.find(&self.positions, &self.tangents, around.ahead, clearance_m + reach);
        met.distance_min = found.minimum;
        self.rows.clear();
        self.rows.extend_from_slice(&found.rows[..found.rows.len().min(PAIRS_MAX)]);
        let mut kept = 0;
        // An obstacle that was not there before does not grow.
        let known = self.growth.len().min(around.now.len());
        self.growth.truncate(known);
        self.growth.extend(around.now.as_slice()[known..].iter().map(Obstacle::growth));
        for k in 0..self.rows.len() {
            let row = self.rows[k];
            let now = &around.now.as_slice()[row.obstacle];
            // What the obstacle takes of the distance by its own motion (m/s).
            let before = now.distance(&row.position).0 - row.inflation;
            let growing = (now.growth() - self.growth[row.obstacle]).max(0.0) / h;
            let growing = growing.min(GROWTH_MAX_1PS * reach_m);
            let closing = ((before - row.distance) / around.span_s + growing).max(0.0);
            let margin = row.distance - closing * around.beyond_s - clearance_m;
            let ball = ball(&row, around).filter(|b| b.velocity.norm() > DODGE_SLOWEST * withdrawal_mps);
            if kept < PAIRS_MAX
                && let Some(ball) = &ball
                && let Some((direction, speed)) = dodge(&row, ball, &self.positions, clearance_m, approach_1ps)
            {
                self.point_row(&row, &direction, kept);
                self.d[kept] = -h * speed;
                if self.least(kept) < 0.0 {
                    kept += 1;
                }
            }
            if kept == PAIRS_MAX {
                break;
            }
            let moved = self.point_row(&row, &row.normal, kept);
            // One that only grows is no motion to begin softly for.
            let giving_way = 1.0 - (1.0 - GIVING_WAY) * (1.0 - growing / closing.max(f64::MIN_POSITIVE)).max(0.0);
            // The arm's own way towards it, or what it takes by coming nearer: whichever is the more.
            let own = (approach_1ps * margin).max(-withdrawal_mps);
            let theirs = match ball {
                Some(_) => CLOSING * approach_1ps * (margin - REACTION / approach_1ps * closing).max(0.0),
                None => giving_way * approach_1ps * margin.max(0.0),
            } - closing;
            self.d[kept] = moved + h * own.min(theirs);
            // In the step's box the least; in bends of HOPELESS_RAD the most.
            if self.least(kept) > 0.0 {
                continue;
            }
            let c = &self.c[kept * count..(kept + 1) * count];
            let most: f64 = margin + c.iter().zip(&self.length).map(|(c, l)| c.abs() * HOPELESS_RAD / l).sum::<f64>();
            if most < 0.0 {
                self.d[kept] = self.d[kept].max(0.0);
            }
            kept += 1;
        }
        self.growth.clear();
        self.growth.extend(around.now.as_slice().iter().map(Obstacle::growth));
        kept
    }
}

/// A ball that moves.
struct Ball {
    /// Centre (m, base frame).
    center: Vector3<f64>,
    /// Radius (m).
    radius: f64,
    /// Velocity (m/s, base frame).
    velocity: Vector3<f64>,
}

/// The ball of a pair, if its obstacle is one.
fn ball(row: &Proximity, around: &Surroundings<'_>) -> Option<Ball> {
    let (center, radius) = around.ahead.ball(row)?;
    let before = around.now.as_slice()[row.obstacle].position();
    Some(Ball { center, radius, velocity: (center - before) / around.span_s })
}

/// Which way a point of the body leaves the way of a ball that flies at it, and how fast it must (m/s); `None` where it does
/// not fly at it, or has time.
///
/// To run before a ball ends where the arm ends; to step aside costs a fraction of its speed. Of the velocities that meet
/// the ball within [`DODGE`] (the velocity obstacle of Fiorini and Shiller 1998) the nearest edge decides, across the
/// arm: along itself it cannot leave.
fn dodge(
    row: &Proximity,
    ball: &Ball,
    positions: &[Vector3<f64>],
    clearance_m: f64,
    approach_1ps: f64,
) -> Option<(Vector3<f64>, f64)> {
    let Ball { center, radius, velocity } = *ball;
    let in_time_s = DODGE / approach_1ps;
    let wide = radius + row.inflation + clearance_m + DODGE_MARGIN / approach_1ps * velocity.norm();
    // Whether it meets this very point ...
    let away = row.position - center;
    let approach = velocity.dot(&away);
    if approach <= 0.0 || away.norm() <= wide {
        return None;
    }
    let miss = (away - velocity * (approach / velocity.norm_squared())).norm();
    let left_s = (away.norm() - wide) * away.norm() / approach;
    if miss > wide || left_s > in_time_s {
        return None;
    }
    // ... and how it is left across the arm.
    let tangent = (positions[row.point.element + 1] - positions[row.point.element]).normalize();
    let across = |v: Vector3<f64>| v - v.dot(&tangent) * tangent;
    let (away, velocity) = (across(away), across(velocity));
    let distance = away.norm();
    if distance <= wide {
        return None;
    }
    let normal = away / distance;
    let towards = velocity.dot(&normal);
    let lateral = velocity - towards * normal;
    let side = if lateral.norm() > 1e-3 * velocity.norm() { lateral.normalize() } else { tangent.cross(&normal) };
    let sine = wide / distance;
    let cosine = (1.0 - sine * sine).sqrt();
    let speed = towards * sine - velocity.dot(&side) * cosine;
    let share = (2.0 * (in_time_s - left_s) / in_time_s).min(1.0);
    (speed > 0.0).then_some((normal * sine - side * cosine, share * speed))
}

/// Length of the segment of each mean curvature (m).
pub fn segment_lengths(arm: &Arm) -> Vec<f64> {
    (0..arm.segment_count()).flat_map(|segment| [arm.segment_length(segment); 2]).collect()
}
