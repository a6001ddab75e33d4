//! Chord constraints: an element is inextensible and unshearable.
//!
//! Simpson: `psi = r_j - r_i - L_con t_i - (l/6)(t_i + 4 t_m + t_j)`, `t_m = t(s)/s.s`, `s = p_i + p_j`; trapezoid:
//! `psi = r_j - r_i - L_con t_i - (l/2)(t_i + t_j)`. The trapezoid shortens the chord three times too much (design 12).

use super::arm::Element;
use crate::config::ChordRule;
use crate::math::quaternion::{axes, axis_jacobians, matrix, tangent_form};
use crate::math::simd::{Columns, Number, Scalars, inner};
use nalgebra::{Matrix3x4, Vector3, Vector4};

/// Chords of an element, or of several side by side.
pub(super) struct Chord<V> {
    /// From `r_i` to `r_j`, the connector's length included (m, base frame).
    pub(super) vector: [V; 3],
    /// `dpsi/dp_i`, `dpsi/dp_j`; `dpsi/dr_i = -I`, `dpsi/dr_j = I`.
    pub(super) jacobian: [[[V; 4]; 3]; 2],
    /// `d^2 (mu . psi)` in the blocks `ii`, `ij = ji`, `jj` of the two quaternions.
    pub(super) hessian: [[[V; 4]; 4]; 3],
}

impl<V: Number> Chord<V> {
    /// From both quaternions (`p_j` in the hemisphere of `p_i`), length and connector (m), and the constraint's multiplier.
    #[inline(always)]
    pub(super) fn new<W: Columns<Value = V>>(
        w: W,
        rule: ChordRule,
        p: [[V; 4]; 2],
        l: V,
        connector: V,
        mu: [V; 3],
    ) -> Self {
        let zero = w.splat(0.0);
        let share = match rule {
            ChordRule::Trapezoid => l * 0.5,
            ChordRule::Simpson => l * (1.0 / 6.0),
        };
        let ends = [connector + share, share];
        let form = tangent_form(mu, zero);
        let mut chord = Self { vector: [zero; 3], jacobian: [[[zero; 4]; 3]; 2], hessian: [[[zero; 4]; 4]; 3] };
        for end in 0..2 {
            let (axis, jacobian) = (axes(p[end])[0], axis_jacobians(p[end])[0]);
            for r in 0..3 {
                chord.vector[r] = ends[end].multiply_add(axis[r], chord.vector[r]);
                for c in 0..4 {
                    chord.jacobian[end][r][c] = -ends[end] * jacobian[r][c];
                }
            }
            let twice = ends[end] * -2.0;
            for r in 0..4 {
                for c in 0..4 {
                    chord.hessian[2 * end][r][c] = twice * form[r][c];
                }
            }
        }
        if rule == ChordRule::Simpson {
            let mut s = p[0];
            for c in 0..4 {
                s[c] = s[c] + p[1][c];
            }
            chord.add_middle(s, inner(&s, &s).inverse(), share * 4.0, form);
        }
        chord
    }

    /// The tangent in the middle: `share t(s)/s.s`, `inverse = 1/s.s`.
    #[inline(always)]
    fn add_middle(&mut self, s: [V; 4], inverse: V, share: V, form: [[V; 4]; 4]) {
        let weight = share * inverse;
        let (axis, jacobian) = (axes(s)[0], axis_jacobians(s)[0]);
        for r in 0..3 {
            self.vector[r] = weight.multiply_add(axis[r], self.vector[r]);
            let slope = axis[r] * inverse * -2.0;
            for c in 0..4 {
                let d = weight * slope.multiply_add(s[c], jacobian[r][c]);
                self.jacobian[0][r][c] = self.jacobian[0][r][c] - d;
                self.jacobian[1][r][c] = self.jacobian[1][r][c] - d;
            }
        }
        let mut turned = s;
        for r in 0..4 {
            turned[r] = inner(&form[r], &s);
        }
        let value = inner(&s, &turned) * inverse;
        let mut slope = s;
        for r in 0..4 {
            slope[r] = (turned[r] - value * s[r]) * inverse * 2.0;
        }
        for r in 0..4 {
            for c in 0..=r {
                let mut d = form[r][c] - s[r].multiply_add(slope[c], slope[r] * s[c]);
                if r == c {
                    d = d - value;
                }
                let d = weight * d * -2.0;
                for block in 0..3 {
                    self.hessian[block][r][c] = self.hessian[block][r][c] + d;
                    if r != c {
                        self.hessian[block][c][r] = self.hessian[block][c][r] + d;
                    }
                }
            }
        }
    }
}

impl Chord<f64> {
    /// Of one element.
    pub(super) fn of(rule: ChordRule, e: &Element, pi: &Vector4<f64>, pj: &Vector4<f64>, mu: Vector3<f64>) -> Self {
        Self::new(Scalars, rule, [(*pi).into(), (*pj).into()], e.length, e.connector, mu.into())
    }

    /// The derivatives as matrices.
    pub(super) fn jacobians(&self) -> (Matrix3x4<f64>, Matrix3x4<f64>) {
        (matrix(self.jacobian[0]), matrix(self.jacobian[1]))
    }
}

/// `d^2 psi / dt^2` at zero acceleration: the second directional derivative along the rates (base frame).
pub(super) fn convective(rule: ChordRule, e: &Element, p: [&Vector4<f64>; 2], pd: [&Vector4<f64>; 2]) -> Vector3<f64> {
    let mut acc = Vector3::zeros();
    for k in 0..3 {
        let [ii, ij, jj] = Chord::of(rule, e, p[0], p[1], Vector3::ith(k, 1.0)).hessian.map(matrix);
        acc[k] = pd[0].dot(&(ii * pd[0])) + 2.0 * pd[0].dot(&(ij * pd[1])) + pd[1].dot(&(jj * pd[1]));
    }
    acc
}
