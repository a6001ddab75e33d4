//! Pairs of body and obstacle as the branches near obstacles need them: positions and distances as affine functions of the
//! tensions, and what may be asked of each.
//!
//! A pair whose required distance no tensions of the arm give (a mounting plane beside the clamped base, an obstacle that is
//! there already) is not asked for it: paying for the impossible would take every tension to its bound. It is asked for
//! at most twice the depth that no tensions avoid, so that what is nearly possible is nearly reached, and for no less than
//! the last tensions give, so that nothing gets deeper. Where the last tensions are within that already the pair only
//! stands still, at a price at which the task may still move it a little; everything else has the price of a hard row.
//! Both depths are those of the arm's whole box, not of a tick's: what takes several ticks is not impossible.

use super::{Inputs, PAIRS_MAX, Planner, Report};
use crate::collision::{Proximity, required_distance};
use crate::math::block_tridiagonal::COORDINATES;
use crate::math::quaternion::rotation_jacobians;
use crate::math::simd::add_four;
use crate::model::State;
use crate::planner::complementarity::exact_price;
use nalgebra::Vector3;
use pulp::{Arch, Simd, WithSimd};

/// A pair whose linearised distance stays above the required one by this for all tensions inside the box is left out (m).
const UNREACHED_M: f64 = 1e-9;

/// Price of a pair that is only to get no deeper, over that of a hard row: with it a metre of that pair is to the task what
/// a metre of the arm's most mobile point is, and no hard row is ever sold for it.
const STILL_SHARE: f64 = 1e-6;

/// What is known of the pairs within reach of an iterate; per row of `rows` where nothing else is said.
#[derive(Debug, Clone)]
pub(super) struct PairBuffers {
    pub(super) rows: Vec<Proximity>,
    pub(super) required: Vec<f64>,
    pub(super) length: Vec<f64>,
    pub(super) origin: Vec<f64>,
    pub(super) slope: Vec<f64>,
    pub(super) c: Vec<f64>,
    pub(super) d: Vec<f64>,
    /// Price per metre of each row's violation, half.
    pub(super) price: Vec<f64>,
    /// Whether there were more than there is room for.
    pub(super) overflow: bool,
    /// Price of a hard row.
    pub(super) hard: f64,
    /// Multipliers that the last solution lets expect.
    pub(super) multiplier: Vec<f64>,
}

impl PairBuffers {
    /// Room for [`PAIRS_MAX`] pairs and `cables` tensions. Allocates.
    pub(super) fn new(cables: usize) -> Self {
        Self {
            rows: Vec::with_capacity(PAIRS_MAX),
            required: Vec::with_capacity(PAIRS_MAX),
            length: Vec::with_capacity(PAIRS_MAX),
            origin: vec![0.0; 3 * PAIRS_MAX],
            slope: vec![0.0; 3 * PAIRS_MAX * cables],
            c: vec![0.0; PAIRS_MAX * cables],
            d: vec![0.0; PAIRS_MAX],
            price: vec![0.0; PAIRS_MAX],
            overflow: false,
            hard: 0.0,
            multiplier: vec![0.0; PAIRS_MAX],
        }
    }

    /// Where the tensions `u` take the body point of pair `r`, on the affine map.
    pub(super) fn position(&self, r: usize, u: &[f64]) -> Vector3<f64> {
        let nc = u.len();
        Vector3::from_fn(|c, _| {
            let slope = &self.slope[(3 * r + c) * nc..(3 * r + c + 1) * nc];
            self.origin[3 * r + c] + slope.iter().zip(u).map(|(s, u)| s * u).sum::<f64>()
        })
    }
}

