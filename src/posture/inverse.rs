//! Inverse statics: mean curvatures whose equilibrium has its tip at a pose, of all such those with the least bending.

use super::reference::segment_lengths;
use super::rest::{POSE, RestingArm};
use crate::math::chain::Singular;
use crate::math::dense;
use crate::model::Arm;
use nalgebra::{Vector3, Vector4};

/// What a pose's parts are worth against each other, and against bending.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct InverseSettings {
    /// An attitude error of 1 rad counts as a position error of this (m).
    pub attitude_length_m: f64,
    /// A bend of 1 rad counts as a position error of this times the arm's length.
    pub effort: f64,
    /// Largest change of a segment's bend angle in an iteration (rad).
    pub turn_max_rad: f64,
}

impl Default for InverseSettings {
    fn default() -> Self {
        Self { attitude_length_m: 0.3, effort: 5e-4, turn_max_rad: 0.25 }
    }
}

/// By which bending counts less each time that the centre moves, and the least.
const RECENTRED_SHARE: f64 = 0.1;
const SHARE_MIN: f64 = 1e-4;

/// What an iteration left.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Outcome {
    /// Position error of the tip (m).
    pub position_m: f64,
    /// Attitude error of the tip without roll, and roll (rad).
    pub attitude_rad: f64,
    /// Roll about the tip's tangent (rad).
    pub roll_rad: f64,
    /// Largest change of a segment's bend angle (rad).
    pub change_rad: f64,
}

/// Gauss-Newton on a [`RestingArm`]. [`Inverse::new`] allocates, nothing else does.
#[derive(Debug, Clone)]
pub struct Inverse {
    rest: RestingArm,
    settings: InverseSettings,
    /// Length of the segment of each curvature (m).
    length: Vec<f64>,
    effort: f64,
    /// Share of it that counts now.
    share: f64,
    normal: Vec<f64>,
    step: Vec<f64>,
    origin: Vec<f64>,
    wanted: Vec<f64>,
    /// Curvatures without effort (1/m).
    centre: Vec<f64>,
}

impl Inverse {
    /// For an arm. Allocates.
    pub fn new(arm: &Arm, settings: &InverseSettings) -> Self {
        let count = 2 * arm.segment_count();
        let length = segment_lengths(arm);
        let whole: f64 = length.iter().step_by(2).sum();
        Self {
            rest: RestingArm::new(arm),
            effort: (settings.effort * whole).powi(2),
            share: 1.0,
            settings: *settings,
            length,
            normal: vec![0.0; count * count],
            step: vec![0.0; count],
            origin: vec![0.0; count],
            wanted: vec![0.0; count],
            centre: vec![0.0; count],
        }
    }

    /// Lets the present curvatures cost nothing, and others less: the way on to the pose.
    pub fn recentre(&mut self) {
        self.centre.copy_from_slice(self.rest.curvatures());
        self.share = (RECENTRED_SHARE * self.share).max(SHARE_MIN);
    }

    /// Lets curvatures (1/m) cost nothing, and others what they cost at first.
    pub fn centre_at(&mut self, curvatures: impl Iterator<Item = f64>) {
        self.centre.iter_mut().zip(curvatures).for_each(|(c, k)| *c = k);
        self.share = 1.0;
    }

    /// Curvatures (1/m) that cost nothing.
    pub fn centre(&self) -> &[f64] {
        &self.centre
    }

    /// What a squared bend angle costs (m^2), the position error's square being 1.
    pub const fn effort(&self) -> f64 {
        self.effort
    }

    /// The equilibrium that it is at.
    pub fn rest(&self) -> &RestingArm {
        &self.rest
    }

    /// The equilibrium, to start from another one.
    pub fn rest_mut(&mut self) -> &mut RestingArm {
        &mut self.rest
    }

    /// One iteration towards a pose, under tensions `u` (N) beside the moments that hold the curvatures.
    ///
    /// # Errors
    /// As [`Self::iterate_by`].
    pub fn iterate(
        &mut self,
        u: &[f64],
        position: &Vector3<f64>,
        quaternion: &Vector4<f64>,
    ) -> Result<Outcome, Singular> {
        self.iterate_by(1.0, u, position, quaternion)
    }

    /// The same by this share of the step.
    ///
    /// # Errors
    /// The static tangent is singular; the equilibrium stays as it was.
    pub fn iterate_by(
        &mut self,
        most: f64,
        u: &[f64],
        position: &Vector3<f64>,
        quaternion: &Vector4<f64>,
    ) -> Result<Outcome, Singular> {
        self.rest.linearize(u)?;
        let mut error = [0.0; POSE];
        self.rest.error_into(position, quaternion, &mut error, &mut self.origin);
        let count = self.origin.len();
        let weights = pose_weights(self.rest.jacobian(), count, self.settings.attitude_length_m);
        self.normal.fill(0.0);
        self.step.fill(0.0);
        for r in 0..POSE {
            let row = &self.rest.jacobian()[r * count..(r + 1) * count];
            for i in 0..count {
                self.step[i] -= weights[r] * row[i] * error[r];
                for j in 0..count {
                    self.normal[i * count + j] += weights[r] * row[i] * row[j];
                }
            }
        }
        for i in 0..count {
            let effort = self.share * self.effort * self.length[i] * self.length[i];
            self.normal[i * count + i] += effort;
            self.step[i] -= effort * (self.origin[i] - self.centre[i]);
        }
        if !dense::solve_in_place(count, &mut self.normal, &mut self.step) {
            return Err(Singular(0));
        }
        let now = self.rest.curvatures();
        let mut change_rad = 0.0f64;
        for i in 0..count {
            change_rad = change_rad.max((self.origin[i] + self.step[i] - now[i]).abs() * self.length[i]);
        }
        let share = (self.settings.turn_max_rad / change_rad).min(most);
        for i in 0..count {
            self.wanted[i] = now[i] + share * (self.origin[i] + self.step[i] - now[i]);
        }
        let norm = self.rest.advance(&self.wanted);
        if !norm.is_finite() {
            return Err(Singular(0));
        }
        let e = super::pose_error(&self.rest.tip(), position, quaternion);
        Ok(Outcome {
            position_m: Vector3::new(e[0], e[1], e[2]).norm(),
            attitude_rad: e[4].hypot(e[5]),
            roll_rad: e[3].abs(),
            change_rad,
        })
    }
}

/// Weights of a pose's rows (position 1; rotation in m^2) at their Jacobian. Roll about the tip's tangent counts as much
/// as the bends can turn it: where they hardly can, asking for it would bend the arm far for little.
pub fn pose_weights(jacobian: &[f64], count: usize, attitude_length_m: f64) -> [f64; POSE] {
    let authority = |r: usize| jacobian[r * count..(r + 1) * count].iter().map(|j| j * j).sum::<f64>();
    let (roll, bend) = (authority(3), 0.5 * (authority(4) + authority(5)));
    let attitude = attitude_length_m * attitude_length_m;
    let share = if bend > 0.0 { (roll / bend).min(1.0) } else { 0.0 };
    [1.0, 1.0, 1.0, attitude * share, attitude, attitude]
}
