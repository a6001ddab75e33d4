//! Every term of the residual, the tangent, lengths, curvatures and collision points against the golden states.
#![allow(clippy::unwrap_used, clippy::expect_used, clippy::print_stdout)] // a test may panic and print
mod support;

use nalgebra::Vector3;
use serde_json::Value;
use sinew::collision::BodyGeometry;
use sinew::math::block_tridiagonal::BLOCK;
use sinew::model::{Arm, Linearization, Motion, Rates};
use support::*;

const TERM: f64 = 1e-9;

fn sets() -> Vec<(String, Value, Vec<Value>, Option<Value>)> {
    let mut sets = Vec::new();
    let mut add = |name: String, set: &Value| {
        let states = set["states"].as_array().unwrap().clone();
        assert!(!states.is_empty(), "{name} has no states");
        sets.push((name, set["params"].clone(), states, set.get("par_node").cloned()));
    };
    for (name, file) in golden_files("states") {
        add(name, &file);
    }
    for (name, file) in golden_files("variants") {
        for variant in file["variants"].as_array().unwrap() {
            add(format!("{name}/{}", variant["name"].as_str().unwrap()), variant);
        }
    }
    assert!(!sets.is_empty());
    sets
}

#[test]
fn node_masses_and_inertias_agree() {
    let mut checked = 0;
    for (name, params, _, par) in sets() {
        let Some(par) = par else { continue };
        let arm = Arm::new(&arm_config(&params));
        let column = |f: &dyn Fn(&sinew::model::Node) -> f64| arm.nodes.iter().map(f).collect::<Vec<_>>();
        assert_close(&format!("{name} m"), &column(&|n| n.mass), &numbers(&par["m"]), TERM);
        assert_close(&format!("{name} Jx"), &column(&|n| n.inertia[0]), &numbers(&par["Jx"]), TERM);
        assert_close(&format!("{name} Jt"), &column(&|n| n.inertia[1]), &numbers(&par["Jt"]), TERM);
        checked += 1;
    }
    assert!(checked > 0);
}

#[test]
fn every_term_of_the_residual_agrees() {
    for (set, params, states, _) in sets() {
        let arm = Arm::new(&arm_config(&params));
        let (n, nc) = (arm.node_count(), arm.cable_count());
        for (k, s) in states.iter().enumerate() {
            let v = |key: &str| numbers(&s[key]);
            let (q, qd, qdd, lam, u) = (v("q"), v("qd"), v("qdd"), v("lam"), v("u"));
            let check = |key: &str, got: &[f64]| {
                // Some files leave the widest arrays out of some states.
                if !(key == "G_rowmajor" && s.get(key).is_none()) {
                    assert_close(&format!("{set} state {k} {key}"), got, &v(key), TERM);
                }
            };
            let term = |f: &dyn Fn(&mut [f64])| {
                let mut out = vec![0.0; 7 * n];
                f(&mut out);
                out
            };
            check("M_qdd", &term(&|o| arm.add_inertia(&q, &qdd, o)));
            check("C_vel", &term(&|o| arm.add_gyroscopic(&q, &qd, o)));
            check("F_damp", &term(&|o| arm.add_damping(&q, &qd, o)));
            check("dE_dq", &term(&|o| arm.add_elastic(&q, o)));
            check("dVg_dq", &term(&|o| arm.add_gravity(o)));
            check("PsiT_lam", &term(&|o| arm.add_constraint_forces(&q, &lam, o)));
            check("Gu", &term(&|o| arm.add_cable_forces(&q, &u, 1.0, o)));
            assert_close("E", &[arm.elastic_energy(&q)], &[number(&s["E"])], TERM);
            let mut psi = vec![0.0; 4 * n];
            arm.constraints_into(&q, &mut psi);
            // Consistent states have psi = 0 to rounding: compare against a length of 1 m there.
            let want = v("psi");
            let scale = want.iter().fold(0.0f64, |a, x| a.max(x.abs())).max(1e-6);
            assert!(psi.iter().zip(&want).all(|(a, b)| (a - b).abs() <= TERM * scale), "{set} state {k} psi");
            let mut g = vec![0.0; 7 * n * nc];
            arm.cable_input_into(&q, &mut g);
            check("G_rowmajor", &g);
            let mut lengths = vec![0.0; nc];
            arm.cable_lengths_into(&q, &mut lengths);
            check("cable_len", &lengths);
            let mut rates = vec![0.0; nc];
            arm.cable_rates_into(&q, &qd, &mut rates);
            let expected: Vec<f64> = (0..nc).map(|c| -(0..7 * n).map(|r| g[r * nc + c] * qd[r]).sum::<f64>()).collect();
            assert_close("cable rates = -G^T q'", &rates, &expected, TERM);
            let (mut kappa, mut kappad) = (vec![0.0; 2 * arm.segment_count()], vec![0.0; 2 * arm.segment_count()]);
            arm.curvatures_into(&q, &qd, &mut kappa, &mut kappad);
            check("kappa_seg", &kappa);
            check("kappa_seg_rate", &kappad);
            let (mut el, mut eld) = (Vec::new(), Vec::new());
            for i in 0..n {
                let (a, b) = arm.element_curvature(&q, &qd, i);
                el.extend_from_slice(a.as_slice());
                eld.extend_from_slice(b.as_slice());
            }
            check("kappa_el", &el);
            check("kappa_rate_el", &eld);
            let (mut upper, mut lower) = (vec![0.0; 7 * n], vec![0.0; 4 * n]);
            arm.residual_into(&Motion { q: &q, qd: &qd, qdd: &qdd, lambda: &lam }, &u, &mut upper, &mut lower);
            upper.extend_from_slice(&lower);
            check("g", &upper);
        }
    }
}

