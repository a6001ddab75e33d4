//! How well an estimate knows where the arm is.
//!
//! Cables tell the mean bends of the segments, and how well they do is known: a share of each bend (the curve between two
//! disks, holes, drums), a rest that does not depend on it (encoder steps, clearance of the holes), and a share of the bend
//! to the side (torsion turns the plane that a segment bends in). With `J_e` the sensitivity of a point to the bend angles
//! `theta_s` of segment s, and `theta_s'` the same turned by a quarter,
//!
//! ```text
//! P_e = sigma_1^2 ( sum_s J_s theta_s (J_s theta_s)^T + (sum_s J_s theta_s)(sum_s J_s theta_s)^T ) / 2
//!     + sigma_2^2 sum_s J_s theta_s' (J_s theta_s')^T + sigma_3^2 sum_s J_s J_s^T + (sigma_4 s_e w)^2 I
//! ```
//!
//! half of the shares' error common to all segments, half of each alone; w is the swing that there may be beside what cables
//! show, s_e the point's share of the arm's length. Where a sensor tells that the tip is `d` off, the variance along `d` is no
//! less than `s_e^2 |d|^2`. Checked against the true arm by `sim_plant`'s campaign: the error stays
//! within three standard deviations.

use crate::config::ObserverConfig;
use crate::model::Arm;
use nalgebra::{Matrix3, Vector3};

/// Covariance of the estimated positions of one arm's segment ends. [`PositionCovariance::new`] allocates, nothing else does.
#[derive(Debug, Clone)]
pub struct PositionCovariance {
    scale_sigma: f64,
    side_sigma: f64,
    bend_sigma_rad: f64,
    swing_sigma: f64,
    /// Length of each segment (m), and the share of the arm's length at its end.
    length: Vec<f64>,
    share: Vec<f64>,
    /// Segment, and share of it behind, of each element's end.
    element: Vec<(usize, f64)>,
    /// Covariance of each segment's end (m^2, base frame), and the largest standard deviation in any direction (m).
    end: Vec<Matrix3<f64>>,
    sigma: Vec<f64>,
    /// The same for each element, at its end.
    element_sigma: Vec<f64>,
    known: bool,
}

impl PositionCovariance {
    /// For an arm. Allocates.
    pub fn new(arm: &Arm, config: &ObserverConfig) -> Self {
        let length: Vec<f64> = (0..arm.segment_count()).map(|segment| arm.segment_length(segment)).collect();
        let whole: f64 = length.iter().sum();
        let mut behind = 0.0;
        let share = length.iter().map(|l| {
            behind += l;
            behind / whole
        });
        let element = arm.segment_elements.iter().enumerate().flat_map(|(s, range)| {
            let count = range.len() as f64;
            (0..range.len()).map(move |i| (s, (i + 1) as f64 / count))
        });
        Self {
            scale_sigma: config.scale_sigma,
            side_sigma: config.side_sigma,
            bend_sigma_rad: config.bend_sigma_rad,
            swing_sigma: config.swing_sigma,
            share: share.collect(),
            element: element.collect(),
            end: vec![Matrix3::zeros(); length.len()],
            sigma: vec![0.0; length.len()],
            element_sigma: vec![0.0; arm.elements.len()],
            known: false,
            length,
        }
    }

