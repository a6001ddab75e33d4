//! Natural modes about an equilibrium: `K x = omega^2 M x` of the tangent, reduced to what the constraints leave free.
//!
//! A node's rotation has three free coordinates (`p' = p (0, w)/2`), its position follows from the chord before it; so the
//! 7N coordinates are `Z` times the 3N rotations, and `Z` is built from the tangent's own constraint rows, node by node.

use crate::math::block_tridiagonal::{BlockTridiagonal, COORDINATES};
use crate::math::quaternion::product;
use crate::model::{Arm, Linearization, Motion, Rates, State};
use nalgebra::{Cholesky, DMatrix, Matrix3, SymmetricEigen, Vector3, Vector4};

/// A natural mode.
#[derive(Debug, Clone, PartialEq)]
pub struct Mode {
    /// Square of its angular frequency (rad^2/s^2); below 0 the equilibrium is not stable in it.
    pub square: f64,
    /// Damping over the critical one.
    pub damping_ratio: f64,
    /// Share of its elastic energy that twists the arm; the rest bends it.
    pub torsion: f64,
    /// Displacement of the tip in it (base frame), of unit length where the tip moves at all.
    pub tip: Vector3<f64>,
    /// Points of the arm between base and tip that stay where they are: of the displacement where it bends, of the twist
    /// where it twists.
    pub resting_points: usize,
}

impl Mode {
    /// Angular frequency (rad/s); NaN where it is not stable.
    pub fn omega_radps(&self) -> f64 {
        self.square.sqrt()
    }
}

/// Modes of an arm that rests in `state` under tensions `u` (N), slowest first. `None` where the tangent is not finite or a
/// node has no mass. Allocates.
pub fn modes(arm: &Arm, state: &State, u: &[f64]) -> Option<Vec<Mode>> {
    let n = arm.node_count();
    let mut linearization = Linearization::new(arm);
    let mut at = |rates: Rates| {
        arm.linearize(&Motion::from(state), u, rates, &mut linearization);
        linearization.tangent.clone()
    };
    let still = at(Rates::STATIC);
    let (damped, heavy) = (at(Rates { cg: 1.0, cb: 0.0 }), at(Rates { cg: 0.0, cb: 1.0 }));
    let z = free_motions(arm, state, &still);
    let (zt, of) = (z.transpose(), |tangent: &BlockTridiagonal| coordinates(tangent, n));
    let k_full = of(&still);
    let reduce = |full: DMatrix<f64>| {
        let reduced = &zt * full * &z;
        (&reduced + reduced.transpose()) * 0.5
    };
    let mass = reduce(of(&heavy) - &k_full);
    let damping = reduce(of(&damped) - &k_full);
    let stiffness = reduce(k_full);
    if stiffness.iter().chain(mass.iter()).any(|x| !x.is_finite()) {
        return None;
    }
    let lower = Cholesky::new(mass)?.l();
    let half = lower.solve_lower_triangular(&stiffness)?;
    let symmetric = lower.solve_lower_triangular(&half.transpose())?;
    let eigen = SymmetricEigen::new((&symmetric + symmetric.transpose()) * 0.5);
    let mut order: Vec<usize> = (0..3 * n).collect();
    order.sort_by(|a, b| eigen.eigenvalues[*a].total_cmp(&eigen.eigenvalues[*b]));
    let found = order.into_iter().map(|k| {
        // x = L^-T y, of unit modal mass.
        let x = lower.tr_solve_lower_triangular(&eigen.eigenvectors.column(k).into_owned())?;
        let square = eigen.eigenvalues[k];
        let decay = 0.5 * (x.transpose() * &damping * &x)[0];
        let moved = &z * &x;
        let tip = Vector3::from_fn(|c, _| moved[COORDINATES * (n - 1) + c]);
        let turn =
            |node: usize| if node == 0 { Vector3::zeros() } else { Vector3::from_fn(|c, _| x[3 * (node - 1) + c]) };
        let (mut twist, mut bend) = (0.0, 0.0);
        for (i, element) in arm.elements.iter().enumerate() {
            let d = turn(i + 1) - turn(i);
            twist += element.stiffness[0] / element.length * d[0] * d[0];
            bend += element.stiffness[1] / element.length * (d[1] * d[1] + d[2] * d[2]);
        }
        let torsion = twist / (twist + bend);
        let along = |node: usize| Vector3::from_fn(|c, _| moved[COORDINATES * node + c]);
        let farthest = (0..n).map(along).max_by(|a, b| a.norm().total_cmp(&b.norm())).unwrap_or_else(Vector3::zeros);
        let profile: Vec<f64> =
            (0..n).map(|i| if torsion > 0.5 { x[3 * i] } else { along(i).dot(&farthest) }).collect();
        Some(Mode {
            square,
            damping_ratio: decay / square.abs().sqrt(),
            torsion,
            resting_points: turns_of_sign(&profile),
            tip: tip.try_normalize(1e-9 * tip.norm().max(1e-300)).unwrap_or_else(Vector3::zeros),
        })
    });
    found.collect()
}

/// How often a profile changes its sign; what is less than a fiftieth of the largest has none.
fn turns_of_sign(profile: &[f64]) -> usize {
    let least = 0.02 * profile.iter().fold(0.0f64, |a, x| a.max(x.abs()));
    let signs: Vec<bool> = profile.iter().filter(|x| x.abs() > least).map(|x| *x > 0.0).collect();
    signs.windows(2).filter(|pair| pair[0] != pair[1]).count()
}

