//! The total tangent S of (14) with `f` of (7), in block-tridiagonal form, and what the input matrix is made of.
//!
//! Enters: motion and tensions. Leaves: [`Linearization`]. Elements are linearised side by side, as many as the processor's
//! vectors have numbers, from tip to base; then their entries are put where they belong.
//! Must never: allocate after [`Linearization::new`].

use super::arm::{Arm, Element};
use super::cables::{Span, Stiffness};
use super::chord::Chord;
use super::elastic::Bending;
use super::inertia;
use super::legs::{LegGroup, Passages};
use super::terms::{Motion, ends};
use crate::config::StrainRule;
use crate::math::block_tridiagonal::{BLOCK, BlockTridiagonal, COORDINATES};
use crate::math::simd::{Columns, Lanes, Scalars, inner};
use pulp::{Arch, Simd, WithSimd};

/// How rates and accelerations follow the coordinates in one step: `dq'/dq = cg`, `dq''/dq = cb`.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Rates {
    /// 1/s.
    pub cg: f64,
    /// 1/s^2.
    pub cb: f64,
}

impl Rates {
    /// Statics: coordinates alone.
    pub const STATIC: Self = Self { cg: 0.0, cb: 0.0 };
}

/// `S`, `f`, `B u` and `B` at one iterate, multipliers scaled (see NOTATION).
#[derive(Debug, Clone)]
pub struct Linearization {
    /// Total tangent (14), with `-d(G u)/dq`.
    pub tangent: BlockTridiagonal,
    /// `f` of (7), 11N: without the cables' forces.
    pub f: Vec<f64>,
    /// `B u` at the tensions that it was made at, 11N; rows of the multipliers are zero.
    pub pull: Vec<f64>,
    /// Scaling of the multipliers: `lambda = scale * (their unknown)`.
    pub scale: f64,
    /// What `B` is made of: legs of each element's cables, and whether its end's quaternion was flipped.
    pub(super) legs: Vec<LegGroup>,
    pub(super) sign: Vec<f64>,
    nodes: Nodes,
    passages: Passages,
    entries: Entries,
}

impl Linearization {
    /// Room for an arm. Allocates.
    pub fn new(arm: &Arm) -> Self {
        let n = arm.node_count();
        Self {
            tangent: BlockTridiagonal::zeros(n),
            f: vec![0.0; BLOCK * n],
            pull: vec![0.0; BLOCK * n],
            scale: 1.0,
            legs: vec![LegGroup::ZERO; arm.elements.last().map_or(0, |e| e.groups.end)],
            sign: vec![1.0; n],
            nodes: Nodes::new(n),
            passages: Passages::new(arm),
            entries: Entries::ZERO,
        }
    }
}

impl Arm {
    /// `S` at (x, u), `f` at x, `B u` and `B` at q, scaled by `out.scale`. Does not allocate.
    ///
    /// The tangent holds `-d(G u)/dq`, so `S dx = -(f - B u)` is the exact Newton step at the tensions `u`, and
    /// `dx(u') = S^-1 (-f + B u')` is (11) for any other.
    pub fn linearize(&self, m: &Motion<'_>, u: &[f64], rates: Rates, out: &mut Linearization) {
        out.nodes.gather(self, m, &mut out.sign);
        out.passages.gather(self, u);
        Arch::new().dispatch(Linearizing { arm: self, motion: m, rates, out });
    }
}

/// Most elements side by side.
pub(super) const WIDEST: usize = 4;

/// What nodes and elements bring along, number for number in rows: a row has a node after the other, the base first, and an
/// element's numbers stand with the node at its end. Rows end with what fills the last vector: elements of 1 m, massless and
/// without cables.
#[derive(Debug, Clone)]
struct Nodes {
    /// Length of a row.
    length: usize,
    rows: Vec<f64>,
}

// The rows: coordinates, rates, accelerations, multipliers, the flip's sign; constants.
const POSITION: usize = 0;
const QUATERNION: usize = 3;
const RATE: usize = 7;
const ACCELERATION: usize = 14;
const MULTIPLIER: usize = 21;
const SIGN: usize = 25;
/// Length, connector, damping, mass; then stiffnesses and inertias.
const ELEMENT: usize = 26;
const STIFFNESS: usize = 30;
const INERTIA: usize = 33;
const NODE_ROWS: usize = 36;

