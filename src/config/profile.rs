//! What changes along a segment: values at stations, linear between them.

use serde::Serialize;

/// Stations `[place, value]` by ascending place: linear between them, constant before the first and behind the last; two at the
/// same place make a step. Without stations the value is one number everywhere, which the reader names.
#[derive(Debug, Clone, PartialEq, Default, Serialize)]
#[serde(transparent)]
pub struct Profile(pub Vec<[f64; 2]>);

impl Profile {
    /// True without stations.
    pub fn is_empty(&self) -> bool {
        self.0.is_empty()
    }

    /// Value at a place, at a step that before it; `constant` without stations.
    pub fn at(&self, x: f64, constant: f64) -> f64 {
        if self.is_empty() { constant } else { self.between(x, self.0.partition_point(|s| s[0] < x)) }
    }

    /// Value at `x` between the stations before and from `next` on.
    fn between(&self, x: f64, next: usize) -> f64 {
        match (next.checked_sub(1).and_then(|i| self.0.get(i)), self.0.get(next)) {
            (Some([a, v]), Some([b, w])) => v + (w - v) * (x - a) / (b - a),
            (Some([_, v]), None) | (None, Some([_, v])) => *v,
            (None, None) => f64::NAN,
        }
    }

    /// Mean of the value over `a..b`; 1 without stations. Exact.
    pub fn mean(&self, a: f64, b: f64) -> f64 {
        self.average(a, b, |v, w| 0.5 * (v + w))
    }

    /// Mean of one over the value over `a..b`, such that a moment bends elements in series as it bends them together; 1 without
    /// stations. Exact to 1e-12 of itself.
    pub fn mean_inverse(&self, a: f64, b: f64) -> f64 {
        self.average(a, b, |v, w| {
            let d = w - v;
            if d.abs() < 1e-5 * v { 2.0 / (v + w) } else { (w / v).ln() / d }
        })
    }

    fn average(&self, a: f64, b: f64, of_piece: impl Fn(f64, f64) -> f64) -> f64 {
        if self.is_empty() {
            return 1.0;
        }
        let (mut sum, mut from) = (0.0, a);
        let inside = self.0.iter().map(|s| s[0]).filter(|x| *x > a && *x < b);
        for to in inside.chain([b]) {
            if to > from {
                let v = self.between(from, self.0.partition_point(|s| s[0] <= from));
                sum += (to - from) * of_piece(v, self.at(to, f64::NAN));
                from = to;
            }
        }
        sum / (b - a)
    }

    /// The same profile with each value times `factor`.
    pub(super) fn times(&self, factor: f64) -> Self {
        Self(self.0.iter().map(|[x, v]| [*x, v * factor]).collect())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn values_are_linear_between_stations_and_means_are_those_of_a_fine_sum() {
        let p = Profile(vec![[0.2, 1.0], [0.5, 3.0], [0.5, 2.0], [0.9, 2.0]]);
        for (x, want) in [(0.0, 1.0), (0.35, 2.0), (0.5, 3.0), (0.500_000_1, 2.0), (1.0, 2.0)] {
            assert!((p.at(x, 9.0) - want).abs() < 1e-6, "{x}: {}", p.at(x, 9.0));
        }
        for (a, b) in [(0.0, 1.0), (0.1, 0.4), (0.5, 0.7), (0.3, 0.5)] {
            let n = 200_000;
            let at = |i: usize| p.at(a + (b - a) * (i as f64 + 0.5) / f64::from(n), 9.0);
            let sum: f64 = (0..n as usize).map(at).sum::<f64>() / f64::from(n);
            let inverse: f64 = (0..n as usize).map(|i| 1.0 / at(i)).sum::<f64>() / f64::from(n);
            assert!((p.mean(a, b) - sum).abs() < 1e-5 && (p.mean_inverse(a, b) - inverse).abs() < 1e-5, "{a} {b}");
        }
        let none = Profile::default();
        assert_eq!((none.at(0.3, 9.0), none.mean(0.0, 0.3), none.mean_inverse(0.0, 0.3)), (9.0, 1.0, 1.0));
    }
}