#[test]
fn the_total_tangent_agrees_in_a_random_direction() {
    for (set, params, states, _) in sets() {
        let arm = Arm::new(&arm_config(&params));
        let (n, nc) = (arm.node_count(), arm.cable_count());
        let mut lin = Linearization::new(&arm);
        for (k, s) in states.iter().enumerate() {
            let v = |key: &str| numbers(&s[key]);
            let (q, qd, qdd, lam, u) = (v("q"), v("qd"), v("qdd"), v("lam"), v("u"));
            let test = &s["tangent_test"];
            let w = numbers(&test["w"]);
            for scale in [1.0, 1e3] {
                lin.scale = scale;
                let rates = Rates { cg: number(&test["cg"]), cb: number(&test["cb"]) };
                let motion = Motion { q: &q, qd: &qd, qdd: &qdd, lambda: &lam };
                arm.linearize(&motion, &u, rates, &mut lin);
                let mut x = vec![0.0; BLOCK * n];
                for i in 0..n {
                    x[BLOCK * i..BLOCK * i + 7].copy_from_slice(&w[7 * i..7 * i + 7]);
                    for c in 0..4 {
                        x[BLOCK * i + 7 + c] = w[7 * n + 4 * i + c] / scale;
                    }
                }
                let mut y = vec![0.0; BLOCK * n];
                lin.tangent.multiply_into(&x, &mut y);
                let mut b = vec![0.0; 7 * n * nc];
                lin.input_into(&arm, &mut b);
                let (mut got, mut f) = (vec![0.0; BLOCK * n], vec![0.0; BLOCK * n]);
                for i in 0..n {
                    for c in 0..BLOCK {
                        let (to, factor) = if c < 7 { (7 * i + c, 1.0) } else { (7 * n + 4 * i + c - 7, 1.0 / scale) };
                        got[to] = y[BLOCK * i + c] * factor;
                        // Constraints have no row in B.
                        let row = if c < 7 { &b[(7 * i + c) * nc..(7 * i + c + 1) * nc] } else { &[][..] };
                        let bu: f64 = row.iter().zip(&u).map(|(b, u)| b * u).sum();
                        f[to] = (lin.f[BLOCK * i + c] - bu) * factor;
                    }
                }
                assert_close(&format!("{set} state {k} A w"), &got, &numbers(&test["A_w"]), TERM);
                assert_close(&format!("{set} state {k} f - B u"), &f, &v("g"), TERM);
            }
        }
    }
}

/// The first column of R(p), homogeneous: the tangent of a node whose quaternion need not be of unit length.
fn tangent([w, x, y, z]: [f64; 4]) -> Vector3<f64> {
    Vector3::new(w * w + x * x - y * y - z * z, 2.0 * (x * y + w * z), 2.0 * (x * z - w * y))
}

#[test]
fn collision_points_agree() {
    let mut checked = 0;
    for (set, params, states, _) in sets() {
        let config = arm_config(&params);
        let geometry = BodyGeometry::from_arm(&config);
        // The reference ends every segment but the last with a connector's end, be its length 0 or not; without a
        // connector that is the node once more, and no point of its own here.
        let elements = params["n_e"].as_u64().unwrap() as usize;
        let segments = params["n_seg"].as_u64().unwrap() as usize;
        let bare = number(&params["L_con"]) == 0.0;
        for (k, s) in states.iter().enumerate() {
            let Some(want) = s.get("collision_pts") else { continue };
            let want = numbers(want);
            let (mut r, mut t) = (vec![Vector3::zeros()], vec![tangent(config.base_quaternion)]);
            for node in numbers(&s["q"]).chunks_exact(7) {
                r.push(Vector3::from_column_slice(&node[..3]));
                t.push(tangent(node[3..].try_into().unwrap()));
            }
            let mut got = Vec::new();
            let mut points = geometry.paper_points().into_iter().map(|p| p.combine(&r, &t));
            for element in 0..elements * segments {
                got.extend(points.next().unwrap().iter());
                let node = points.next().unwrap();
                got.extend(node.iter());
                let ends_segment = (element + 1) % elements == 0 && element + 1 < elements * segments;
                if ends_segment {
                    let end = if bare { node } else { points.next().unwrap() };
                    got.extend(end.iter());
                }
            }
            assert!(points.next().is_none(), "{set} state {k}: more points than the reference");
            assert_close(&format!("{set} state {k} collision_pts"), &got, &want, TERM);
            checked += 1;
        }
    }
    assert!(checked > 0);
}