impl Nodes {
    fn new(n: usize) -> Self {
        let length = 1 + n.next_multiple_of(WIDEST);
        let mut rows = vec![0.0; NODE_ROWS * length];
        for (k, row) in rows.chunks_exact_mut(length).enumerate() {
            for (node, x) in row.iter_mut().enumerate().skip(n + 1) {
                *x = match k {
                    POSITION => (node - n) as f64,
                    QUATERNION | SIGN | ELEMENT => 1.0,
                    _ => 0.0,
                };
            }
        }
        Self { length, rows }
    }

    fn gather(&mut self, arm: &Arm, m: &Motion<'_>, signs: &mut [f64]) {
        for i in 0..arm.node_count() {
            signs[i] = ends(arm, m.q, m.qd, i).1;
        }
        self.take(POSITION, 7, m.q);
        self.take(RATE, 7, m.qd);
        self.take(ACCELERATION, 7, m.qdd);
        self.take(MULTIPLIER, 4, m.lambda);
        self.take(SIGN, 1, signs);
        for (c, base) in arm.base_position.iter().chain(&arm.base_quaternion).enumerate() {
            self.rows[(POSITION + c) * self.length] = *base;
        }
        for (i, (e, node)) in arm.elements.iter().zip(&arm.nodes).enumerate() {
            let ([kx, ky, kz], [jx, jy, jz]) = (e.stiffness.into(), node.inertia.into());
            let constants = [e.length, e.connector, e.damping, node.mass, kx, ky, kz, jx, jy, jz];
            for (row, x) in self.rows[ELEMENT * self.length..].chunks_exact_mut(self.length).zip(constants) {
                row[i + 1] = x;
            }
        }
    }

    /// Fills rows from numbers that stand node by node.
    fn take(&mut self, first: usize, count: usize, from: &[f64]) {
        for (c, row) in self.rows[first * self.length..].chunks_exact_mut(self.length).take(count).enumerate() {
            for (x, from) in row[1..].iter_mut().zip(from.chunks_exact(count)) {
                *x = from[c];
            }
        }
    }

    /// Of the nodes from `node` on, the rows from `first` on.
    #[inline(always)]
    fn load<W: Columns, const N: usize>(&self, w: W, first: usize, node: usize) -> [W::Value; N] {
        let mut values = [w.splat(0.0); N];
        for k in 0..N {
            values[k] = w.load(&self.rows[(first + k) * self.length + node..]);
        }
        values
    }
}

/// Numbers of elements side by side, and behind them that of the element behind.
type Row = [f64; 2 * WIDEST];

/// Entries of the tangent and of the left side from elements side by side, with the signs of the nodes' quaternions.
#[derive(Debug, Clone)]
#[repr(align(64))]
struct Entries {
    /// What an element adds at the node before it. A node gets that of the element behind it.
    rr: [[Row; 3]; 3],
    r_before: [[Row; 4]; 3],
    before_before: [[Row; 4]; 4],
    f_before: [Row; COORDINATES],
    pull_before: [Row; COORDINATES],
    /// What it adds at its end, and between the two.
    r_end: [[Row; 4]; 3],
    end_end: [[Row; 4]; 4],
    before_end: [[Row; 4]; 4],
    end_before: [[Row; 4]; 4],
    f_end: [Row; BLOCK],
    pull_end: [Row; COORDINATES],
    /// Derivatives of its constraints, the chord and the norm at its end.
    chord_before: [[Row; 4]; 3],
    chord_end: [[Row; 4]; 3],
    norm: [Row; 4],
}

