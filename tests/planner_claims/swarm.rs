//! The swarm by itself: never worse than a seed, costs what it says, strict where told.

use super::*;
use sinew::collision::penalty;
use sinew::planner::swarm::{Pairs, Swarm, Variant};

/// The swarm's own problem at the start of a step: quadratic, pairs and bounds, made outside the planner.
struct SwarmCase {
    quadratic: Quadratic,
    rows: Vec<sinew::collision::Proximity>,
    required: Vec<f64>,
    length: Vec<f64>,
    origin: Vec<f64>,
    slope: Vec<f64>,
    balls: ObstacleSet,
}

impl SwarmCase {
    fn new(bench: &Bench, config: &PlannerConfig) -> Self {
        let balls = bench.balls(0.028);
        let goal = bench.goal(toward(bench, &balls) * 0.05);
        let rates = Scheme::new(bench.config.rho_inf).rates(0.1);
        let (mut stepper, mut map) = (Stepper::new(&bench.arm), AffineMap::new(&bench.arm));
        stepper.linearize(&bench.arm, &Motion::from(&bench.state), &bench.u, rates).unwrap();
        stepper.affine_map_into(&bench.arm, &mut map);
        let mut quadratic = Quadratic::new(&bench.arm);
        quadratic.build(&bench.arm, &bench.state, rates, &map, &goal, 1.0, &[1e4; 24], &bench.u);
        let n = bench.arm.node_count();
        let (mut r, mut t) = (vec![Vector3::zeros(); n + 1], vec![Vector3::zeros(); n + 1]);
        bench.arm.frames_into(&bench.state.q, &mut r, &mut t);
        let geometry = sinew::collision::BodyGeometry::from_arm(&bench.config);
        let mut body = sinew::collision::Body::new(&geometry, config.body, config.body_radius_m);
        let rows = body.find(&r, &t, &balls, 0.05).rows.to_vec();
        assert!(rows.len() >= 2);
        // Body points that follow their nodes' positions.
        let (mut origin, mut slope) = (Vec::new(), Vec::new());
        for row in &rows {
            let at = 7 * row.point.element.max(1) - 7;
            for c in 0..3 {
                origin.push(row.position[c] + map.x0[at + c]);
                slope.extend_from_slice(map.row(at + c));
            }
        }
        let required = vec![config.clearance_m; rows.len()];
        let length = vec![0.1; rows.len()];
        Self { quadratic, rows, required, length, origin, slope, balls }
    }

    fn pairs(&self, clearance: f64) -> Pairs<'_> {
        Pairs {
            rows: &self.rows,
            required: &self.required,
            length: &self.length,
            clearance,
            origin: &self.origin,
            slope: &self.slope,
            obstacles: &self.balls,
        }
    }

    /// (28), particle by particle.
    fn cost(&self, clearance: f64, nu: f64, u: &[f64]) -> f64 {
        let n = u.len();
        let mut cost = self.quadratic.cost(u);
        for (r, row) in self.rows.iter().enumerate() {
            let at = Vector3::from_fn(|c, _| {
                let slope = &self.slope[(3 * r + c) * n..(3 * r + c + 1) * n];
                self.origin[3 * r + c] + slope.iter().zip(u).map(|(s, u)| s * u).sum::<f64>()
            });
            let d = self.balls.moved_distance(row, &at);
            if d < self.required[r] {
                cost += nu * penalty(d - self.required[r] + clearance, clearance, self.length[r]).0;
            }
        }
        cost
    }
}

#[test]
fn the_swarms_answer_is_never_worse_than_any_seed_and_costs_what_it_says() {
    let bench = Bench::paper();
    let config = settings(WarningBranch::Swarm);
    let case = SwarmCase::new(&bench, &config);
    let (lower, upper) = (vec![0.0; 24], vec![220.0; 24]);
    let mut swarm = Swarm::new(24, &config.swarm, 3);
    let mut beaten = 0;
    for seed in 0..40 {
        let mut rng = Xoshiro256PlusPlus::seed_from_u64(seed);
        let other: Vec<f64> = random_vector(&mut rng, 24, 30.0).iter().map(|u| u.abs()).collect();
        let third: Vec<f64> = bench.u.iter().map(|u| 0.9 * u).collect();
        let seeds: [&[f64]; 3] = [&bench.u, &other, &third];
        for variant in [Variant::Improved, Variant::Standard] {
            // From no time at all to many sweeps.
            for sweeps in [1usize, 2, 10] {
                let mut left = sweeps;
                let report = swarm.search(
                    variant,
                    &config.swarm,
                    &case.quadratic,
                    &case.pairs(config.clearance_m),
                    &lower,
                    &upper,
                    &seeds,
                    &[],
                    &mut rng,
                    &mut || {
                        left -= 1;
                        left == 0
                    },
                );
                assert_eq!(report.sweeps, sweeps);
                let own = case.cost(config.clearance_m, config.swarm.penalty, swarm.answer());
                assert!((own / report.cost - 1.0).abs() < 1e-9, "{own} {report:?}");
                for s in seeds {
                    let cost = case.cost(config.clearance_m, config.swarm.penalty, s);
                    assert!(report.cost <= cost * (1.0 + 1e-12), "{variant:?} seed {seed}: {report:?} for {cost}");
                }
                assert!(swarm.answer().iter().all(|u| (0.0..=220.0).contains(u)));
                beaten += usize::from(report.seed.is_none());
            }
        }
    }
    assert!(beaten > 20, "the swarm finds better than its seeds: {beaten}");
}

#[test]
fn a_swarm_that_must_be_strict_never_undercuts_a_seed_that_keeps_its_distance() {
    let bench = Bench::paper();
    let config = settings(WarningBranch::Seeded);
    let case = SwarmCase::new(&bench, &config);
    let soft = SwarmConfig { penalty: 0.0, ..config.swarm };
    let mut swarm = Swarm::new(24, &config.swarm, 3);
    let violation = |u: &[f64]| {
        (0..case.rows.len()).fold(0.0f64, |worst, r| {
            let at = Vector3::from_fn(|c, _| {
                let slope = &case.slope[(3 * r + c) * 24..(3 * r + c + 1) * 24];
                case.origin[3 * r + c] + slope.iter().zip(u).map(|(s, u)| s * u).sum::<f64>()
            });
            worst.max(case.required[r] - case.balls.moved_distance(&case.rows[r], &at))
        })
    };
    let mut tempted = 0;
    for seed in 0..20 {
        for strict in [&[][..], &vec![1e-9; case.rows.len()]] {
            let mut rng = Xoshiro256PlusPlus::seed_from_u64(seed);
            // Without a penalty only strictness keeps the distance.
            swarm.search(
                Variant::Improved,
                &soft,
                &case.quadratic,
                &case.pairs(config.clearance_m),
                &[0.0; 24],
                &[220.0; 24],
                &[&bench.u, &bench.u],
                strict,
                &mut rng,
                &mut || false,
            );
            let worst = violation(swarm.answer());
            match strict.first() {
                None => tempted += usize::from(worst > 1e-6),
                Some(limit) => assert!(worst <= limit + 1e-12, "seed {seed}: {worst}"),
            }
        }
    }
    assert!(tempted > 0, "the soft optimum lies inside an obstacle");
}
