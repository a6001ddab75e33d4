//! The swarm of the warning subspace on one problem: the reduced quadratic cost of a planning step near an obstacle, and
//! the penalty (27) on the distances of its linearised body points.

use crate::safe::{self, Case};
use crate::{count, cpu_seconds};
use nalgebra::{Matrix3x4, Vector3};
use rand::SeedableRng;
use rand_xoshiro::Xoshiro256PlusPlus;
use serde_json::{Value, json};
use sinew::collision::{Body, BodyGeometry, Obstacle, ObstacleSet, Proximity, Shape, pose};
use sinew::config::{ArmConfig, BodyModel, ShapeConfig, SwarmConfig};
use sinew::integrator::{AffineMap, Scheme, Stepper};
use sinew::math::quaternion::rotation_jacobians;
use sinew::model::{Arm, Motion, State};
use sinew::planner::Quadratic;
use sinew::planner::swarm::{Pairs, Swarm, Variant};

/// Penalty factor nu of the shape example.
const PENALTY: f64 = 1e16;
/// Radius of the paper's balls (m).
const RADIUS_M: f64 = 0.1;
/// Body points this near to a ball take part (m), as in the planner.
const REACH_M: f64 = 0.06;
/// Rows of one node in the affine map.
const COORDINATES: usize = sinew::math::block_tridiagonal::COORDINATES;

struct Loaded {
    case: Case,
    quadratic: Quadratic,
    rows: Vec<Proximity>,
    origin: Vec<f64>,
    slope: Vec<f64>,
    obstacles: ObstacleSet,
}

#[derive(Default)]
pub struct Server {
    loaded: Option<Loaded>,
}

impl Server {
    /// Builds the problem of a case at the first Newton iterate and returns it as numbers.
    pub fn problem(&mut self, request: &Value) -> Value {
        let case = safe::case(count(request, "case"));
        let config = ArmConfig::paper();
        let arm = Arm::new(&config);
        let scheme = Scheme::new(config.rho_inf);
        let rates = scheme.rates(case.eta);
        let (mut stepper, mut map) = (Stepper::new(&arm), AffineMap::new(&arm));
        let mut next = State::at_rest(arm.straight());
        scheme.predict(case.eta, &case.state, &mut next);
        stepper.linearize(&arm, &Motion::from(&next), &case.u_previous, rates).expect("a regular tangent");
        stepper.affine_map_into(&arm, &mut map);
        let change: Vec<f64> = arm.cable_segment.iter().map(|&s| safe::change(&case)[s]).collect();
        let mut quadratic = Quadratic::new(&arm);
        let goal = safe::goal(&case, request);
        quadratic.build(&arm, &next, rates, &map, &goal, 1.0, &change, &case.u_previous);

        let mut obstacles = ObstacleSet::new();
        for (k, at) in case.obstacles.iter().enumerate() {
            let ball = Shape::new(&ShapeConfig::Ball { radius_m: RADIUS_M }).expect("a good shape");
            let at = pose(*at, [1.0, 0.0, 0.0, 0.0]).expect("a good pose");
            obstacles.insert(Obstacle::new(k as u64, ball, &at).expect("a good obstacle")).expect("room");
        }
        let n = arm.node_count();
        let (mut r, mut t) = (vec![Vector3::zeros(); n + 1], vec![Vector3::zeros(); n + 1]);
        arm.frames_into(&next.q, &mut r, &mut t);
        let mut body = Body::new(&BodyGeometry::from_arm(&config), BodyModel::Points, 0.0);
        let rows = body.find(&r, &t, &obstacles, REACH_M).rows.to_vec();
        let (origin, slope) = linearize(&arm, &next, &map, &rows);
        let answer = json!({
            "a": quadratic.a, "b": quadratic.b, "c": quadratic.c, "origin": origin, "slope": slope,
            "centre": rows.iter().map(|row| case.obstacles[row.obstacle]).collect::<Vec<_>>(),
            "radius": RADIUS_M, "penalty": PENALTY, "low": config.tension_n_min, "high": config.tension_n_max,
            "u_previous": case.u_previous,
        });
        self.loaded = Some(Loaded { case, quadratic, rows, origin, slope, obstacles });
        answer
    }

    /// Searches `repeats` times with `sweeps` sweeps, from `seed` and the numbers behind it.
    pub fn search(&mut self, request: &Value) -> Value {
        let p = self.loaded.as_ref().expect("a problem first");
        let config = SwarmConfig { sweeps_max: count(request, "sweeps"), ..safe::settings(0.1, PENALTY).swarm };
        let n = p.quadratic.b.len();
        let (zeros, radii) = (vec![0.0; p.rows.len()], vec![RADIUS_M; p.rows.len()]);
        let pairs = Pairs {
            rows: &p.rows,
            required: &zeros,
            length: &radii,
            clearance: 0.0,
            origin: &p.origin,
            slope: &p.slope,
            obstacles: &p.obstacles,
        };
        let arm = ArmConfig::paper();
        let (low, high) = (vec![arm.tension_n_min; n], vec![arm.tension_n_max; n]);
        let variant = if request["variant"] == "standard" { Variant::Standard } else { Variant::Improved };
        let mut swarm = Swarm::new(n, &config, 1);
        let (mut seconds, mut evaluations, mut costs) = (Vec::new(), Vec::new(), Vec::new());
        let first = request["seed"].as_u64().unwrap_or(0);
        for seed in first..first + count(request, "repeats") as u64 {
            let mut rng = Xoshiro256PlusPlus::seed_from_u64(seed);
            let begin = cpu_seconds();
            let seeds: [&[f64]; 1] = [&p.case.u_previous];
            let found =
                swarm.search(variant, &config, &p.quadratic, &pairs, &low, &high, &seeds, &[], &mut rng, &mut || false);
            seconds.push(cpu_seconds() - begin);
            evaluations.push(found.evaluations);
            costs.push(found.cost);
        }
        json!({ "seconds": seconds, "evaluations": evaluations, "costs": costs, "answer": swarm.answer() })
    }
}

/// Positions of the body points as affine functions of the tensions: at zero tension, and per newton.
fn linearize(arm: &Arm, state: &State, map: &AffineMap, rows: &[Proximity]) -> (Vec<f64>, Vec<f64>) {
    let nc = map.cables;
    let (mut origin, mut slope) = (vec![0.0; 3 * rows.len()], vec![0.0; 3 * rows.len() * nc]);
    for (k, row) in rows.iter().enumerate() {
        origin[3 * k..3 * k + 3].copy_from_slice(row.position.as_slice());
        let i = row.point.element;
        let [w0, w1, w2, w3] = row.point.weights;
        for (node, wr, wt) in [(i, w0, w1), (i + 1, w2, w3)] {
            if node == 0 {
                continue;
            }
            let tangent: Matrix3x4<f64> = rotation_jacobians(&arm.pose(&state.q, node).1)[0];
            let at = COORDINATES * (node - 1);
            for c in 0..3 {
                let factors = [(wr, at + c)].into_iter().chain((0..4).map(|p| (wt * tangent[(c, p)], at + 3 + p)));
                for (f, r) in factors {
                    origin[3 * k + c] += f * map.x0[r];
                    for (j, x) in map.row(r).iter().enumerate() {
                        slope[(3 * k + c) * nc + j] += f * x;
                    }
                }
            }
        }
    }
    (origin, slope)
}
