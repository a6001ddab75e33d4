//! Claims about the complementarity solver.

use super::*;
use rand::{RngExt, SeedableRng};
use rand_xoshiro::Xoshiro256PlusPlus;

struct Case {
    a: Vec<f64>,
    b: Vec<f64>,
    lower: Vec<f64>,
    upper: Vec<f64>,
    c: Vec<f64>,
    d: Vec<f64>,
    /// Of every row, where the longest is not the measure of all.
    price: Vec<f64>,
}

impl Case {
    /// The price of every row is that of [`exact_price`], by the longest of them.
    fn priced(mut self) -> Self {
        let price = exact_price(&self.a, &self.b, self.c.chunks_exact(self.b.len()));
        self.price = vec![price; self.d.len()];
        self
    }

    fn problem(&self) -> Problem<'_> {
        let Self { a, b, lower, upper, c, d, price } = self;
        Problem { a, b, lower, upper, c, d, price }
    }
}

/// Random strictly convex problems with weights spread over 12 decades; feasible rows unless told.
fn random(n: usize, rows: usize, seed: u64) -> Case {
    let mut rng = Xoshiro256PlusPlus::seed_from_u64(seed);
    let root: Vec<f64> = (0..n * n).map(|_| rng.random_range(-1.0..1.0)).collect();
    let weight: Vec<f64> = (0..n).map(|_| 10f64.powf(rng.random_range(4.0..7.0))).collect();
    let mut a = vec![0.0; n * n];
    for i in 0..n {
        for j in 0..n {
            a[i * n + j] = (0..n).map(|k| root[k * n + i] * root[k * n + j] * weight[k]).sum();
        }
        a[i * n + i] += 1e4;
    }
    let inside: Vec<f64> = (0..n).map(|_| rng.random_range(0.0..220.0)).collect();
    let wanted: Vec<f64> = (0..n).map(|_| rng.random_range(-100.0..320.0)).collect();
    let b = (0..n).map(|i| -(0..n).map(|j| a[i * n + j] * wanted[j]).sum::<f64>()).collect();
    let c: Vec<f64> = (0..rows * n).map(|_| rng.random_range(-1e-3..1e-3)).collect();
    let d = (0..rows)
        .map(|r| rng.random_range(0.0..0.01) - (0..n).map(|j| c[r * n + j] * inside[j]).sum::<f64>())
        .collect();
    Case { a, b, lower: vec![0.0; n], upper: vec![220.0; n], c, d, price: Vec::new() }.priced()
}

fn kkt(case: &Case, u: &[f64], mu: &[f64]) -> f64 {
    let n = u.len();
    let mut worst = 0.0f64;
    for i in 0..n {
        let mut g = case.b[i] + (0..n).map(|j| case.a[i * n + j] * u[j]).sum::<f64>();
        g -= (0..mu.len()).map(|r| case.c[r * n + i] * mu[r]).sum::<f64>();
        let g = g / case.a[i * n + i];
        worst = worst.max((u[i] - (u[i] - g).clamp(case.lower[i], case.upper[i])).abs());
    }
    // Multipliers are costs per metre, up to 1e9 here: compare them by their share of the largest.
    let largest = mu.iter().fold(1.0f64, |a, m| a.max(*m));
    for (r, m) in mu.iter().map(|m| m / largest).enumerate() {
        let s = case.d[r] + (0..n).map(|j| case.c[r * n + j] * u[j]).sum::<f64>();
        assert!(s > -1e-7 && m >= 0.0 && s.min(m).abs() < 1e-7, "row {r}: {s} {m}");
    }
    worst
}

#[test]
fn complementarity_holds_at_the_solution_of_random_box_problems() {
    let mut most = 0;
    for seed in 0..200 {
        let case = random(24, 0, seed);
        let mut solver = Solver::new(24, 0);
        let mut u = vec![0.0; 24];
        let report = solver.solve(&case.problem(), &mut u, &mut || false);
        assert_eq!(report.status, Status::Optimal, "seed {seed} {report:?}");
        assert!(kkt(&case, &u, &[]) < 1e-8, "seed {seed} {report:?} {}", kkt(&case, &u, &[]));
        most = most.max(report.iterations);
    }
    assert!(most <= 60, "{most} iterations");
}

#[test]
fn complementarity_holds_with_rows_and_with_duplicated_rows() {
    for seed in 0..200 {
        let mut case = random(24, 12, seed);
        for copy in 0..4 {
            let row = case.c[copy * 24..(copy + 1) * 24].to_vec();
            case.c.extend(row);
            case.d.push(case.d[copy]);
        }
        let case = case.priced();
        let mut solver = Solver::new(24, 16);
        let mut u = vec![110.0; 24];
        let report = solver.solve(&case.problem(), &mut u, &mut || false);
        assert_eq!(report.status, Status::Optimal, "seed {seed} {report:?}");
        assert!(kkt(&case, &u, solver.multipliers()) < 1e-6, "seed {seed} {report:?}");
    }
}

