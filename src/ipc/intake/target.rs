//! Desired motion: points in time, interpolated.

use super::encoders::admit;
use super::{InputLimits, SourceLog, check, elapsed_s};
use crate::ipc::payload::{MAX_CURVATURES, RejectCause, SourceHealth, SourceReport, Target, TargetMode};
use nalgebra::{Quaternion, UnitQuaternion, Vector3};
use sinew_hal::clock::seconds_to_ns;

/// Points kept: 0.6 s ahead at 100 Hz, with the one in use.
pub const TRACK_POINTS: usize = 64;

/// The desired motion as far as it is known.
#[derive(Debug, Clone)]
pub struct TargetTrack {
    segment_count: usize,
    log: SourceLog,
    /// Ascending in `valid_from_ns`; the first `count` are in use.
    points: [Target; TRACK_POINTS],
    count: usize,
    /// Time up to which passed points were dropped last (ns): the first one kept was in use then.
    dropped_to_ns: u64,
}

/// Desired output at one time.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct TargetSample {
    /// What is asked for.
    pub mode: TargetMode,
    /// Tip position (m), base frame.
    pub position_m: [f64; 3],
    /// Tip's unit quaternion `[w x y z]`.
    pub quaternion: [f64; 4],
    /// Tip velocity (m/s), base frame.
    pub velocity_mps: [f64; 3],
    /// Tip angular velocity (rad/s), base frame.
    pub angular_velocity_radps: [f64; 3],
    /// Average curvatures (1/m).
    pub curvature_1pm: [f64; MAX_CURVATURES],
    /// Their rates (1/(m s)).
    pub curvature_rate_1pms: [f64; MAX_CURVATURES],
    /// Weight of the task; 0: the configured one.
    pub weight: f64,
    /// Sequence number of the point that the sample follows.
    pub sequence: u64,
    /// By how much the time lies beyond the last point of a *moving* target (s); 0 otherwise. The target stands still from
    /// `stale_after_s` on; beyond `hold_after_s` the supervisor is asked to hold.
    pub overrun_s: f64,
}

impl TargetTrack {
    /// Without any target, for an arm with this many segments.
    pub fn new(segment_count: usize) -> Self {
        Self {
            segment_count,
            log: SourceLog::default(),
            points: [Target::default(); TRACK_POINTS],
            count: 0,
            dropped_to_ns: 0,
        }
    }

    /// Takes over a point if it is valid. Does not allocate.
    ///
    /// A point replaces all points at or after its own time, so a client that changes its mind just sends anew.
    ///
    /// # Errors
    /// The cause for which it was rejected; already counted.
    pub fn accept(&mut self, message: &Target, now_ns: u64, limits: &InputLimits) -> Result<(), RejectCause> {
        self.accept_from(message, 0, now_ns, limits)
    }

    /// The same of a port (0: not known), to which the source's id belongs until the source is not fresh any more or its
    /// port is [gone](Self::set_gone).
    ///
    /// # Errors
    /// As [`Self::accept`].
    pub fn accept_from(
        &mut self,
        message: &Target,
        publisher: u128,
        now_ns: u64,
        limits: &InputLimits,
    ) -> Result<(), RejectCause> {
        let checked = admit(&mut self.log, &message.header, publisher, now_ns, limits)
            .and_then(|()| self.validate(message))
            .and_then(|()| self.insert(message, now_ns));
        self.log.settle(checked, &message.header, publisher)
    }

    fn validate(&self, t: &Target) -> Result<(), RejectCause> {
        check::weight(t.weight)?;
        match TargetMode::from_wire(t.mode).ok_or(RejectCause::UnknownKind)? {
            TargetMode::Tip => {
                check::coordinates(&t.position_m)?;
                check::quaternion(&t.quaternion)?;
                check::coordinates(&t.velocity_mps)?;
                check::coordinates(&t.angular_velocity_radps)
            }
            TargetMode::Shape => {
                if t.segment_count as usize != self.segment_count {
                    return Err(RejectCause::WrongCount);
                }
                let n = 2 * self.segment_count;
                check::coordinates(&t.curvature_1pm[..n])?;
                check::coordinates(&t.curvature_rate_1pms[..n])
            }
        }
    }

