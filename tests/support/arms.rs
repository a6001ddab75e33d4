//! Arms that closed forms speak of, random arms and states, and dense copies of what the model keeps in blocks.

use nalgebra::{DMatrix, DVector, Vector3, Vector4};
use rand::RngExt;
use rand_xoshiro::Xoshiro256PlusPlus;
use sinew::config::{ArmConfig, ChordRule, PayloadConfig, Profile, Route, Routing, StrainRule, Taper};
use sinew::integrator::Stepper;
use sinew::math::block_tridiagonal::{BLOCK, BlockTridiagonal};
use sinew::model::{Arm, Motion, Rates, State};

/// Length of [`beam`] (m).
pub const LENGTH: f64 = 0.65;
/// Bending stiffness of [`beam`] (N m^2).
pub const EI: f64 = 7.0;
/// Backbone mass of [`beam`] (kg/m).
pub const DENSITY: f64 = 0.15;
/// Hole radius of [`beam`] (m).
pub const HOLE: f64 = 0.05;
/// Both chord rules with both strain rules.
pub const RULES: [(ChordRule, StrainRule); 4] = [
    (ChordRule::Simpson, StrainRule::VectorPart),
    (ChordRule::Simpson, StrainRule::Logarithm),
    (ChordRule::Trapezoid, StrainRule::VectorPart),
    (ChordRule::Trapezoid, StrainRule::Logarithm),
];

/// One undamped segment along x with massless disks and four cables towards y, z, -y, -z.
pub fn beam(elements: usize) -> ArmConfig {
    let mut config = ArmConfig::paper();
    config.segments.truncate(1);
    let s = &mut config.segments[0];
    s.length_m = LENGTH;
    s.elements = elements;
    s.bending_stiffness_nm2 = EI;
    s.torsional_stiffness_nm2 = EI / 1.3;
    s.damping_stiffness_s = 0.0;
    s.disk_mass_kg = 0.0;
    s.backbone_mass_kgpm = DENSITY;
    // Thin: the section's own rotary inertia is not in the beam formulas.
    s.backbone_radius_m = 4e-4;
    s.connector_length_m = 0.0;
    s.connector_mass_kg = 0.0;
    s.hole_radius_m = HOLE;
    s.hole_angles_rad = [0.0f64, 90.0, 180.0, 270.0].map(f64::to_radians).to_vec();
    config.base_position_m = [0.0; 3];
    config.base_quaternion = [1.0, 0.0, 0.0, 0.0];
    config.gravity_mps2 = [0.0; 3];
    config.damping_mass_1ps = 0.0;
    config.payload = PayloadConfig::default();
    config
}

/// An arm of random make: 1 to 4 segments, unequal in everything, 3 to 12 cables each, gravity, payload, damping.
pub fn random_arm(rng: &mut Xoshiro256PlusPlus, routing: Routing, chord: ChordRule, strain: StrainRule) -> ArmConfig {
    let mut config = ArmConfig::paper();
    let template = config.segments[0].clone();
    let count = rng.random_range(1..=4);
    config.segments = (0..count)
        .map(|_| {
            let mut s = template.clone();
            let mut f = |a: f64, b: f64| rng.random_range(a..b);
            s.length_m = f(0.2, 0.9);
            s.bending_stiffness_nm2 = f(2.0, 12.0);
            s.torsional_stiffness_nm2 = f(2.0, 12.0);
            s.damping_stiffness_s = f(0.0, 0.1);
            s.disk_mass_kg = f(0.05, 0.5);
            s.disk_thickness_m = f(0.005, 0.02);
            s.connector_length_m = f(0.0, 0.1);
            s.connector_mass_kg = f(0.0, 0.2);
            s.hole_radius_m = f(0.02, 0.06);
            s.elements = rng.random_range(1..=6);
            s.hole_angles_rad =
                (0..rng.random_range(3..=12)).map(|_| rng.random_range(0.0..std::f64::consts::TAU)).collect();
            s
        })
        .collect();
    config.routing = routing;
    config.chord = chord;
    config.strain = strain;
    config.gravity_mps2 = [1.0, -3.0, -9.0];
    config.damping_mass_1ps = 0.7;
    config.payload.mass_kg = 0.4;
    config.base_position_m = [0.3, -0.2, 0.5];
    config.base_quaternion = Vector4::new(0.4, -0.5, 0.7, 0.2).normalize().into();
    config
}

