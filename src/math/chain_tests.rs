//! Claims about the elimination of a chain.

use super::*;
use rand::{RngExt, SeedableRng};
use rand_xoshiro::Xoshiro256PlusPlus;

const SCALE: f64 = 40.0;

/// Random equations of motion with the constraints' pattern; nothing is symmetric.
fn random(nodes: usize, seed: u64) -> BlockTridiagonal {
    let mut rng = Xoshiro256PlusPlus::seed_from_u64(seed);
    let mut a = BlockTridiagonal::zeros(nodes);
    for i in 0..nodes {
        for r in 0..COORDINATES {
            for c in 0..COORDINATES {
                a.diagonal[i][(r, c)] = rng.random_range(-1.0..1.0);
                if i > 0 {
                    a.lower[i][(r, c)] = rng.random_range(-0.3..0.3);
                    a.upper[i - 1][(r, c)] = rng.random_range(-0.3..0.3);
                }
            }
            a.diagonal[i][(r, r)] += 4.0;
        }
        for c in 0..3 {
            a.diagonal[i][(7 + c, c)] = SCALE;
            a.diagonal[i][(c, 7 + c)] = SCALE;
            if i > 0 {
                a.lower[i][(7 + c, c)] = -SCALE;
                a.upper[i - 1][(c, 7 + c)] = -SCALE;
            }
            for q in 3..7 {
                let (here, before) = (rng.random_range(-0.5..0.5), rng.random_range(-0.5..0.5));
                a.diagonal[i][(7 + c, q)] = SCALE * here;
                a.diagonal[i][(q, 7 + c)] = SCALE * here;
                if i > 0 {
                    a.lower[i][(7 + c, q)] = SCALE * before;
                    a.upper[i - 1][(q, 7 + c)] = SCALE * before;
                }
            }
        }
        for q in 3..7 {
            let p = SCALE * rng.random_range(0.5..1.5);
            a.diagonal[i][(10, q)] = p;
            a.diagonal[i][(q, 10)] = p;
        }
    }
    a
}

#[test]
fn solutions_satisfy_the_system_whatever_the_right_hand_side() {
    for nodes in [1, 2, 5, 20] {
        let a = random(nodes, 7);
        let mut factor = Factor::new(nodes);
        factor.factor(&a).unwrap();
        let rhs: Vec<f64> = (0..nodes * BLOCK).map(|k| (k as f64 * 0.37).sin()).collect();
        let (mut x, mut back) = (rhs.clone(), vec![0.0; rhs.len()]);
        factor.solve_in_place(&mut x);
        a.multiply_into(&x, &mut back);
        let size = x.iter().fold(1.0f64, |s, x| s.max(x.abs()));
        for (r, (got, want)) in back.iter().zip(&rhs).enumerate() {
            assert!((got - want).abs() < 1e-11 * size, "{nodes} nodes, row {r}: {got} for {want}");
        }
    }
}

#[test]
fn a_panel_has_the_coordinates_of_each_of_its_columns() {
    for (nodes, columns) in [(1, 1), (2, 4), (20, 5), (20, 24)] {
        let a = random(nodes, 11);
        let mut factor = Factor::new(nodes);
        factor.factor(&a).unwrap();
        // Column c ends at node c: behind it there is nothing to solve for on the way to the base.
        for ends in [false, true] {
            let first: Vec<usize> = (0..nodes).map(|i| if ends { i.min(columns) } else { 0 }).collect();
            let mut panel = vec![0.0; nodes * COORDINATES * columns];
            let mut each = vec![vec![0.0; nodes * BLOCK]; columns];
            for i in 0..nodes {
                for r in 0..COORDINATES {
                    for c in first[i]..columns {
                        let v = ((i * 31 + r * 7 + c) as f64).cos();
                        panel[(i * COORDINATES + r) * columns + c] = v;
                        each[c][i * BLOCK + r] = v;
                    }
                }
            }
            factor.solve_panel_in_place(columns, &first, &mut panel);
            for (c, one) in each.iter_mut().enumerate() {
                factor.solve_in_place(one);
                for i in 0..nodes {
                    for r in 0..COORDINATES {
                        let (got, want) = (panel[(i * COORDINATES + r) * columns + c], one[i * BLOCK + r]);
                        assert!((got - want).abs() < 1e-12 * want.abs().max(1.0), "node {i} row {r} column {c}");
                    }
                }
            }
        }
    }
}

#[test]
fn singular_and_non_finite_nodes_are_refused_with_their_number() {
    // A node that nothing resists: neither it nor anything behind it has a stiffness.
    let mut a = random(3, 1);
    for i in 0..3 {
        for r in 0..COORDINATES {
            for c in 0..COORDINATES {
                a.diagonal[i][(r, c)] = 0.0;
                a.lower[i][(r, c)] = 0.0;
                a.upper[i][(r, c)] = 0.0;
            }
        }
    }
    assert_eq!(Factor::new(3).factor(&a), Err(Singular(2)));
    let mut a = random(3, 1);
    a.diagonal[2][(4, 4)] = f64::NAN;
    assert_eq!(Factor::new(3).factor(&a), Err(Singular(2)));
}