#[test]
fn conflicting_rows_are_relaxed_and_the_status_says_so() {
    let mut case = random(6, 0, 3);
    // u_0 >= 100 and u_0 <= 50 together.
    case.c = [vec![1.0, 0.0, 0.0, 0.0, 0.0, 0.0], vec![-1.0, 0.0, 0.0, 0.0, 0.0, 0.0]].concat();
    case.d = vec![-100.0, 50.0];
    let case = case.priced();
    let mut u = vec![0.0; 6];
    let report = Solver::new(6, 2).solve(&case.problem(), &mut u, &mut || false);
    assert_eq!(report.status, Status::Relaxed, "{report:?}");
    assert!(u[0] > 49.9 && u[0] < 100.1, "{u:?}");
    assert!(u.iter().all(|v| (0.0..=220.0).contains(v)));
}

#[test]
fn a_problem_that_is_not_finite_is_not_optimal_and_its_answer_stays_in_the_box() {
    for entry in [f64::NAN, f64::INFINITY] {
        let mut case = random(6, 0, 3);
        case.b[2] = entry;
        let mut u = vec![10.0; 6];
        let report = Solver::new(6, 0).solve(&case.problem(), &mut u, &mut || false);
        assert_eq!(report.status, Status::IterationLimit, "{entry}: {report:?}");
        assert!(u.iter().all(|v| (0.0..=220.0).contains(v)), "{entry}: {u:?}");
    }
}

/// Many rows of which a random start violates most, and rows that contradict each other.
fn hard(seed: u64) -> Case {
    let n = 24;
    let mut case = random(n, 60, seed);
    if seed % 2 == 1 {
        for row in 0..20 {
            let opposite: Vec<f64> = case.c[row * n..(row + 1) * n].iter().map(|c| -c).collect();
            case.c.extend(opposite);
            case.d.push(-case.d[row] - 0.01);
        }
    }
    case.priced()
}

#[test]
fn a_solve_that_is_stopped_anywhere_is_bounded_and_no_worse_than_its_start() {
    let (mut stopped, mut gained) = (0, 0);
    for seed in 0..12 {
        let case = hard(seed);
        let problem = case.problem();
        let mut rng = Xoshiro256PlusPlus::seed_from_u64(seed);
        let start: Vec<f64> = (0..24).map(|_| rng.random_range(0.0..220.0)).collect();
        let guess = if seed % 3 == 0 { vec![1e6; case.d.len()] } else { Vec::new() };
        let mut solver = Solver::new(24, 80);
        let (mut least, mut last) = (f64::INFINITY, f64::INFINITY);
        for k in (0..12).chain([20, 30, 50, 80, 120, 200, usize::MAX]) {
            let (mut asked, mut late) = (0, 0);
            let mut u = start.clone();
            let report = solver.solve_warm(&problem, &guess, &mut u, &mut || {
                late += usize::from(asked > k);
                asked += 1;
                asked > k
            });
            let (before, after) = (penalized(&problem, &start), penalized(&problem, &u));
            assert!(after <= before * (1.0 + 1e-12 * before.signum()), "seed {seed} k {k}: {after} from {before}");
            assert!(u.iter().all(|v| (0.0..=220.0).contains(v)), "seed {seed} k {k}: {u:?}");
            assert_eq!(late, 0, "seed {seed} k {k}: asked after the end");
            // The iteration after which it was said is the last.
            assert_eq!(report.iterations, asked, "seed {seed} k {k}: {report:?}");
            assert!(report.iterations <= k.saturating_add(1), "seed {seed} k {k}: {report:?}");
            if !report.status.is_optimal() && asked > k {
                assert_eq!(report.status, Status::Stopped);
                stopped += 1;
                gained += usize::from(after < before);
            }
            least = least.min(after);
            last = after;
        }
        // No stopped answer is better than the solved one.
        assert!(last <= least + 1e-6 * least.abs(), "seed {seed}: {last}, {least} on the way");
    }
    assert!(stopped > 60 && gained > 30, "{stopped} stops, {gained} of them with a better answer");
}

#[test]
fn a_warm_start_at_the_answer_needs_no_iteration() {
    let case = random(24, 0, 9);
    let mut solver = Solver::new(24, 0);
    let mut u = vec![0.0; 24];
    solver.solve(&case.problem(), &mut u, &mut || false);
    let again = solver.solve(&case.problem(), &mut u.clone(), &mut || false);
    assert!(again.iterations <= 1, "{again:?}");
}

