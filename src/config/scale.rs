//! What an arm's own size and pace are: the units that every default without a number of its own is counted in.
//!
//! Enters: the arm's table. Leaves: its length, its first frequency, the range of its tensions. So a default is a number
//! without dimension, and arms that are similar to one another have similar controllers.

use super::arm::ArmConfig;

/// Length, pace and force of an arm.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Scale {
    /// Length from the base to the tip (m).
    pub length_m: f64,
    /// First angular frequency of bending about the straight arm (rad/s): elastic, and with the part of gravity that pulls
    /// along the arm and stiffens it. One that presses the arm together is left out: an upright arm has no slower
    /// controller than a lying one.
    pub omega_radps: f64,
    /// Largest tension (N).
    pub tension_n: f64,
    /// Number of cables.
    pub cables: usize,
}

impl Scale {
    /// Of an arm. An arm that was refused, or has no mass or stiffness, counts as 1 m, 1 rad/s and 1 N in what it lacks.
    pub fn of(arm: &ArmConfig) -> Self {
        let sound = |x: f64| if x.is_finite() && x > 0.0 { x } else { 1.0 };
        Self {
            length_m: sound(arm.length_m()),
            omega_radps: sound(first_frequency(arm)),
            tension_n: sound(arm.tension_n_max),
            cables: arm.cable_count(),
        }
    }

    /// Largest change of a tension per second in closed loop (N/s), where none is given.
    pub fn tension_rate_npsmax(&self) -> f64 {
        TENSION_RATE * self.tension_n * self.omega_radps
    }

    /// So many times the inverse of the first angular frequency (s).
    pub fn time_s(&self, share: f64) -> f64 {
        share / self.omega_radps
    }
}

/// Largest rate of a tension over the largest tension times the first angular frequency: twice what the loop was seen to use
/// (docs/DESIGN.md).
const TENSION_RATE: f64 = 5.0;

/// Steps of the power iteration; the second frequency is at least 2.5 times the first, so 12 would do.
const ITERATIONS: usize = 40;

/// First angular frequency (rad/s) of plane bending about the straight arm: `K x = omega^2 M x` in the rotations of the
/// nodes, the masses at the nodes and the chords of the model to first order, by power iteration on `K^-1 M`. K is
/// tridiagonal.
fn first_frequency(arm: &ArmConfig) -> f64 {
    let chain = Chain::of(arm);
    let n = chain.length.len();
    let mut x: Vec<f64> = (1..=n).map(|i| (i as f64 / n as f64).sqrt()).collect();
    let mut square = 0.0;
    for _ in 0..ITERATIONS {
        let load = chain.mass_times(&x);
        let kinetic: f64 = load.iter().zip(&x).map(|(m, x)| m * x).sum();
        let next = chain.compliance_times(load);
        let norm = next.iter().map(|x| x * x).sum::<f64>().sqrt();
        // Rayleigh's quotient of K^-1 M in the product of M.
        let carried = chain.mass_times(&next);
        square = kinetic / carried.iter().zip(&x).map(|(m, x)| m * x).sum::<f64>();
        x = next.iter().map(|x| x / norm).collect();
    }
    square.sqrt()
}

/// The straight arm as a chain of rotating nodes in a plane.
struct Chain {
    mass: Vec<f64>,
    inertia: Vec<f64>,
    length: Vec<f64>,
    connector: Vec<f64>,
    /// EI/l of each element (N m), and what gravity's pull adds over its length (N m).
    stiffness: Vec<f64>,
    pull: Vec<f64>,
    pull_connector: Vec<f64>,
}

impl Chain {
    fn of(arm: &ArmConfig) -> Self {
        let n = arm.node_count();
        let mut chain = Self {
            mass: Vec::with_capacity(n),
            inertia: Vec::with_capacity(n),
            length: Vec::with_capacity(n),
            connector: Vec::with_capacity(n),
            stiffness: Vec::with_capacity(n),
            pull: Vec::new(),
            pull_connector: Vec::new(),
        };
        let mut connector = 0.0;
        for (s, segment) in arm.segments.iter().enumerate() {
            let last = s + 1 == arm.segments.len();
            for e in 0..segment.elements {
                let (lump, l) = (segment.lump(e, last), segment.element_length_m());
                let tip = last && e + 1 == segment.elements;
                chain.mass.push(lump.mass + if tip { arm.payload.mass_kg } else { 0.0 });
                chain.inertia.push(lump.transverse);
                chain.length.push(l);
                chain.connector.push(if e == 0 { connector } else { 0.0 });
                chain.stiffness.push(segment.element_stiffness_nm2(e)[1] / l);
            }
            connector = if last { 0.0 } else { segment.connector_length_m };
        }
        let [w, x, y, z] = arm.base_quaternion;
        let tangent = [1.0 - 2.0 * (y * y + z * z), 2.0 * (x * y + w * z), 2.0 * (x * z - w * y)];
        let along: f64 = arm.gravity_mps2.iter().zip(tangent).map(|(g, t)| g * t).sum();
        let mut carried = 0.0;
        let force: Vec<f64> = chain
            .mass
            .iter()
            .rev()
            .map(|mass| {
                carried += mass * along.max(0.0);
                carried
            })
            .collect();
        chain.pull = force.iter().rev().zip(&chain.length).map(|(f, l)| f * l).collect();
        chain.pull_connector = force.iter().rev().zip(&chain.connector).map(|(f, c)| f * c).collect();
        chain
    }