/// Lets everything change along an arm: tapered segments, converging and helical cables, some that end on the way, start
/// behind the base or run through more segments than their own.
pub fn vary(rng: &mut Xoshiro256PlusPlus, config: &mut ArmConfig) {
    let mut profile = |from: f64, to: f64, low: f64, high: f64| {
        let places = [0.0, 0.3, 0.3, 1.0];
        Profile(places.map(|x| [from + (to - from) * x, rng.random_range(low..high)]).to_vec())
    };
    for (s, segment) in config.segments.iter_mut().enumerate() {
        let own = |profile: &mut dyn FnMut(f64, f64, f64, f64) -> Profile| profile(0.0, 1.0, 0.5, 2.0);
        segment.taper = Taper {
            bending: own(&mut profile),
            torsion: own(&mut profile),
            backbone_mass: own(&mut profile),
            backbone_radius: own(&mut profile),
            disk_mass: own(&mut profile),
            disk_radius: own(&mut profile),
        };
        segment.route =
            Route { radius: profile(0.0, s as f64 + 1.0, 0.4, 1.6), turn: profile(0.0, s as f64 + 1.0, -2.0, 2.0) };
    }
    for (s, segment) in config.segments.iter_mut().enumerate() {
        segment.cables_from = rng.random::<bool>().then(|| rng.random_range(0..=s));
        let n = segment.elements;
        segment.cable_ends =
            segment.hole_angles_rad.iter().map(|_| rng.random_range(1..=n) as f64 / n as f64).collect();
    }
}

/// `count` numbers in -span..span.
pub fn random_vector(rng: &mut Xoshiro256PlusPlus, count: usize, span: f64) -> Vec<f64> {
    (0..count).map(|_| rng.random_range(-span..span)).collect()
}

/// A state near a bent arm, off the constraints, with random rates, accelerations and multipliers; some quaternions
/// have the other sign.
pub fn random_state(rng: &mut Xoshiro256PlusPlus, arm: &Arm) -> State {
    let n = arm.node_count();
    let mut q = arm.bent(&random_vector(rng, 2 * arm.segment_count(), 2.0));
    for (v, d) in q.iter_mut().zip(random_vector(rng, 7 * n, 0.02)) {
        *v += d;
    }
    for node in q.chunks_exact_mut(7) {
        if rng.random::<bool>() {
            node[3..].iter_mut().for_each(|p| *p = -*p);
        }
    }
    State {
        q,
        qd: random_vector(rng, 7 * n, 0.5),
        qdd: random_vector(rng, 7 * n, 2.0),
        a: vec![0.0; 7 * n],
        lambda: random_vector(rng, 4 * n, 20.0),
    }
}

/// The block matrix as a dense one, 11 N x 11 N.
pub fn dense(blocks: &BlockTridiagonal) -> DMatrix<f64> {
    let n = blocks.len();
    let mut m = DMatrix::zeros(BLOCK * n, BLOCK * n);
    for i in 0..n {
        m.view_mut((BLOCK * i, BLOCK * i), (BLOCK, BLOCK)).copy_from(&block(&blocks.diagonal[i]));
        if i > 0 {
            m.view_mut((BLOCK * i, BLOCK * (i - 1)), (BLOCK, BLOCK)).copy_from(&block(&blocks.lower[i]));
            m.view_mut((BLOCK * (i - 1), BLOCK * i), (BLOCK, BLOCK)).copy_from(&block(&blocks.upper[i - 1]));
        }
    }
    m
}

/// Rows (or columns) of the coordinates in the order of the unknowns.
pub fn coordinate_rows(nodes: usize) -> Vec<usize> {
    (0..nodes).flat_map(|i| (0..7).map(move |c| BLOCK * i + c)).collect()
}

/// Rows of the constraints in the order of the unknowns.
pub fn constraint_rows(nodes: usize) -> Vec<usize> {
    (0..nodes).flat_map(|i| (7..BLOCK).map(move |c| BLOCK * i + c)).collect()
}