    fn insert(&mut self, message: &Target, now_ns: u64) -> Result<(), RejectCause> {
        let keep = self.points[..self.count].iter().take_while(|p| p.valid_from_ns < message.valid_from_ns).count();
        // Of the past, only the point that is in use now is needed.
        let passed = self.points[..keep].iter().take_while(|p| p.valid_from_ns <= now_ns).count().saturating_sub(1);
        if keep - passed == TRACK_POINTS {
            return Err(RejectCause::Overfull);
        }
        if passed > 0 {
            self.dropped_to_ns = now_ns;
        }
        self.points.copy_within(passed..keep, 0);
        let end = keep - passed;
        self.points[end] = *message;
        self.points[end].quaternion = check::normalised(&message.quaternion);
        self.count = end + 1;
        Ok(())
    }

    /// The other port that has the service; `None` if this one may have it.
    pub fn taken_by(&self, publisher: u128) -> Option<u128> {
        self.log.taken_by(publisher)
    }

    /// Port in use that is not known to be gone, 0 for none.
    pub fn publisher(&self) -> u128 {
        if self.log.gone { 0 } else { self.log.publisher }
    }

    /// Notes that the port in use is gone: a run in lockstep does not wait for it.
    pub fn set_gone(&mut self) {
        self.log.gone = self.log.last.is_some();
    }

    /// What is known of the source.
    pub fn log(&self) -> &SourceLog {
        &self.log
    }

    /// Forgets all points (after a stop or a fault); the source's clock and sequence go on.
    pub fn clear(&mut self) {
        self.count = 0;
        self.dropped_to_ns = 0;
    }

    /// Overwrites this track with another's content, copying only what is in use.
    pub fn copy_from(&mut self, other: &Self) {
        self.segment_count = other.segment_count;
        self.log = other.log;
        self.count = other.count;
        self.dropped_to_ns = other.dropped_to_ns;
        self.points[..other.count].copy_from_slice(&other.points[..other.count]);
    }

    /// The desired output at a time; `None` before the first point is valid, or without any. Does not allocate.
    ///
    /// Between points: cubic Hermite in position and curvature (value and rate of both points are met), slerp in attitude.
    /// Beyond the last point: at its rates for `stale_after_s`, then standing still. A time that lies before points that
    /// were dropped as passed gets the first one kept: a tick that is late asks for a time at which a message that came
    /// meanwhile was not yet there, and must not find that there is no target.
    pub fn sample(&self, at_ns: u64, limits: &InputLimits) -> Option<TargetSample> {
        let points = &self.points[..self.count];
        let first_ns = points.first()?.valid_from_ns;
        let at_ns = if first_ns <= self.dropped_to_ns { at_ns.max(first_ns) } else { at_ns };
        let next = points.iter().take_while(|p| p.valid_from_ns <= at_ns).count();
        let from = points.get(next.checked_sub(1)?)?;
        let mode = TargetMode::from_wire(from.mode)?;
        match points.get(next) {
            Some(to) if to.mode == from.mode => Some(between(from, to, mode, at_ns)),
            Some(_) => Some(beyond(from, mode, at_ns, limits)),
            None => {
                let mut sample = beyond(from, mode, at_ns, limits);
                if self.moves(from, mode) {
                    sample.overrun_s = elapsed_s(start_ns(from), at_ns);
                }
                Some(sample)
            }
        }
    }

    /// Whether a point asks for motion beyond its own time.
    fn moves(&self, point: &Target, mode: TargetMode) -> bool {
        match mode {
            TargetMode::Tip => point.velocity_mps.iter().chain(&point.angular_velocity_radps).any(|&v| v != 0.0),
            TargetMode::Shape => point.curvature_rate_1pms[..2 * self.segment_count].iter().any(|&v| v != 0.0),
        }
    }

    /// The record for `State::target_report`. A source that is silent because its target stands still is not stale.
    pub fn report(&self, now_ns: u64, limits: &InputLimits) -> SourceReport {
        let mut report = self.log.report(now_ns, limits);
        let old = [SourceHealth::Stale, SourceHealth::Expired].map(SourceHealth::wire).contains(&report.health);
        let last = self.points[..self.count].last().filter(|last| last.valid_from_ns <= now_ns);
        let stands = |last: &Target| TargetMode::from_wire(last.mode).is_some_and(|mode| !self.moves(last, mode));
        if old && last.is_some_and(stands) {
            report.health = SourceHealth::Held.wire();
        }
        report
    }

    /// Whether the target of `tick` or later is here (lockstep).
    pub fn is_ready_for(&self, tick: u64) -> bool {
        self.log.has_come_for(tick)
    }
}