/// The next problem of a chain: the same rows, a little farther on.
fn drifted(case: &Case, seed: u64) -> Case {
    let mut rng = Xoshiro256PlusPlus::seed_from_u64(seed);
    let mut near = |v: &[f64], by: f64| v.iter().map(|x| x * (1.0 + by * rng.random_range(-1.0..1.0))).collect();
    Case {
        a: case.a.clone(),
        b: near(&case.b, 1e-3),
        lower: case.lower.clone(),
        upper: case.upper.clone(),
        c: near(&case.c, 1e-3),
        d: near(&case.d, 1e-3),
        price: Vec::new(),
    }
    .priced()
}

fn far(a: &[f64], b: &[f64]) -> f64 {
    a.iter().zip(b).fold(0.0, |worst, (a, b)| worst.max((a - b).abs()))
}

#[test]
fn a_guess_from_the_problem_before_gives_the_same_answer_in_half_the_iterations() {
    let (mut cold, mut warm, mut bound) = (0, 0, 0);
    for seed in 0..60 {
        let (before, mut solver) = (random(24, 24, seed), Solver::new(24, 24));
        let mut start = vec![110.0; 24];
        assert_eq!(solver.solve(&before.problem(), &mut start, &mut || false).status, Status::Optimal);
        let guess = solver.multipliers().to_vec();
        bound += guess.iter().filter(|mu| **mu > 0.0).count();
        let now = drifted(&before, seed);
        let (mut u, mut v) = (start.clone(), start);
        let plain = solver.solve(&now.problem(), &mut u, &mut || false);
        let told = solver.solve_warm(&now.problem(), &guess, &mut v, &mut || false);
        // Where the rows have no common solution any more both say so, and the answer is not unique.
        assert_eq!(told.status, plain.status, "seed {seed}");
        if plain.status == Status::Optimal {
            assert!(far(&u, &v) < 1e-6, "seed {seed}: {:e} N apart", far(&u, &v));
            assert!(kkt(&now, &v, solver.multipliers()) < 1e-6, "seed {seed} {told:?}");
            (cold, warm) = (cold + plain.iterations, warm + told.iterations);
        }
    }
    assert!(bound > 60, "{bound} rows held an answer back");
    assert!(2 * warm <= cold, "{warm} iterations with a guess, {cold} without");
}

#[test]
fn a_bad_guess_changes_no_answer() {
    for seed in 0..60 {
        let (case, mut solver) = (random(24, 24, seed), Solver::new(24, 24));
        let mut rng = Xoshiro256PlusPlus::seed_from_u64(seed);
        let start: Vec<f64> = (0..24).map(|_| rng.random_range(0.0..220.0)).collect();
        let mut u = start.clone();
        let plain = solver.solve(&case.problem(), &mut u, &mut || false);
        let size = 10f64.powf(rng.random_range(0.0..18.0));
        let guess: Vec<f64> =
            (0..24).map(|k| if k == 7 { f64::NAN } else { size * rng.random_range(-1.0..1.0) }).collect();
        let mut v = start;
        let told = solver.solve_warm(&case.problem(), &guess, &mut v, &mut || false);
        assert_eq!((plain.status, told.status), (Status::Optimal, Status::Optimal), "seed {seed}: {told:?}");
        assert!(far(&u, &v) < 1e-5, "seed {seed}: {:e} N apart, {told:?}", far(&u, &v));
    }
}

/// Metres that are missing of each row.
fn missing(case: &Case, u: &[f64]) -> Vec<f64> {
    let n = u.len();
    let value = |r: usize| case.d[r] + (0..n).map(|j| case.c[r * n + j] * u[j]).sum::<f64>();
    (0..case.d.len()).map(|r| (-value(r)).max(0.0)).collect()
}

#[test]
fn rows_that_hardly_move_never_sell_one_that_can_be_kept() {
    for seed in 0..40 {
        for hopeless in 1..4 {
            let mut rng = Xoshiro256PlusPlus::seed_from_u64(seed);
            let mut case = random(24, 0, seed);
            // Standing still is best, with a millimetre of room to something that moves by a millimetre per newton.
            let still = vec![20.0; 24];
            case.b = (0..24).map(|i| -(0..24).map(|j| case.a[i * 24 + j] * still[j]).sum::<f64>()).collect();
            let way: Vec<f64> = (0..24).map(|_| rng.random_range(-1.0..1.0)).collect();
            let at = |row: &[f64]| row.iter().map(|c| 20.0 * c).sum::<f64>();
            case.c = way.iter().map(|w| 1e-3 * w).collect();
            case.d = vec![1e-3 - at(&case.c)];
            // Beside it what lacks 3 mm and moves by 0.1 um per newton, about the other way.
            for _ in 0..hopeless {
                let row: Vec<f64> = way.iter().map(|w| -1e-7 * (w + rng.random_range(-0.3..0.3))).collect();
                case.d.push(-3e-3 - at(&row));
                case.c.extend(row);
            }
            let case = case.priced();
            let mut u = still.clone();
            let report = Solver::new(24, 4).solve(&case.problem(), &mut u, &mut || false);
            assert_eq!(report.status, Status::Relaxed, "seed {seed}, {hopeless}: {report:?}");
            let missing = missing(&case, &u);
            assert!(missing[0] < 1e-8, "seed {seed}, {hopeless}: {missing:?}");
        }
    }
}

