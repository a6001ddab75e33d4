//! Cable space: measured lengths reduced to the bend angles that cables can tell, two per segment.
//!
//! `J` (cables x 2 segments) is the straight arm's length Jacobian: a cable of hole `rho [cos phi, sin phi]` lengthens
//! by `rho (a cos phi + b sin phi)` in each segment that it runs through, by the mean along it where its holes change or it
//! ends on the way. `T = J (J^T J)^-1` is its transposed
//! pseudo-inverse, so `T^T` takes lengths to bend angles and `T` takes bending moments to tensions. For even holes and
//! `local` routing this is `[cos phi, sin phi] 2/(n rho)`; the general form also covers uneven holes, `through`
//! routing, and cables without a measurement, whose rows are zero.

use crate::model::Arm;
use std::ops::Range;

/// A bend angle whose pivot falls below this share of its diagonal is not observable from the cables left.
const PIVOT_MIN: f64 = 1e-3;

/// The matrix `T` for the cables that have a measurement.
#[derive(Debug, Clone)]
pub struct CableSpace {
    jacobian: Vec<f64>,
    /// `T`, row-major cables x angles.
    t: Vec<f64>,
    angles: usize,
    valid: Vec<bool>,
    gram: Vec<f64>,
}

impl CableSpace {
    /// All cables measured. Allocates.
    pub fn new(arm: &Arm) -> Self {
        let (nc, angles) = (arm.cable_count(), 2 * arm.segment_count());
        let mut jacobian = vec![0.0; nc * angles];
        for (s, range) in arm.segment_elements.iter().enumerate() {
            for c in 0..nc {
                let [y, z] = lever(arm, range, c);
                (jacobian[c * angles + 2 * s], jacobian[c * angles + 2 * s + 1]) = (y, z);
            }
        }
        let mut made = Self {
            jacobian,
            t: vec![0.0; nc * angles],
            angles,
            valid: vec![true; nc],
            gram: vec![0.0; angles * angles],
        };
        made.build();
        made
    }

    /// Number of bend angles, 2 per segment.
    pub fn angle_count(&self) -> usize {
        self.angles
    }

    /// Row of `T` of a cable.
    pub fn row(&self, cable: usize) -> &[f64] {
        &self.t[cable * self.angles..(cable + 1) * self.angles]
    }

    /// Moments (m) about the bend angles that a newton of a cable gives: its row of `J`.
    pub fn lever(&self, cable: usize) -> &[f64] {
        &self.jacobian[cable * self.angles..(cable + 1) * self.angles]
    }

    /// `T`, row-major cables x angles.
    pub fn matrix(&self) -> &[f64] {
        &self.t
    }

    /// True where the cable's measurement counts.
    pub fn is_valid(&self, cable: usize) -> bool {
        self.valid[cable]
    }

    /// True where the valid cables tell this bend angle.
    pub fn is_observable(&self, angle: usize) -> bool {
        self.gram[angle * self.angles + angle] > 0.0
    }

    /// Takes cables out or in: those that `usable` tells. Returns whether anything changed. Does not allocate.
    pub fn select(&mut self, usable: impl Fn(usize) -> bool) -> bool {
        let mut changed = false;
        for (c, valid) in self.valid.iter_mut().enumerate() {
            let now = usable(c);
            changed |= now != *valid;
            *valid = now;
        }
        if changed {
            self.build();
        }
        changed
    }

    /// `out = T^T (a - b)` over the valid cables.
    pub fn angles_into(&self, a: &[f64], b: &[f64], out: &mut [f64]) {
        out.fill(0.0);
        for c in 0..self.valid.len() {
            // Rows of cables without measurement are zero, but their lengths may be NaN.
            if self.valid[c] {
                let d = a[c] - b[c];
                for (o, t) in out.iter_mut().zip(self.row(c)) {
                    *o += t * d;
                }
            }
        }
    }

    /// `out += T m`: bending moments (N m) as tensions (N).
    pub fn add_tensions(&self, moments: &[f64], out: &mut [f64]) {
        for (c, o) in out.iter_mut().enumerate() {
            *o += self.row(c).iter().zip(moments).map(|(t, m)| t * m).sum::<f64>();
        }
    }