/// Orthonormal basis (columns) of the motions that the constraints allow, from the dense tangent.
pub fn allowed_motions(tangent: &DMatrix<f64>, nodes: usize) -> DMatrix<f64> {
    let (q, c) = (coordinate_rows(nodes), constraint_rows(nodes));
    let jacobian = tangent.select_rows(&c).select_columns(&q);
    // The null space is spanned by the eigenvectors of J^T J with zero eigenvalue: three per element.
    let eigen = (jacobian.transpose() * &jacobian).symmetric_eigen();
    let mut order: Vec<usize> = (0..7 * nodes).collect();
    order.sort_by(|&a, &b| eigen.eigenvalues[a].total_cmp(&eigen.eigenvalues[b]));
    assert!(eigen.eigenvalues[order[3 * nodes]] > 1e6 * eigen.eigenvalues[order[3 * nodes - 1]].abs());
    eigen.eigenvectors.select_columns(&order[..3 * nodes])
}

/// Angular frequencies (rad/s, ascending) of small vibrations about an equilibrium under `u`, and their shapes (7N).
pub fn frequencies(arm: &Arm, state: &State, u: &[f64]) -> (Vec<f64>, DMatrix<f64>) {
    let n = arm.node_count();
    let mut stepper = Stepper::new(arm);
    stepper.linearize(arm, &Motion::from(state), u, Rates::STATIC).unwrap();
    let tangent = dense(&stepper.linearization.tangent);
    let z = allowed_motions(&tangent, n);
    let rows = coordinate_rows(n);
    let stiffness = z.transpose() * tangent.select_rows(&rows).select_columns(&rows) * &z;
    let mut blocks = BlockTridiagonal::zeros(n);
    arm.mass_into(&state.q, 1.0, &mut blocks);
    let mass = z.transpose() * dense(&blocks).select_rows(&rows).select_columns(&rows) * &z;
    // K x = omega^2 M x with M = L L^T.
    let l = mass.cholesky().expect("the mass is positive on allowed motions").l();
    let inverse = l.try_inverse().unwrap();
    let eigen = (&inverse * stiffness * inverse.transpose()).symmetric_eigen();
    let mut order: Vec<usize> = (0..eigen.eigenvalues.len()).collect();
    order.sort_by(|&a, &b| eigen.eigenvalues[a].total_cmp(&eigen.eigenvalues[b]));
    let shapes = z * inverse.transpose() * eigen.eigenvectors.select_columns(&order);
    (order.iter().map(|&k| eigen.eigenvalues[k].max(0.0).sqrt()).collect(), shapes)
}

/// Kinetic, elastic, gravity's and cables' energy together (J); constant tensions have the potential `u . lengths`.
pub fn total_energy(arm: &Arm, state: &State, u: &[f64]) -> f64 {
    let mut lengths = vec![0.0; arm.cable_count()];
    arm.cable_lengths_into(&state.q, &mut lengths);
    arm.kinetic_energy(&state.q, &state.qd)
        + arm.elastic_energy(&state.q)
        + arm.gravity_energy(&state.q)
        + lengths.iter().zip(u).map(|(l, u)| l * u).sum::<f64>()
}

/// Largest entry of the equations' residual and of the constraints.
pub fn residual(arm: &Arm, state: &State, u: &[f64]) -> (f64, f64) {
    let n = arm.node_count();
    let (mut upper, mut lower) = (vec![0.0; 7 * n], vec![0.0; 4 * n]);
    arm.residual_into(&Motion::from(state), u, &mut upper, &mut lower);
    let largest = |v: &[f64]| DVector::from_column_slice(v).amax();
    (largest(&upper), largest(&lower))
}

/// Observed orders `log2(e_k / e_{k+1})` of errors at meshes (or steps) refined by two each.
pub fn orders(errors: &[f64]) -> Vec<f64> {
    errors.windows(2).map(|e| (e[0] / e[1]).log2()).collect()
}

/// Position of the last node.
pub fn tip(arm: &Arm, state: &State) -> Vector3<f64> {
    arm.tip(&state.q, &state.qd).position
}

/// A block as a matrix.
fn block(b: &sinew::math::block_tridiagonal::Block) -> nalgebra::SMatrix<f64, BLOCK, BLOCK> {
    nalgebra::SMatrix::from_fn(|r, c| b[(r, c)])
}