    /// Takes over mean curvatures `kappa` (1/m), the sensitivity `ends` of the segments' ends to them (m per 1/m, three rows of
    /// two columns a segment for each end), the swing that there may be (m, peak to peak), and what the tip is known to be
    /// off by (m; zero where nothing measures it). Does not allocate.
    pub fn update(&mut self, kappa: &[f64], ends: &[f64], swing_m: f64, off_m: &Vector3<f64>) {
        let count = kappa.len();
        self.known = true;
        for (e, end) in ends.chunks_exact(3 * count).enumerate() {
            let column = |i: usize| Vector3::new(end[i], end[count + i], end[2 * count + i]);
            let (mut all, mut p) = (Vector3::zeros(), Matrix3::zeros());
            for (s, length) in self.length.iter().enumerate() {
                let (y, z) = (column(2 * s), column(2 * s + 1));
                let along = y * kappa[2 * s] + z * kappa[2 * s + 1];
                let side = y * -kappa[2 * s + 1] + z * kappa[2 * s];
                all += along;
                p += (0.5 * self.scale_sigma.powi(2)) * along * along.transpose();
                p += self.side_sigma.powi(2) * side * side.transpose();
                p += (self.bend_sigma_rad / length).powi(2) * (y * y.transpose() + z * z.transpose());
            }
            p += (0.5 * self.scale_sigma.powi(2)) * all * all.transpose();
            p += Matrix3::identity() * (self.swing_sigma * self.share[e] * swing_m).powi(2);
            if let Some(along) = off_m.try_normalize(0.0) {
                let known = self.share[e] * off_m.norm();
                let lacks = known.powi(2) - along.dot(&(p * along));
                p += lacks.max(0.0) * along * along.transpose();
            }
            self.end[e] = p;
            self.sigma[e] = p.symmetric_eigenvalues().max().max(0.0).sqrt();
        }
        for (sigma, &(s, behind)) in self.element_sigma.iter_mut().zip(&self.element) {
            let before = if s == 0 { 0.0 } else { self.sigma[s - 1] };
            *sigma = before + behind * (self.sigma[s] - before);
        }
    }

    /// Covariance of the tip's position (m^2, base frame); `None` before the first update.
    pub fn tip(&self) -> Option<&Matrix3<f64>> {
        self.end.last().filter(|_| self.known)
    }

    /// Standard deviation (m) of the position of each element's end, in the direction in which it is largest.
    pub fn element_sigma_m(&self) -> &[f64] {
        &self.element_sigma
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::config::Config;

    /// Of a plane cantilever: bends of segment s move its own end and everything behind by the distance from its middle.
    #[test]
    fn a_straight_arm_is_off_by_its_angles_and_a_bent_one_by_its_bends() {
        let config = Config::builtin();
        let arm = Arm::new(&config.arm);
        let settings = ObserverConfig { scale_sigma: 0.01, side_sigma: 0.0, bend_sigma_rad: 1e-3, ..config.observer };
        let mut covariance = PositionCovariance::new(&arm, &settings);
        assert_eq!(covariance.tip(), None);
        // One segment's bend about z moves the ends behind it along y by 2 m per 1/m; nothing else moves anything.
        let mut ends = vec![0.0; 3 * 4 * 8];
        for e in 1..4 {
            ends[(3 * e + 1) * 8 + 3] = 2.0;
        }
        let (mut kappa, none) = ([0.0; 8], Vector3::zeros());
        covariance.update(&kappa, &ends, 0.0, &none);
        let angle = 1e-3 / 0.65 * 2.0;
        let tip = covariance.tip().unwrap();
        assert!((tip[(1, 1)].sqrt() / angle - 1.0).abs() < 1e-9 && tip[(0, 0)] == 0.0, "{tip}");
        assert_eq!(covariance.element_sigma_m()[0], 0.0);
        assert!((covariance.element_sigma_m()[19] / angle - 1.0).abs() < 1e-9);
        // A share of a bend is no less the larger it is; swinging comes on top, least near the base.
        kappa[3] = 1.5;
        covariance.update(&kappa, &ends, 0.0, &none);
        let bent = covariance.tip().unwrap()[(1, 1)];
        assert!((bent - angle.powi(2) - (0.01_f64 * 1.5 * 2.0).powi(2)).abs() < 1e-12, "{bent}");
        covariance.update(&kappa, &ends, 0.1, &none);
        let swinging = covariance.element_sigma_m();
        assert!(swinging[19] > bent.sqrt() && swinging[4] < swinging[19]);
        assert!((swinging[4] - settings.swing_sigma * 0.25 * 0.1).abs() < 1e-12, "{}", swinging[4]);
        // What is known to be off counts along itself, and where it is more than what was thought of.
        covariance.update(&kappa, &ends, 0.1, &Vector3::new(0.0, 0.0, 0.1));
        let known = covariance.tip().unwrap();
        assert!((known[(2, 2)].sqrt() - 0.1).abs() < 1e-12 && known[(1, 1)] < 0.9 * 0.1 * 0.1, "{known}");
        covariance.update(&kappa, &ends, 0.1, &Vector3::new(0.0, 1e-3, 0.0));
        let usual = covariance.tip().unwrap()[(1, 1)];
        covariance.update(&kappa, &ends, 0.1, &none);
        assert_eq!(covariance.tip().unwrap()[(1, 1)], usual);
    }
}