/// Time at which a point's pose holds: a set-point's rates count from its capture.
fn start_ns(point: &Target) -> u64 {
    if point.valid_from_ns == 0 { point.header.capture_ns } else { point.valid_from_ns }
}

fn unit(q: &[f64; 4]) -> UnitQuaternion<f64> {
    UnitQuaternion::new_normalize(Quaternion::new(q[0], q[1], q[2], q[3]))
}

fn wxyz(q: &UnitQuaternion<f64>) -> [f64; 4] {
    [q.w, q.i, q.j, q.k]
}

fn sample_of(point: &Target, mode: TargetMode) -> TargetSample {
    TargetSample {
        mode,
        position_m: point.position_m,
        quaternion: point.quaternion,
        velocity_mps: point.velocity_mps,
        angular_velocity_radps: point.angular_velocity_radps,
        curvature_1pm: point.curvature_1pm,
        curvature_rate_1pms: point.curvature_rate_1pms,
        weight: point.weight,
        sequence: point.header.sequence,
        overrun_s: 0.0,
    }
}

fn beyond(point: &Target, mode: TargetMode, at_ns: u64, limits: &InputLimits) -> TargetSample {
    let mut s = sample_of(point, mode);
    let since_ns = at_ns.saturating_sub(start_ns(point));
    let stands = since_ns > seconds_to_ns(limits.stale_after_s);
    let dt = elapsed_s(0, since_ns).min(limits.stale_after_s);
    for i in 0..3 {
        s.position_m[i] += point.velocity_mps[i] * dt;
    }
    let turn = UnitQuaternion::from_scaled_axis(Vector3::from(point.angular_velocity_radps) * dt);
    s.quaternion = wxyz(&(turn * unit(&point.quaternion)));
    for i in 0..MAX_CURVATURES {
        s.curvature_1pm[i] += point.curvature_rate_1pms[i] * dt;
    }
    if stands {
        s.velocity_mps = [0.0; 3];
        s.angular_velocity_radps = [0.0; 3];
        s.curvature_rate_1pms = [0.0; MAX_CURVATURES];
    }
    s
}

fn between(from: &Target, to: &Target, mode: TargetMode, at_ns: u64) -> TargetSample {
    let span = elapsed_s(start_ns(from), to.valid_from_ns).max(1e-9);
    let x = (elapsed_s(start_ns(from), at_ns) / span).clamp(0.0, 1.0);
    let hermite = |a: f64, va: f64, b: f64, vb: f64| {
        let (x2, x3) = (x * x, x * x * x);
        let value = (2.0 * x3 - 3.0 * x2 + 1.0) * a
            + (x3 - 2.0 * x2 + x) * span * va
            + (3.0 * x2 - 2.0 * x3) * b
            + (x3 - x2) * span * vb;
        let rate = (6.0 * x2 - 6.0 * x) * (a - b) / span + (3.0 * x2 - 4.0 * x + 1.0) * va + (3.0 * x2 - 2.0 * x) * vb;
        (value, rate)
    };
    let mut s = sample_of(from, mode);
    for i in 0..3 {
        (s.position_m[i], s.velocity_mps[i]) =
            hermite(from.position_m[i], from.velocity_mps[i], to.position_m[i], to.velocity_mps[i]);
    }
    for i in 0..MAX_CURVATURES {
        (s.curvature_1pm[i], s.curvature_rate_1pms[i]) =
            hermite(from.curvature_1pm[i], from.curvature_rate_1pms[i], to.curvature_1pm[i], to.curvature_rate_1pms[i]);
    }
    // Between a given weight and the configured one, which is not known here, there is nothing to interpolate.
    if from.weight > 0.0 && to.weight > 0.0 {
        s.weight = from.weight + x * (to.weight - from.weight);
    }
    // Both signs of a quaternion are the same attitude: turn the short way round.
    let (a, b) = (unit(&from.quaternion), unit(&to.quaternion));
    let mut turn = b * a.inverse();
    if turn.w < 0.0 {
        turn = UnitQuaternion::new_unchecked(-turn.into_inner());
    }
    let rotation = turn.scaled_axis();
    s.quaternion = wxyz(&(UnitQuaternion::from_scaled_axis(rotation * x) * a));
    s.angular_velocity_radps = (rotation / span).into();
    s
}

#[cfg(test)]
#[path = "target_tests.rs"]
mod tests;