#[test]
fn of_rows_that_conflict_as_few_metres_as_can_be_are_missing() {
    // u_0 >= 100 and u_0 <= 50 together, one of which moves a hundred times farther per newton.
    for (far, near, want) in [(1e-3, 1e-5, 100.0), (1e-5, 1e-3, 50.0)] {
        let mut case = random(6, 0, 3);
        case.c = [vec![far, 0.0, 0.0, 0.0, 0.0, 0.0], vec![-near, 0.0, 0.0, 0.0, 0.0, 0.0]].concat();
        case.d = vec![-100.0 * far, 50.0 * near];
        let case = case.priced();
        let mut u = vec![10.0; 6];
        let report = Solver::new(6, 2).solve(&case.problem(), &mut u, &mut || false);
        assert_eq!(report.status, Status::Relaxed, "{report:?}");
        assert!((u[0] - want).abs() < 1e-3, "{u:?} for {want}");
        // A cheap row gives way instead, however far it moves.
        let price =
            if far > near { [case.price[0] * 1e-4, case.price[1]] } else { [case.price[0], case.price[1] * 1e-4] };
        let told = Problem { price: &price, ..case.problem() };
        Solver::new(6, 2).solve(&told, &mut u, &mut || false);
        assert!((u[0] - (150.0 - want)).abs() < 1e-3, "{u:?} for {}", 150.0 - want);
    }
}

/// Twelve rows with a common solution, three more that contradict three of them.
fn conflicting(seed: u64) -> Case {
    let mut case = random(24, 12, seed);
    for row in 0..3 {
        let opposite: Vec<f64> = case.c[row * 24..(row + 1) * 24].iter().map(|c| -c).collect();
        case.c.extend(opposite);
        case.d.push(-case.d[row] - 0.01);
    }
    case.priced()
}

#[test]
fn rounding_of_large_multipliers_keeps_no_conflict_from_its_end() {
    let (mut most, mut all) = (0, 0);
    for seed in 0..60 {
        let case = conflicting(seed);
        let mut u = vec![110.0; 24];
        let report = Solver::new(24, 15).solve(&case.problem(), &mut u, &mut || false);
        assert_eq!(report.status, Status::Relaxed, "seed {seed}: {report:?}");
        assert!(report.kkt_residual < 1e-9, "seed {seed}: {report:?}");
        // Each of the pairs lacks its centimetre at least.
        assert!(missing(&case, &u).iter().sum::<f64>() > 0.03 - 1e-6, "seed {seed}");
        (most, all) = (most.max(report.iterations), all + report.iterations);
    }
    // 93 to 267 each, 187 in the middle, while rounding counted as a residual.
    assert!(most <= 160 && all <= 60 * 100, "{most} iterations at most, {all} in all");
}

#[test]
fn more_violated_rows_than_can_work_are_no_optimum_and_the_answer_is_no_worse_than_the_start() {
    for seed in 0..10 {
        let mut rng = Xoshiro256PlusPlus::seed_from_u64(seed);
        let mut case = random(24, 60, seed);
        // No tensions of the box satisfy any of them.
        for row in 0..60 {
            let most: f64 = case.c[row * 24..(row + 1) * 24].iter().map(|c| 220.0 * c.max(0.0)).sum();
            case.d[row] = -most - 0.01;
        }
        let case = case.priced();
        let start: Vec<f64> = (0..24).map(|_| rng.random_range(0.0..220.0)).collect();
        let mut u = start.clone();
        let report = Solver::new(24, 60).solve(&case.problem(), &mut u, &mut || false);
        assert_eq!((report.status, report.rows), (Status::Overfull, Solver::WORKING_MAX), "seed {seed}: {report:?}");
        assert!(!report.status.is_optimal());
        let (before, after) = (penalized(&case.problem(), &start), penalized(&case.problem(), &u));
        assert!(after <= before, "seed {seed}: {after} from {before}");
    }
}
