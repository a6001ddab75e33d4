//! What moves.

/// State of an arm at one time; all arrays node by node from node 1 on.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct State {
    /// Coordinates `q`, 7N (m, 1).
    pub q: Vec<f64>,
    /// Rates `q'`, 7N (m/s, 1/s).
    pub qd: Vec<f64>,
    /// Accelerations `q''`, 7N.
    pub qdd: Vec<f64>,
    /// Auxiliary acceleration `a` of the generalised-alpha method, 7N.
    pub a: Vec<f64>,
    /// Multipliers, 4N: chord (3) and norm (1) per node.
    pub lambda: Vec<f64>,
}

impl State {
    /// At rest in `q`, without accelerations and multipliers. Allocates.
    pub fn at_rest(q: Vec<f64>) -> Self {
        let n = q.len();
        Self { qd: vec![0.0; n], qdd: vec![0.0; n], a: vec![0.0; n], lambda: vec![0.0; n / 7 * 4], q }
    }

    /// Copies all values from a state of the same arm. Does not allocate.
    pub fn copy_from(&mut self, other: &Self) {
        self.q.copy_from_slice(&other.q);
        self.qd.copy_from_slice(&other.qd);
        self.qdd.copy_from_slice(&other.qdd);
        self.a.copy_from_slice(&other.a);
        self.lambda.copy_from_slice(&other.lambda);
    }

    /// True if every number is finite.
    pub fn is_finite(&self) -> bool {
        [&self.q, &self.qd, &self.qdd, &self.a, &self.lambda].iter().all(|v| v.iter().all(|x| x.is_finite()))
    }
}