impl Entries {
    const ZERO: Self = Self {
        rr: [[[0.0; 2 * WIDEST]; 3]; 3],
        r_before: [[[0.0; 2 * WIDEST]; 4]; 3],
        before_before: [[[0.0; 2 * WIDEST]; 4]; 4],
        f_before: [[0.0; 2 * WIDEST]; COORDINATES],
        pull_before: [[0.0; 2 * WIDEST]; COORDINATES],
        r_end: [[[0.0; 2 * WIDEST]; 4]; 3],
        end_end: [[[0.0; 2 * WIDEST]; 4]; 4],
        before_end: [[[0.0; 2 * WIDEST]; 4]; 4],
        end_before: [[[0.0; 2 * WIDEST]; 4]; 4],
        f_end: [[0.0; 2 * WIDEST]; BLOCK],
        pull_end: [[0.0; 2 * WIDEST]; COORDINATES],
        chord_before: [[[0.0; 2 * WIDEST]; 4]; 3],
        chord_end: [[[0.0; 2 * WIDEST]; 4]; 3],
        norm: [[0.0; 2 * WIDEST]; 4],
    };

    /// Does to every row of what the node before an element gets.
    #[inline(always)]
    fn each_before(&mut self, mut change: impl FnMut(&mut Row)) {
        self.rr.as_flattened_mut().iter_mut().for_each(&mut change);
        self.r_before.as_flattened_mut().iter_mut().for_each(&mut change);
        self.before_before.as_flattened_mut().iter_mut().for_each(&mut change);
        self.f_before.iter_mut().for_each(&mut change);
        self.pull_before.iter_mut().for_each(&mut change);
    }
}

#[inline(always)]
fn store<W: Columns, const R: usize, const C: usize>(w: W, m: &[[W::Value; C]; R], rows: &mut [[Row; C]; R]) {
    for r in 0..R {
        for c in 0..C {
            w.store(m[r][c], &mut rows[r][c]);
        }
    }
}

/// Stores `factor` times a matrix.
#[inline(always)]
fn store_times<W: Columns, const R: usize, const C: usize>(
    w: W,
    factor: W::Value,
    m: &[[W::Value; C]; R],
    rows: &mut [[Row; C]; R],
) {
    for r in 0..R {
        for c in 0..C {
            w.store(factor * m[r][c], &mut rows[r][c]);
        }
    }
}

/// [`Arm::linearize`] with the processor's vectors: everything below it is inlined, so the compiler may use them.
struct Linearizing<'a> {
    arm: &'a Arm,
    motion: &'a Motion<'a>,
    rates: Rates,
    out: &'a mut Linearization,
}

impl WithSimd for Linearizing<'_> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(self, simd: S) {
        if WIDEST.is_multiple_of(S::F64_LANES) { self.run(Lanes(simd)) } else { self.run(Scalars) }
    }
}

