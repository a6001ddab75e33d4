//! The total tangent S of (14) with `f` of (7), in block-tridiagonal form, and what the input matrix is made of.
//!
//! Enters: motion and tensions. Leaves: [`Linearization`]. Elements are linearised side by side, as many as the processor's
//! vectors have numbers, from tip to base; then their entries are put where they belong.
//! Must never: allocate after [`Linearization::new`].

use super::arm::{Arm, Element};
use super::assembly::{Motion, ends};
use super::cables::{Span, Stiffness};
use super::chord::Chord;
use super::elastic::Bending;
use super::inertia;
use super::legs::{LegGroup, Passages};
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

/// Elements side by side at most.
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

// The rows, by what they begin with.
const POSITION: usize = 0;
const QUATERNION: usize = 3;
const RATE: usize = 7;
const ACCELERATION: usize = 14;
const MULTIPLIER: usize = 21;
/// Sign of the flip, and behind it length and connector.
const SIGN: usize = 25;
const STIFFNESS: usize = 28;
/// Damping, and behind it mass.
const DAMPING: usize = 31;
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
                    k if k == QUATERNION || k == SIGN || k == SIGN + 1 => 1.0,
                    _ => 0.0,
                };
            }
        }
        Self { length, rows }
    }

    fn set(&mut self, first: usize, node: usize, values: &[f64]) {
        for (k, value) in values.iter().enumerate() {
            self.rows[(first + k) * self.length + node] = *value;
        }
    }

    fn gather(&mut self, arm: &Arm, m: &Motion<'_>, signs: &mut [f64]) {
        self.set(POSITION, 0, arm.base_position.as_slice());
        self.set(QUATERNION, 0, arm.base_quaternion.as_slice());
        for (i, (e, node)) in arm.elements.iter().zip(&arm.nodes).enumerate() {
            let coordinates = COORDINATES * i..COORDINATES * (i + 1);
            signs[i] = ends(arm, m.q, m.qd, i).1;
            self.set(POSITION, i + 1, &m.q[coordinates.clone()]);
            self.set(RATE, i + 1, &m.qd[coordinates.clone()]);
            self.set(ACCELERATION, i + 1, &m.qdd[coordinates]);
            self.set(MULTIPLIER, i + 1, &m.lambda[4 * i..4 * (i + 1)]);
            self.set(SIGN, i + 1, &[signs[i], e.length, e.connector]);
            self.set(STIFFNESS, i + 1, e.stiffness.as_slice());
            self.set(DAMPING, i + 1, &[e.damping, node.mass]);
            self.set(INERTIA, i + 1, node.inertia.as_slice());
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

/// Entries of the tangent and of the left side from elements side by side. Quaternions of an element's end are flipped as
/// their node has them.
#[derive(Debug, Clone)]
#[repr(align(64))]
struct Entries {
    /// What an element adds at the node before it, and what its end sees of that: for the node before, that of the element
    /// behind it counts.
    rr: [[Row; 3]; 3],
    r_before: [[Row; 4]; 3],
    before_before: [[Row; 4]; 4],
    f_before: [Row; COORDINATES],
    pull_before: [Row; COORDINATES],
    /// At its end.
    r_end: [[Row; 4]; 3],
    end_end: [[Row; 4]; 4],
    before_end: [[Row; 4]; 4],
    end_before: [[Row; 4]; 4],
    f_end: [Row; BLOCK],
    pull_end: [Row; COORDINATES],
    /// Constraints: the chord's derivatives, half of the norm's.
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

/// Stores `factor` times a matrix.
#[inline(always)]
fn store<W: Columns, const R: usize, const C: usize>(
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
            self.elements(w, first);
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
    fn elements<W: Columns>(&mut self, w: W, i: usize) {
        let Self { arm, motion, rates, out } = self;
        let Linearization { nodes, passages, entries, scale, .. } = &mut **out;
        let [sign, length, connector] = nodes.load(w, SIGN, i + 1);
        let [damping, mass] = nodes.load(w, DAMPING, i + 1);
        let (stiffness, inertia) = (nodes.load(w, STIFFNESS, i + 1), nodes.load(w, INERTIA, i + 1));
        let (p_before, pd_before): ([W::Value; 4], [W::Value; 4]) =
            (nodes.load(w, QUATERNION, i), nodes.load(w, RATE + 3, i));
        let (mut p, mut pd, mut pdd): ([W::Value; 4], [W::Value; 4], [W::Value; 4]) =
            (nodes.load(w, QUATERNION, i + 1), nodes.load(w, RATE + 3, i + 1), nodes.load(w, ACCELERATION + 3, i + 1));
        for c in 0..4 {
            (p[c], pd[c], pdd[c]) = (sign * p[c], sign * pd[c], sign * pdd[c]);
        }
        let r: [[W::Value; 3]; 2] = [nodes.load(w, POSITION, i), nodes.load(w, POSITION, i + 1)];
        let [x, y, z, of_norm] = nodes.load(w, MULTIPLIER, i + 1);
        let mu = [x, y, z];
        let (one, s) = (w.splat(1.0), w.splat(*scale));

        let chord = Chord::new(w, arm.chord, [p_before, p], length, connector, mu);
        let [chord_before, chord_end] = &chord.jacobian;
        store(w, s, chord_before, &mut entries.chord_before);
        store(w, s * sign, chord_end, &mut entries.chord_end);

        let span = Span::new(connector, r, [p_before, p]);
        let sums = passages.sums(w, arm, i, &span);
        let k = Stiffness::new(w, &span, &sums);
        store(w, one, &k.rr, &mut entries.rr);
        store(w, one, &k.rp[0], &mut entries.r_before);
        store(w, sign, &k.rp[1], &mut entries.r_end);
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
        store(w, one, &before_before, &mut entries.before_before);
        store(w, sign, &before_end, &mut entries.before_end);
        store(w, sign, &end_before, &mut entries.end_before);

        // The node at the end: inertia, damping by mass, norm.
        let alpha = arm.damping_mass;
        let mut x = pdd;
        for c in 0..4 {
            x[c] = pdd[c] + pd[c] * alpha;
            end_end[c][c] = end_end[c][c] + of_norm * 2.0;
        }
        inertia::add_tangent(inertia, p, pd, x, rates.cb + alpha * rates.cg, rates.cg, &mut end_end);
        store(w, one, &end_end, &mut entries.end_end);
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