/// `Z`, 7N x 3N: the coordinates' motion for a rotation (body frame) of each node.
pub(crate) fn free_motions(arm: &Arm, state: &State, tangent: &BlockTridiagonal) -> DMatrix<f64> {
    let n = arm.node_count();
    let mut z = DMatrix::zeros(COORDINATES * n, 3 * n);
    for i in 0..n {
        let p = arm.pose(&state.q, i + 1).1;
        for axis in 0..3 {
            let mut w = Vector4::zeros();
            w[axis + 1] = 0.5;
            let turned = product(&p, &w);
            for c in 0..4 {
                z[(COORDINATES * i + 3 + c, 3 * i + axis)] = turned[c];
            }
        }
        // The chord's rows: D_r dr_i + D_p dp_i + L dq_{i-1} = 0.
        let (own, before) = (&tangent.diagonal[i], &tangent.lower[i]);
        let inverse = Matrix3::from_fn(|r, c| own[(COORDINATES + r, c)]).try_inverse().unwrap_or_else(Matrix3::zeros);
        for column in 0..3 * (i + 1) {
            let mut pull = Vector3::zeros();
            for r in 0..3 {
                for c in 0..4 {
                    pull[r] += own[(COORDINATES + r, 3 + c)] * z[(COORDINATES * i + 3 + c, column)];
                }
                if i > 0 {
                    for c in 0..COORDINATES {
                        pull[r] += before[(COORDINATES + r, c)] * z[(COORDINATES * (i - 1) + c, column)];
                    }
                }
            }
            let moved = -(inverse * pull);
            for r in 0..3 {
                z[(COORDINATES * i + r, column)] = moved[r];
            }
        }
    }
    z
}

/// The coordinates' part of a tangent, 7N x 7N.
fn coordinates(tangent: &BlockTridiagonal, n: usize) -> DMatrix<f64> {
    let mut full = DMatrix::zeros(COORDINATES * n, COORDINATES * n);
    for i in 0..n {
        let mut put = |column: usize, block: &crate::math::block_tridiagonal::Block| {
            for r in 0..COORDINATES {
                for c in 0..COORDINATES {
                    full[(COORDINATES * i + r, COORDINATES * column + c)] = block[(r, c)];
                }
            }
        };
        put(i, &tangent.diagonal[i]);
        if i > 0 {
            put(i - 1, &tangent.lower[i]);
        }
        if i + 1 < n {
            put(i + 1, &tangent.upper[i]);
        }
    }
    full
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::config::{ArmConfig, Scale};

    #[test]
    fn the_straight_arms_first_modes_are_those_that_the_configuration_counts_in() {
        let config = ArmConfig::paper();
        let arm = Arm::new(&config);
        let found = modes(&arm, &State::at_rest(arm.straight()), &[0.0; 24]).unwrap();
        assert_eq!(found.len(), 60);
        let first = Scale::of(&config).omega_radps;
        for mode in &found[..2] {
            assert!((mode.omega_radps() / first - 1.0).abs() < 1e-5, "{mode:?}, {first} rad/s");
            // Damping proportional to stiffness: zeta = beta omega / 2.
            assert!((mode.damping_ratio / (0.5 * 0.05 * first) - 1.0).abs() < 1e-4, "{mode:?}");
            assert!(mode.torsion < 1e-6 && mode.tip.z.abs() < 1e-6);
        }
        assert!(found.windows(2).all(|pair| pair[0].square <= pair[1].square));
        assert!(found.iter().any(|mode| mode.torsion > 0.999));
        // A cantilever's modes come in pairs, each pair with a resting point more; twist begins anew.
        let bends: Vec<usize> = found.iter().filter(|m| m.torsion < 0.01).take(8).map(|m| m.resting_points).collect();
        assert_eq!(bends, [0, 0, 1, 1, 2, 2, 3, 3]);
        let twists: Vec<usize> = found.iter().filter(|m| m.torsion > 0.99).take(3).map(|m| m.resting_points).collect();
        assert_eq!(twists, [0, 1, 2]);
    }

    #[test]
    fn a_hanging_arm_is_stiffened_and_an_upright_one_may_fall() {
        let mut config = ArmConfig::paper();
        let first = |config: &ArmConfig| {
            let arm = Arm::new(config);
            let mut state = State::at_rest(arm.straight());
            let mut stepper = super::super::Stepper::new(&arm);
            super::super::equilibrium(&arm, &mut stepper, &[0.0; 24], &mut state).unwrap();
            modes(&arm, &state, &[0.0; 24]).unwrap()[0].square
        };
        let weightless = first(&config);
        config.gravity_mps2 = [0.0, 0.0, -9.81];
        let hanging = first(&config);
        let scale = Scale::of(&config).omega_radps;
        assert!(hanging > 2.0 * weightless);
        assert!((hanging.sqrt() / scale - 1.0).abs() < 1e-3, "{} rad/s, {scale} by the chain", hanging.sqrt());
        config.gravity_mps2 = [0.0, 0.0, 9.81];
        assert!(first(&config) < 0.0, "7 N m^2 do not hold 6 kg upright over 2.75 m");
    }
}
