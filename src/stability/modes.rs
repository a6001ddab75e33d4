//! What a mode of the loop moves.

use super::growth_limit_1ps;
use crate::config::{Config, Scale};
use crate::estimator::Kept;
use crate::math::block_tridiagonal::COORDINATES;
use crate::model::Arm;
use faer::c64;
use nalgebra::{DVector, Matrix3, SymmetricEigen, Vector3};
use serde::Serialize;
use std::f64::consts::TAU;

/// Where each part of what a loop remembers is: kind, first number, count.
pub(super) struct Layout(Vec<(Kept, usize, usize)>);

impl Layout {
    pub(super) fn new(parts: Vec<(Kept, usize, usize)>) -> Self {
        Self(parts)
    }

    pub(super) fn parts(&self) -> &[(Kept, usize, usize)] {
        &self.0
    }

    fn nth(&self, kept: Kept, n: usize) -> Option<(usize, usize)> {
        self.0.iter().filter(|(k, ..)| *k == kept).nth(n).map(|(_, at, count)| (*at, *count))
    }
}

/// An eigenvector, real and imaginary parts, in SI.
pub(super) struct Moved {
    pub(super) parts: [DVector<f64>; 2],
}

impl Moved {
    fn slice(&self, part: usize, (at, count): (usize, usize)) -> &[f64] {
        &self.parts[part].as_slice()[at..at + count]
    }
}

/// A mode of the closed loop.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct LoopMode {
    /// Modulus of its eigenvalue: what is left of it a tick later.
    pub modulus: f64,
    /// Frequency (Hz); 0 where it does not oscillate.
    pub frequency_hz: f64,
    /// Growth (1/s): `ln(modulus)` over the period.
    pub growth_1ps: f64,
    /// Damping over the critical one; below 0 it grows.
    pub damping_ratio: f64,
    /// Share of the elastic energy that twists the arm.
    pub torsion: f64,
    /// Shares that bend each segment as a whole: what cables measure.
    pub bending: Vec<f64>,
    /// Share that bends inside segments without changing their mean curvatures: what cables do not measure.
    pub inside: f64,
    /// Direction in which the tip moves most (base frame, of unit length); zero where it hardly moves.
    pub tip: [f64; 3],
    /// Motion of the estimated tip over the true one's; null where the true tip hardly moves.
    pub estimated: Option<f64>,
    /// Largest change of a tension for a motion of the tip (N/m); null where the tip hardly moves.
    pub tension_npm: Option<f64>,
}

/// A tip that moves by less than this share of the arm's length, while a tension changes by all of its range, does not.
const STILL: f64 = 1e-3;

impl LoopMode {
    pub(super) fn new(
        config: &Config,
        arm: &Arm,
        q: &[f64],
        layout: &Layout,
        period_s: f64,
        value: c64,
        moved: &Moved,
    ) -> Self {
        let modulus = value.norm_sqr().sqrt();
        let (growth, omega) = (modulus.ln() / period_s, value.im.atan2(value.re) / period_s);
        // What rounding makes of two equal real ones is no oscillation.
        let omega = if omega.abs() < growth_limit_1ps(config) { 0.0 } else { omega };
        // A real eigenvalue below zero turns its sign every tick: no oscillation of the arm, but at the tick's own pace.
        let own = layout.nth(Kept::Coordinates, 0).unwrap_or((0, 0));
        let other = layout.nth(Kept::Coordinates, 1);
        let sent = layout.0.iter().rfind(|(kept, ..)| *kept == Kept::Tensions).map(|(_, at, n)| (*at, *n));
        let tip_of = |at: (usize, usize)| [0, 1].map(|part| last_position(moved.slice(part, at)));
        let tip = tip_of(own);
        let size = |v: &[Vector3<f64>; 2]| v[0].norm().hypot(v[1].norm());
        let pulled = sent.map_or(0.0, |at| {
            let (re, im) = (moved.slice(0, at), moved.slice(1, at));
            re.iter().zip(im).map(|(a, b)| a.hypot(*b)).fold(0.0, f64::max)
        });
        let scale = Scale::of(&config.arm);
        let moves = size(&tip) / scale.length_m > STILL * pulled / scale.tension_n;
        let energy = Energy::of(arm, q, [0, 1].map(|part| moved.slice(part, own)));
        Self {
            modulus,
            frequency_hz: omega.abs() / TAU,
            growth_1ps: growth,
            damping_ratio: if omega == 0.0 { -growth.signum() } else { -growth / growth.hypot(omega) },
            torsion: energy.twist,
            bending: energy.bends,
            inside: energy.inside,
            tip: if moves { main_direction(&tip).into() } else { [0.0; 3] },
            estimated: other.filter(|_| moves).map(|at| size(&tip_of(at)) / size(&tip)),
            tension_npm: moves.then(|| pulled / size(&tip)),
        }
    }