impl Linearizing<'_> {
    #[inline(always)]
    fn run<W: Columns>(mut self, w: W) {
        let n = self.arm.node_count();
        self.out.entries.each_before(|row| *row = [0.0; 2 * WIDEST]);
        let mut first = n.next_multiple_of(W::WIDTH);
        while first > 0 {
            first -= W::WIDTH;
            // What the element behind the last of these adds is that of the first of the ones before.
            self.out.entries.each_before(|row| row[W::WIDTH] = row[0]);
            self.evaluate(w, first);
            let last = n.min(first + W::WIDTH);
            if last < first + W::WIDTH {
                self.out.entries.each_before(|row| row[last - first..].fill(0.0));
            }
            for i in first..last {
                self.place(i, i - first);
            }
            self.out.passages.keep(self.arm, first..last, &mut self.out.legs);
        }
    }

    /// Entries of the elements from `i` on.
    #[inline(always)]
    fn evaluate<W: Columns>(&mut self, w: W, i: usize) {
        let Self { arm, motion, rates, out } = self;
        let Linearization { nodes, passages, entries, scale, .. } = &mut **out;
        let [sign, length, connector, damping, mass] = nodes.load(w, SIGN, i + 1);
        let (stiffness, inertia) = (nodes.load(w, STIFFNESS, i + 1), nodes.load(w, INERTIA, i + 1));
        let (p_before, pd_before) = (nodes.load(w, QUATERNION, i), nodes.load(w, RATE + 3, i));
        let mut p: [W::Value; 4] = nodes.load(w, QUATERNION, i + 1);
        let mut pd: [W::Value; 4] = nodes.load(w, RATE + 3, i + 1);
        let mut pdd: [W::Value; 4] = nodes.load(w, ACCELERATION + 3, i + 1);
        for c in 0..4 {
            (p[c], pd[c], pdd[c]) = (sign * p[c], sign * pd[c], sign * pdd[c]);
        }
        let r: [[W::Value; 3]; 2] = [nodes.load(w, POSITION, i), nodes.load(w, POSITION, i + 1)];
        let [x, y, z, of_norm] = nodes.load(w, MULTIPLIER, i + 1);
        let mu = [x, y, z];
        let (one, s) = (w.splat(1.0), w.splat(*scale));

        let chord = Chord::new(w, arm.chord, [p_before, p], length, connector, mu);
        let [chord_before, chord_end] = &chord.jacobian;
        store_times(w, s, chord_before, &mut entries.chord_before);
        store_times(w, s * sign, chord_end, &mut entries.chord_end);

        let span = Span::new(connector, r, [p_before, p]);
        let sums = passages.sums(w, arm, i, &span);
        let k = Stiffness::new(w, &span, &sums);
        store(w, &k.rr, &mut entries.rr);
        store(w, &k.rp[0], &mut entries.r_before);
        store_times(w, sign, &k.rp[1], &mut entries.r_end);
        for c in 0..3 {
            w.store(k.pull[c], &mut entries.pull_before[c]);
            w.store(-k.pull[c], &mut entries.pull_end[c]);
        }
        for c in 0..4 {
            w.store(k.turn[0][c], &mut entries.pull_before[3 + c]);
            w.store(-(sign * k.turn[1][c]), &mut entries.pull_end[3 + c]);
        }

        let bending = match arm.strain {
            StrainRule::VectorPart => {
                Bending::by_vector_part(w, [p_before, p], [pd_before, pd], stiffness, damping, length, rates.cg)
            }
            StrainRule::Logarithm => by_logarithm(w, arm, motion, rates.cg, i),
        };
        let [mut before_before, mut before_end, mut end_before, mut end_end] = bending.tangent;
        for r in 0..4 {
            for c in 0..4 {
                let (middle, across) = (chord.hessian[1][r][c], k.pp[1][r][c]);
                before_before[r][c] = before_before[r][c] + chord.hessian[0][r][c] + k.pp[0][r][c];
                before_end[r][c] = before_end[r][c] + middle + across;
                end_before[r][c] = end_before[r][c] + middle + k.pp[1][c][r];
                end_end[r][c] = end_end[r][c] + chord.hessian[2][r][c] + k.pp[2][r][c];
            }
        }
        store(w, &before_before, &mut entries.before_before);
        store_times(w, sign, &before_end, &mut entries.before_end);
        store_times(w, sign, &end_before, &mut entries.end_before);

        // The node at the end: inertia, damping by mass, norm.
        let alpha = arm.damping_mass;
        let mut x = pdd;
        for c in 0..4 {
            x[c] = pdd[c] + pd[c] * alpha;
            end_end[c][c] = end_end[c][c] + of_norm * 2.0;
        }
        inertia::add_tangent(inertia, p, pd, x, rates.cb + alpha * rates.cg, rates.cg, &mut end_end);
        store(w, &end_end, &mut entries.end_end);
        let (turning, gyroscopic) = (inertia::mass_times(inertia, p, x), inertia::gyroscopic(inertia, p, pd));
        let rates: [W::Value; 3] = nodes.load(w, RATE, i + 1);
        let accelerations: [W::Value; 3] = nodes.load(w, ACCELERATION, i + 1);
        for c in 0..3 {
            let force = mass * (accelerations[c] + rates[c] * alpha - w.splat(arm.gravity[c]));
            w.store(mu[c] + force, &mut entries.f_end[c]);
            w.store(-mu[c], &mut entries.f_before[c]);
            w.store(s * (r[1][c] - r[0][c] - chord.vector[c]), &mut entries.f_end[COORDINATES + c]);
        }
        for c in 0..4 {
            let held = [
                inner(&[chord_before[0][c], chord_before[1][c], chord_before[2][c]], &mu),
                inner(&[chord_end[0][c], chord_end[1][c], chord_end[2][c]], &mu),
            ];
            w.store(bending.force[0][c] + held[0], &mut entries.f_before[3 + c]);
            let end = bending.force[1][c] + held[1] + turning[c] + gyroscopic[c] + of_norm * p[c] * 2.0;
            w.store(sign * end, &mut entries.f_end[3 + c]);
            w.store(s * sign * p[c] * 2.0, &mut entries.norm[c]);
        }
        w.store(s * (inner(&p, &p) - one), &mut entries.f_end[BLOCK - 1]);
    }

    /// Puts the entries of element `i`, the `l`-th of those side by side, where they belong.
    #[inline(always)]
    fn place(&mut self, i: usize, l: usize) {
        let Self { arm, rates, out, .. } = self;
        let Linearization { tangent, f, pull, entries: e, scale, .. } = &mut **out;
        let mass = arm.nodes[i].mass * (rates.cb + arm.damping_mass * rates.cg);
        assert!(l < WIDEST);
        let behind = l + 1;
        let d = &mut tangent.diagonal[i];
        for r in 0..3 {
            for c in 0..3 {
                d[(r, c)] = e.rr[r][c][l] + e.rr[r][c][behind];
            }
            d[(r, r)] += mass;
            for c in 0..4 {
                let entry = e.r_end[r][c][l] + e.r_before[r][c][behind];
                (d[(r, 3 + c)], d[(3 + c, r)]) = (entry, entry);
                let chord = e.chord_end[r][c][l];
                (d[(COORDINATES + r, 3 + c)], d[(3 + c, COORDINATES + r)]) = (chord, chord);
            }
            (d[(COORDINATES + r, r)], d[(r, COORDINATES + r)]) = (*scale, *scale);
        }
        for r in 0..4 {
            for c in 0..4 {
                d[(3 + r, 3 + c)] = e.end_end[r][c][l] + e.before_before[r][c][behind];
            }
            (d[(3 + r, BLOCK - 1)], d[(BLOCK - 1, 3 + r)]) = (e.norm[r][l], e.norm[r][l]);
        }
        let row = BLOCK * i;
        for c in 0..COORDINATES {
            f[row + c] = e.f_end[c][l] + e.f_before[c][behind];
            pull[row + c] = e.pull_end[c][l] + e.pull_before[c][behind];
        }
        for c in COORDINATES..BLOCK {
            f[row + c] = e.f_end[c][l];
        }
        if i == 0 {
            return;
        }
        let (lower, upper) = (&mut tangent.lower[i], &mut tangent.upper[i - 1]);
        for r in 0..3 {
            for c in 0..3 {
                (lower[(r, c)], upper[(r, c)]) = (-e.rr[r][c][l], -e.rr[r][c][l]);
            }
            for c in 0..4 {
                let (before, end, chord) = (e.r_before[r][c][l], e.r_end[r][c][l], e.chord_before[r][c][l]);
                (lower[(r, 3 + c)], upper[(3 + c, r)]) = (-before, -before);
                (lower[(3 + c, r)], upper[(r, 3 + c)]) = (-end, -end);
                (lower[(COORDINATES + r, 3 + c)], upper[(3 + c, COORDINATES + r)]) = (chord, chord);
            }
            (lower[(COORDINATES + r, r)], upper[(r, COORDINATES + r)]) = (-*scale, -*scale);
        }
        for r in 0..4 {
            for c in 0..4 {
                lower[(3 + r, 3 + c)] = e.end_before[r][c][l];
                upper[(3 + r, 3 + c)] = e.before_end[r][c][l];
            }
        }
    }
}