impl Planner {
    /// Positions of the pairs' body points and their distances as affine functions of the tensions; drops the pairs
    /// that no tensions inside the box can bring below their required distance, and those that no tensions move. The
    /// report receives how many no tensions of the arm bring to it, and whether less was asked of some for that.
    pub(super) fn linearize_pairs(&mut self, next: &State, inputs: &Inputs<'_>, report: &mut Report) {
        let nc = self.u.len();
        let moved = (0..self.arm.node_count()).flat_map(|node| (0..3).map(move |c| COORDINATES * node + c));
        self.pairs.hard = exact_price(&self.quadratic.a, &self.quadratic.b, moved.map(|row| self.map.row(row)));
        (report.hopeless, report.relaxed, report.truncated) = (0, false, self.pairs.overflow);
        self.tangent_known.fill(false);
        self.pairs.required.clear();
        self.pairs.length.clear();
        let mut kept = 0;
        for k in 0..self.pairs.rows.len() {
            let row = self.pairs.rows[k];
            let now = row.point.combine(&self.frames_now.r, &self.frames_now.t);
            // A leader has given way for what the obstacle takes by its own motion; what is left is the arm's own.
            let seen = if inputs.led_to.is_some() { inputs.ahead } else { inputs.now };
            let d_now = seen.as_slice()[row.obstacle].distance(&now).0 - row.inflation;
            let mut required = required_distance(d_now, self.config.clearance_m, self.config.barrier.as_ref());
            if inputs.led_to.is_some() {
                let led = row.point.combine(&self.frames_led.r, &self.frames_led.t);
                required = required.min(inputs.ahead.as_slice()[row.obstacle].distance(&led).0 - row.inflation);
            }
            let i = row.point.element;
            for node in [i, i + 1] {
                self.tangent_slope(next, node);
            }
            let slope = &mut self.pairs.slope[3 * kept * nc..3 * (kept + 1) * nc];
            slope.fill(0.0);
            let mut origin = row.position;
            let w = row.point.weights;
            // The base does not move.
            let first = usize::from(i == 0) * 2;
            for c in 0..3 {
                let position = |node: usize| COORDINATES * (node.max(1) - 1) + c;
                let tangent = |node: usize| (3 * node + c) * nc..(3 * node + c + 1) * nc;
                let rows: [&[f64]; 4] = [
                    self.map.row(position(i)),
                    &self.tangent[tangent(i)],
                    self.map.row(position(i + 1)),
                    &self.tangent[tangent(i + 1)],
                ];
                let constants = [
                    self.map.x0[position(i)],
                    self.tangent_origin[i][c],
                    self.map.x0[position(i + 1)],
                    self.tangent_origin[i + 1][c],
                ];
                let mut f = w;
                f[..first].fill(0.0);
                origin[c] += f.iter().zip(constants).map(|(f, x)| f * x).sum::<f64>();
                let slope = &mut slope[c * nc..(c + 1) * nc];
                combine_four(f, rows, slope);
                // The swarm and the rows see the commanded tensions; what acts beside them moves the origin.
                origin[c] += slope.iter().zip(inputs.disturbance).map(|(s, w)| s * w).sum::<f64>();
            }
            let n = row.normal;
            let d = row.distance + n.dot(&(origin - row.position)) - required;
            let c = &mut self.pairs.c[kept * nc..(kept + 1) * nc];
            // In the tick's box the least, in the arm's the most; at the last tensions; all that the arm's box moves it.
            let (mut least, mut most, mut last, mut range) = (d, d, d, 0.0);
            for (j, c) in c.iter_mut().enumerate() {
                *c = n[0] * slope[j] + n[1] * slope[nc + j] + n[2] * slope[2 * nc + j];
                least += (*c * self.low[j]).min(*c * self.high[j]);
                most += (*c * self.box_low[j]).max(*c * self.box_high[j]);
                last += *c * self.previous[j];
                range += c.abs() * (self.box_high[j] - self.box_low[j]);
            }
            // The distance to a convex obstacle is nowhere below its linearisation: this pair cannot matter.
            if least > UNREACHED_M {
                continue;
            }
            report.hopeless += usize::from(most < 0.0);
            if range < UNREACHED_M {
                continue;
            }
            let allowed = if most < 0.0 { last.max(2.0 * most) } else { 0.0 };
            let stands = most < 0.0 && last >= 2.0 * most;
            report.relaxed |= most < 0.0;
            self.pairs.origin[3 * kept..3 * kept + 3].copy_from_slice(origin.as_slice());
            self.pairs.d[kept] = d - allowed;
            self.pairs.price[kept] = if stands { STILL_SHARE } else { 1.0 } * self.pairs.hard;
            self.pairs.required.push(required + allowed);
            self.pairs.length.push(inputs.ahead.as_slice()[row.obstacle].penalty_length());
            self.pairs.rows[kept] = row;
            kept += 1;
        }
        self.pairs.rows.truncate(kept);
    }

    /// A node's tangent as an affine function of the tensions, made once per node and iteration.
    fn tangent_slope(&mut self, next: &State, node: usize) {
        let nc = self.u.len();
        if std::mem::replace(&mut self.tangent_known[node], true) || node == 0 {
            return;
        }
        let jacobian = rotation_jacobians(&self.arm.pose(&next.q, node).1)[0];
        let at = COORDINATES * (node - 1) + 3;
        for c in 0..3 {
            let f: [f64; 4] = std::array::from_fn(|p| jacobian[(c, p)]);
            self.tangent_origin[node][c] = (0..4).map(|p| f[p] * self.map.x0[at + p]).sum();
            let out = &mut self.tangent[(3 * node + c) * nc..(3 * node + c + 1) * nc];
            out.fill(0.0);
            combine_four(f, std::array::from_fn(|p| self.map.row(at + p)), out);
        }
    }
}

/// `y += sum f_k x_k`.
fn combine_four(f: [f64; 4], x: [&[f64]; 4], y: &mut [f64]) {
    struct Four<'a>([f64; 4], [&'a [f64]; 4], &'a mut [f64]);
    impl WithSimd for Four<'_> {
        type Output = ();
        #[inline(always)]
        fn with_simd<S: Simd>(self, simd: S) {
            add_four(simd, self.0, self.1, self.2);
        }
    }
    Arch::new().dispatch(Four(f, x, y));
}