    /// What moves, in words.
    pub fn in_words(&self) -> String {
        let percent = |share: f64| format!("{:.0} %", 100.0 * share);
        let Some(tension) = self.tension_npm else {
            return "tensions and estimate, hardly the arm".to_owned();
        };
        let mut shares: Vec<(f64, String)> =
            self.bending.iter().enumerate().map(|(s, b)| (*b, format!("bending of segment {}", s + 1))).collect();
        shares.push((self.torsion, "torsion".to_owned()));
        shares.push((self.inside, "bending inside segments".to_owned()));
        shares.sort_by(|a, b| b.0.total_cmp(&a.0));
        let what: Vec<String> =
            shares.iter().take(2).filter(|(s, _)| *s > 0.1).map(|(s, w)| format!("{w} {}", percent(*s))).collect();
        let [x, y, z] = self.tip;
        let estimate = self.estimated.map_or(String::new(), |e| format!(", the estimate {}", percent(e)));
        format!("{}; tip along ({x:.2}, {y:.2}, {z:.2}){estimate}; {:.2} N/mm", what.join(", "), 1e-3 * tension)
    }
}

fn last_position(q: &[f64]) -> Vector3<f64> {
    let at = q.len() - COORDINATES;
    Vector3::new(q[at], q[at + 1], q[at + 2])
}

/// Long axis of the ellipse that a point runs through.
fn main_direction(parts: &[Vector3<f64>; 2]) -> Vector3<f64> {
    let square: Matrix3<f64> = parts[0] * parts[0].transpose() + parts[1] * parts[1].transpose();
    let eigen = SymmetricEigen::new(square);
    let axis = eigen.eigenvectors.column(eigen.eigenvalues.imax()).into_owned();
    // Of two signs the one whose largest part is positive.
    if axis[axis.iamax()] < 0.0 { -axis } else { axis }
}

/// Shares of a motion's elastic energy.
struct Energy {
    twist: f64,
    bends: Vec<f64>,
    inside: f64,
}

impl Energy {
    fn of(arm: &Arm, q: &[f64], parts: [&[f64]; 2]) -> Self {
        let still = vec![0.0; q.len()];
        let (mut twist, mut inside, mut bends) = (0.0, 0.0, vec![0.0; arm.segment_count()]);
        for part in parts {
            let largest = part.iter().fold(0.0f64, |a, x| a.max(x.abs()));
            if largest == 0.0 {
                continue;
            }
            let step = 1e-6 / largest;
            let moved = |sign: f64| -> Vec<f64> { q.iter().zip(part).map(|(q, d)| q + sign * step * d).collect() };
            let (ahead, behind) = (moved(1.0), moved(-1.0));
            for (s, range) in arm.segment_elements.iter().enumerate() {
                let changes: Vec<Vector3<f64>> = range
                    .clone()
                    .map(|i| {
                        let at = |q: &[f64]| arm.element_curvature(q, &still, i).0;
                        (at(&ahead) - at(&behind)) / (2.0 * step)
                    })
                    .collect();
                let mean = changes.iter().sum::<Vector3<f64>>() / changes.len() as f64;
                for (change, element) in changes.iter().zip(&arm.elements[range.clone()]) {
                    let (gj, ei) = (element.length * element.stiffness[0], element.length * element.stiffness[1]);
                    twist += gj * change[0] * change[0];
                    bends[s] += ei * (mean[1] * mean[1] + mean[2] * mean[2]);
                    inside += ei * ((change[1] - mean[1]).powi(2) + (change[2] - mean[2]).powi(2));
                }
            }
        }
        let all = twist + inside + bends.iter().sum::<f64>();
        let share = |x: f64| if all > 0.0 { x / all } else { 0.0 };
        Self { twist: share(twist), inside: share(inside), bends: bends.into_iter().map(share).collect() }
    }
}