/// Bending by the logarithm, which has branches: one element after the other.
#[inline(always)]
fn by_logarithm<W: Columns>(w: W, arm: &Arm, m: &Motion<'_>, cg: f64, i: usize) -> Bending<W::Value> {
    let (mut force, mut tangent) = ([[[0.0; WIDEST]; 4]; 2], [[[[0.0; WIDEST]; 4]; 4]; 4]);
    for l in 0..W::WIDTH.min(arm.node_count() - i) {
        let e: &Element = &arm.elements[i + l];
        let one = Bending::of(arm.strain, e, &ends(arm, m.q, m.qd, i + l).0, cg);
        for (to, from) in force.as_flattened_mut().iter_mut().zip(one.force.as_flattened()) {
            to[l] = *from;
        }
        let to = tangent.as_flattened_mut().as_flattened_mut();
        for (to, from) in to.iter_mut().zip(one.tangent.as_flattened().as_flattened()) {
            to[l] = *from;
        }
    }
    let zero = w.splat(0.0);
    let mut bending = Bending { force: [[zero; 4]; 2], tangent: [[[zero; 4]; 4]; 4] };
    for r in 0..4 {
        for end in 0..2 {
            bending.force[end][r] = w.load(&force[end][r]);
        }
        for block in 0..4 {
            for c in 0..4 {
                bending.tangent[block][r][c] = w.load(&tangent[block][r][c]);
            }
        }
    }
    bending
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::config::{ArmConfig, ChordRule, Routing};
    use crate::model::State;
    use rand::{RngExt, SeedableRng};
    use rand_xoshiro::Xoshiro256PlusPlus;

    /// What the processor of the test has, and single numbers, which an old one has: the same equations, whatever is left
    /// over in the last vector.
    #[test]
    fn elements_side_by_side_have_the_equations_of_one_after_the_other() {
        let mut rng = Xoshiro256PlusPlus::seed_from_u64(5);
        for (chord, strain, routing) in [
            (ChordRule::Simpson, StrainRule::VectorPart, Routing::Local),
            (ChordRule::Trapezoid, StrainRule::VectorPart, Routing::Through),
            (ChordRule::Simpson, StrainRule::Logarithm, Routing::Through),
        ] {
            for elements in 1..=5 {
                let mut config = ArmConfig { chord, strain, routing, damping_mass_1ps: 0.3, ..ArmConfig::paper() };
                config.segments.truncate(3);
                config.segments.iter_mut().for_each(|s| s.elements = elements);
                let arm = Arm::new(&config);
                let mut state = State::at_rest(arm.bent(&[0.8, -0.5, 0.2, 1.1, -0.7, 0.4]));
                for i in 0..arm.node_count() {
                    let flip = if rng.random_bool(0.5) { -1.0 } else { 1.0 };
                    state.q[7 * i + 3..7 * i + 7].iter_mut().for_each(|p| *p *= flip);
                }
                for x in [&mut state.q, &mut state.qd, &mut state.qdd, &mut state.lambda] {
                    x.iter_mut().for_each(|x| *x += rng.random_range(-0.02..0.02));
                }
                let u: Vec<f64> = (0..arm.cable_count()).map(|_| rng.random_range(0.0..200.0)).collect();
                let (motion, rates) = (Motion::from(&state), Rates { cg: 20.0, cb: 400.0 });
                let [mut one, mut other] = [Linearization::new(&arm), Linearization::new(&arm)];
                (one.scale, other.scale) = (50.0, 50.0);
                arm.linearize(&motion, &u, rates, &mut one);
                other.nodes.gather(&arm, &motion, &mut other.sign);
                other.passages.gather(&arm, &u);
                Arch::Scalar.dispatch(Linearizing { arm: &arm, motion: &motion, rates, out: &mut other });
                let x: Vec<f64> = (0..BLOCK * arm.node_count()).map(|_| rng.random_range(-1.0..1.0)).collect();
                let products = [&one, &other].map(|l| {
                    let mut y = vec![0.0; x.len()];
                    l.tangent.multiply_into(&x, &mut y);
                    let mut b = vec![0.0; COORDINATES * arm.node_count() * arm.cable_count()];
                    l.input_into(&arm, &mut b);
                    [y, l.f.clone(), l.pull.clone(), b]
                });
                for (a, b) in products[0].iter().zip(&products[1]) {
                    let size = a.iter().fold(1.0f64, |s, a| s.max(a.abs()));
                    assert!(a.iter().zip(b).all(|(a, b)| (a - b).abs() < 1e-13 * size), "{elements} elements");
                }
            }
        }
    }
}
