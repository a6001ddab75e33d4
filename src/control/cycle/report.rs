//! The record of a tick: what the estimate looks like, how far it is from target and obstacles.

use super::{Cycle, Plan, TickInputs};
use crate::control::NODES_MAX;
use crate::control::estimator::Estimator;
use crate::control::record::{Distance, Record};
use crate::control::target::Target;
use crate::math::quaternion::rotation;

impl<E: Estimator, P: Plan> Cycle<E, P> {
    /// Completes the record of the tick that was done with `inputs`. Does not allocate. For after sending.
    pub fn report(&mut self, inputs: &TickInputs<'_>) -> &Record {
        // Nobody is to take a swinging arm for a straight one.
        let looks = !self.observing && !self.supervisor.is_starting();
        if looks && self.encoders.silent(inputs.now_ns).is_none() && self.estimator.look(self.encoders.lengths_m()) {
            self.measure_curvatures();
        }
        let state = self.estimator.state();
        let (cables, count) = (self.arm.cable_count(), 2 * self.arm.segment_count());
        let r = &mut self.record;
        r.tick = inputs.tick;
        r.now_ns = inputs.now_ns;
        r.mode = self.supervisor.mode();
        r.fault = self.supervisor.latch().first;
        r.fault_count = self.supervisor.latch().count;
        r.tip_measured_m = inputs.tip.map_or([f64::NAN; 3], |tip| tip.position_m.into());
        r.tip_bias_m = self.tip_sensor.bias_m().into();
        r.swing_m = self.supervision.swing_m();
        r.tip_covariance_m2 = self.governor.covariance().tip().map_or([f64::NAN; 9], |p| {
            let mut rows = [0.0; 9];
            rows.copy_from_slice(p.as_slice());
            rows
        });
        r.speed_scale = self.speed_scale;
        r.reach = self.governor.reach().copied();
        r.drives = inputs.drives.phase;
        r.deadlines_missed = self.supervisor.deadlines_missed();
        r.events_dropped = self.supervisor.events_mut().dropped;
        r.observing = self.observing;
        r.settled = self.observing && self.estimate.settled;
        r.innovation_max_rad = if self.observing { self.estimate.innovation_max_rad } else { f64::NAN };

        r.cable_count = cables;
        r.tension_command_n[..cables].copy_from_slice(&self.commanded);
        r.tension_measured_n.fill(f64::NAN);
        copy(inputs.tensions_measured_n, &mut r.tension_measured_n[..cables]);
        r.cable_length_m[..cables].copy_from_slice(self.encoders.lengths_m());
        r.bridged = self.encoders.bridged();
        r.encoder_capture_ns = inputs.encoders.capture_ns;

        r.curvature_count = count;
        r.curvature_1pm[..count].copy_from_slice(&self.curvatures[..count]);
        r.innovation_rad.fill(f64::NAN);
        copy(self.estimator.innovation_rad(), &mut r.innovation_rad[..count]);
        r.disturbance_nm.fill(f64::NAN);
        copy(self.estimator.disturbance_nm(), &mut r.disturbance_nm[..count]);

        let tip = self.arm.tip(&state.q, &state.qd);
        r.tip_position_m = tip.position.into();
        r.tip_quaternion = tip.quaternion.into();
        r.tip_velocity_mps = tip.velocity.into();
        r.tip_angular_velocity_radps = (rotation(&tip.quaternion) * tip.angular_velocity).into();

        r.target = inputs.target.map(|target| target.now);
        r.target_sequence = inputs.target.map_or(0, |target| target.sequence);
        (r.tip_error_m, r.quaternion_error, r.curvature_error_1pm) = (f64::NAN, f64::NAN, f64::NAN);
        match r.target {
            Some(Target::Tip { position_m, quaternion, .. }) => {
                r.tip_error_m = (tip.position - position_m).norm();
                let sign = if quaternion.dot(&tip.quaternion) < 0.0 { -1.0 } else { 1.0 };
                r.quaternion_error = (tip.quaternion - sign * quaternion).norm();
            }
            Some(Target::Shape { curvatures_1pm, .. }) => {
                let errors = self.curvatures[..count].iter().zip(&curvatures_1pm).map(|(k, d)| (k - d).abs());
                r.curvature_error_1pm = errors.fold(0.0, f64::max);
            }
            None => {}
        }

        let nodes = self.arm.node_count();
        r.node_stride = nodes.div_ceil(NODES_MAX).max(1);
        r.node_count = nodes.div_ceil(r.node_stride);
        for i in 0..r.node_count {
            let node = ((i + 1) * r.node_stride).min(nodes) - 1;
            r.nodes[i].copy_from_slice(&state.q[7 * node..7 * (node + 1)]);
        }

        self.arm.frames_into(&state.q, &mut self.positions, &mut self.tangents);
        let obstacles = inputs.obstacles.now();
        let measured = self.body.measure(&self.positions, &self.tangents, obstacles);
        r.obstacle_count = obstacles.len();
        for (k, obstacle) in obstacles.as_slice().iter().enumerate() {
            r.distances[k] = Distance {
                id: obstacle.id(),
                along_arm_m: measured.along_arm[k],
                at_points_m: measured.at_points[k],
                growth_m: obstacle.growth(),
            };
        }
        &self.record
    }
}

/// Copies as much as both have.
fn copy(from: &[f64], to: &mut [f64]) {
    to.iter_mut().zip(from).for_each(|(to, from)| *to = *from);
}