    /// `M x`: to deflections of the nodes, by the masses, and back.
    fn mass_times(&self, x: &[f64]) -> Vec<f64> {
        let n = x.len();
        let before = |i: usize| if i == 0 { 0.0 } else { x[i - 1] };
        let mut deflection = 0.0;
        let force: Vec<f64> = (0..n)
            .map(|i| {
                deflection += self.connector[i] * before(i) + 0.5 * self.length[i] * (before(i) + x[i]);
                self.mass[i] * deflection
            })
            .collect();
        let mut out: Vec<f64> = x.iter().zip(&self.inertia).map(|(x, j)| x * j).collect();
        let mut beyond = 0.0;
        for i in (0..n).rev() {
            beyond += force[i];
            out[i] += 0.5 * self.length[i] * beyond;
            if i > 0 {
                out[i - 1] += (self.connector[i] + 0.5 * self.length[i]) * beyond;
            }
        }
        out
    }

    /// `K^-1 b`, by elimination.
    fn compliance_times(&self, mut b: Vec<f64>) -> Vec<f64> {
        let n = b.len();
        let mut diagonal = vec![0.0; n];
        let mut beside = vec![0.0; n];
        for i in 0..n {
            let (k, p) = (self.stiffness[i], 0.25 * self.pull[i]);
            diagonal[i] += k + p;
            if i > 0 {
                diagonal[i - 1] += k + p + self.pull_connector[i];
                beside[i - 1] = p - k;
            }
        }
        for i in 1..n {
            let factor = beside[i - 1] / diagonal[i - 1];
            diagonal[i] -= factor * beside[i - 1];
            b[i] -= factor * b[i - 1];
        }
        for i in (0..n).rev() {
            let next = if i + 1 < n { beside[i] * b[i + 1] } else { 0.0 };
            b[i] = (b[i] - next) / diagonal[i];
        }
        b
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_first_frequency_of_a_fine_cantilever_is_eulers() {
        let mut arm = ArmConfig::paper();
        arm.segments.truncate(1);
        let segment = &mut arm.segments[0];
        (segment.elements, segment.disk_mass_kg, segment.connector_length_m) = (50, 1e-9, 0.0);
        let (ei, m, l) = (segment.bending_stiffness_nm2, segment.backbone_mass_kgpm, segment.length_m);
        // The first root of cos x cosh x = -1, squared.
        let euler = 1.875_104_068_7_f64.powi(2) * (ei / (m * l.powi(4))).sqrt();
        let found = Scale::of(&arm).omega_radps;
        assert!((found / euler - 1.0).abs() < 2e-3, "{found} rad/s, {euler} by Euler");
    }

    #[test]
    fn a_chain_without_stiffness_hangs_like_a_chain() {
        // First root of J0, 2.4048: omega = 2.4048 / 2 sqrt(g / L).
        let mut arm = ArmConfig::paper();
        arm.segments.truncate(1);
        arm.gravity_mps2 = [0.0, 0.0, -9.81];
        let segment = &mut arm.segments[0];
        (segment.elements, segment.disk_mass_kg, segment.connector_length_m) = (50, 1e-9, 0.0);
        segment.bending_stiffness_nm2 = 1e-6;
        let chain = 0.5 * 2.404_825_557_7 * (9.81 / segment.length_m).sqrt();
        let found = Scale::of(&arm).omega_radps;
        assert!((found / chain - 1.0).abs() < 1e-2, "{found} rad/s, {chain} of a chain");
        // Upright it is not slower than without gravity.
        arm.gravity_mps2 = [0.0, 0.0, 9.81];
        let upright = Scale::of(&arm).omega_radps;
        arm.gravity_mps2 = [0.0; 3];
        assert_eq!(upright, Scale::of(&arm).omega_radps);
    }

    #[test]
    fn similar_arms_have_the_same_pace() {
        let arm = ArmConfig::paper();
        let of = Scale::of(&arm);
        assert!((of.omega_radps - 0.784).abs() < 1e-3, "{of:?}");
        for s in [0.03, 0.1, 0.3, 3.0] {
            let scale = Scale::of(&arm.scaled(s));
            assert!((scale.omega_radps / of.omega_radps - 1.0).abs() < 1e-9);
            assert!((scale.length_m / of.length_m / s - 1.0).abs() < 1e-12);
        }
    }
}