    /// `J^T J` of the valid cables by Cholesky; angles that they cannot tell get a zero column in `T`.
    fn build(&mut self) {
        let n = self.angles;
        self.gram.fill(0.0);
        for (c, valid) in self.valid.iter().enumerate() {
            if *valid {
                let row = &self.jacobian[c * n..(c + 1) * n];
                for i in 0..n {
                    for k in 0..=i {
                        self.gram[i * n + k] += row[i] * row[k];
                    }
                }
            }
        }
        for i in 0..n {
            // The full arm's own diagonal: an angle with one cable left must not look regular beside itself.
            // Of the better of the two to its segment: cables in one line tell the other by rounding alone.
            let of = |i: usize| self.jacobian.chunks_exact(n).map(|row| row[i] * row[i]).sum::<f64>();
            let whole = of(i).max(of(i ^ 1));
            for k in 0..i {
                let s: f64 = (0..k).map(|j| self.gram[i * n + j] * self.gram[k * n + j]).sum();
                let pivot = self.gram[k * n + k];
                self.gram[i * n + k] = if pivot > 0.0 { (self.gram[i * n + k] - s) / pivot } else { 0.0 };
            }
            let s: f64 = (0..i).map(|j| self.gram[i * n + j].powi(2)).sum();
            let d = self.gram[i * n + i] - s;
            self.gram[i * n + i] = if d > PIVOT_MIN * whole { d.sqrt() } else { 0.0 };
        }
        for c in 0..self.valid.len() {
            let row = &mut self.t[c * n..(c + 1) * n];
            row.fill(0.0);
            if !self.valid[c] {
                continue;
            }
            for i in 0..n {
                let pivot = self.gram[i * n + i];
                let s: f64 = (0..i).map(|j| self.gram[i * n + j] * row[j]).sum();
                row[i] = if pivot > 0.0 { (self.jacobian[c * n + i] - s) / pivot } else { 0.0 };
            }
            for i in (0..n).rev() {
                let pivot = self.gram[i * n + i];
                let s: f64 = (i + 1..n).map(|j| self.gram[j * n + i] * row[j]).sum();
                row[i] = if pivot > 0.0 { (row[i] - s) / pivot } else { 0.0 };
            }
        }
    }
}

/// Lever (m) of a cable about a segment's bend angles, spread evenly over its elements: the mean of its holes' coordinates,
/// 0 where it does not run.
fn lever(arm: &Arm, elements: &Range<usize>, cable: usize) -> [f64; 2] {
    let of = |i: usize| {
        let passes = &arm.passes[arm.elements[i].passes.clone()];
        passes.iter().find(|pass| pass.cable == cable).map_or([0.0; 2], |pass| {
            let (a, b) = (&pass.hole, &pass.end);
            if a == b { [a[1], a[2]] } else { [0.5 * (a[1] + b[1]), 0.5 * (a[2] + b[2])] }
        })
    };
    let first = of(elements.start);
    // The same all along: no rounding.
    if elements.clone().all(|i| of(i) == first) {
        return first;
    }
    let share = 1.0 / elements.len() as f64;
    elements.clone().map(of).fold([0.0; 2], |[y, z], [a, b]| [y + share * a, z + share * b])
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::config::{ArmConfig, Routing};

    #[test]
    fn even_holes_give_the_closed_form() {
        let config = ArmConfig::paper();
        let space = CableSpace::new(&Arm::new(&config));
        for c in 0..24 {
            let (s, phi) = (c / 6, config.segments[0].hole_angles_rad[c % 6]);
            for i in 0..8 {
                let want = if i / 2 == s { [phi.cos(), phi.sin()][i % 2] / (3.0 * 0.05) } else { 0.0 };
                assert!((space.row(c)[i] - want).abs() < 1e-12, "{c} {i}");
            }
        }
    }

    #[test]
    fn lengths_of_bend_angles_give_them_back_with_any_routing_and_with_cables_missing() {
        for routing in [Routing::Local, Routing::Through] {
            let mut config = ArmConfig::paper();
            config.routing = routing;
            config.segments[1].hole_angles_rad = vec![0.1, 1.7, 4.0];
            let mut space = CableSpace::new(&Arm::new(&config));
            let angles: Vec<f64> = (0..8).map(|i| (i as f64).sin()).collect();
            let lengths: Vec<f64> =
                space.jacobian.chunks_exact(8).map(|r| r.iter().zip(&angles).map(|(a, b)| a * b).sum()).collect();
            let zero = vec![0.0; 21];
            for missing in [vec![], vec![0], vec![2, 4, 12]] {
                space.select(|c| !missing.contains(&c));
                let mut broken = lengths.clone();
                missing.iter().for_each(|&c| broken[c] = f64::NAN);
                let mut got = [0.0; 8];
                space.angles_into(&broken, &zero, &mut got);
                assert!(got.iter().zip(&angles).all(|(a, b)| (a - b).abs() < 1e-9), "{missing:?} {got:?}");
            }
        }
    }

    #[test]
    fn a_segment_without_cables_is_left_uncorrected_and_the_others_are_not_touched() {
        let mut space = CableSpace::new(&Arm::new(&ArmConfig::paper()));
        assert!(space.select(|c| !(6..12).contains(&c)));
        assert!(!space.select(|c| !(6..12).contains(&c)), "nothing changed the second time");
        for c in 0..24 {
            assert!(space.row(c)[2..4].iter().all(|t| *t == 0.0));
            assert_eq!(space.row(c).iter().any(|t| *t != 0.0), !(6..12).contains(&c));
        }
    }
}
