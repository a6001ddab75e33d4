//! Obstacle sets of several sources: newest per source wins, merged and extrapolated.

use super::{InputLimits, SourceLog, check, elapsed_s};
use crate::ipc::payload::{
    FLAG_LEAVING, MAX_OBSTACLES, MAX_SOURCES, MAX_TRACKED, MAX_VERTICES, Obstacle, ObstacleKind, Obstacles,
    RejectCause, SourceHealth, SourceReport, State,
};

/// One source's place in the table.
#[derive(Debug, Clone)]
struct Slot {
    log: SourceLog,
    /// The configuration names this source: its absence asks for a hold.
    declared: bool,
    used: bool,
    /// When another process was last refused the id of this declared source (ns): which of them is the right one, nobody
    /// knows.
    contested_ns: Option<u64>,
    set: Obstacles,
    /// Largest standard deviation of each obstacle (m); computed on arrival, off the control thread.
    sigma_m: [f64; MAX_OBSTACLES],
}

impl Slot {
    fn empty() -> Self {
        Self {
            log: SourceLog::new(0),
            declared: false,
            used: false,
            contested_ns: None,
            set: Obstacles::default(),
            sigma_m: [0.0; MAX_OBSTACLES],
        }
    }

    /// Health of the source; a declared one whose id two processes claim is not to be believed.
    fn health(&self, now_ns: u64, limits: &InputLimits) -> SourceHealth {
        let contested = self.contested_ns.is_some_and(|at_ns| elapsed_s(at_ns, now_ns) <= limits.hold_after_s);
        if contested { SourceHealth::Refused } else { self.log.health(now_ns, limits) }
    }

    fn obstacles(&self) -> &[Obstacle] {
        if self.log.last.is_some() { self.set.used() } else { &[] }
    }
}

/// The newest valid set of every source.
///
/// About 140 kB, no heap: one lives on the input side, three in the triple buffer to the control thread.
#[derive(Debug, Clone)]
pub struct ObstacleTable {
    slots: [Slot; MAX_SOURCES],
    sources_refused: u64,
    /// The last source for which there was no place, and when (ns).
    crowded_out: Option<(u32, u64)>,
}

/// What the obstacle inputs ask of the supervisor.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum ObstacleDemand {
    /// Nothing.
    Proceed,
    /// Hold: the named source is expired, or declared and absent, or none of its sets is accepted.
    Hold {
        /// The first such source.
        source_id: u32,
    },
}

/// One obstacle as the planner takes it: at the planned time, grown.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct TrackedObstacle {
    /// Source.
    pub source_id: u32,
    /// Id within the source.
    pub id: u32,
    /// Shape.
    pub kind: ObstacleKind,
    /// Dimensions (m) by kind, as in [`Obstacle::dimensions_m`], not grown.
    pub dimensions_m: [f64; 3],
    /// Origin (m), base frame, extrapolated.
    pub position_m: [f64; 3],
    /// Unit quaternion `[w x y z]`, obstacle to base.
    pub quaternion: [f64; 4],
    /// Velocity (m/s), base frame.
    pub velocity_mps: [f64; 3],
    /// To be added to the shape all around (m): `sigma_multiple` standard deviations and the growth by age.
    pub growth_m: f64,
    /// Health of its source.
    pub health: SourceHealth,
    /// Vertices of a hull, for [`ObstacleTable::hull_vertices`].
    hull: (u8, u16, u16),
}

impl TrackedObstacle {
    const NONE: Self = Self {
        source_id: 0,
        id: 0,
        kind: ObstacleKind::Ball,
        dimensions_m: [0.0; 3],
        position_m: [0.0; 3],
        quaternion: [1.0, 0.0, 0.0, 0.0],
        velocity_mps: [0.0; 3],
        growth_m: 0.0,
        health: SourceHealth::Absent,
        hull: (0, 0, 0),
    };
}

/// All tracked obstacles at one planned time; fixed capacity.
#[derive(Debug, Clone)]
pub struct TrackedSet {
    count: usize,
    obstacles: [TrackedObstacle; MAX_TRACKED],
}

impl TrackedSet {
    /// An empty set.
    pub const fn new() -> Self {
        Self { count: 0, obstacles: [TrackedObstacle::NONE; MAX_TRACKED] }
    }

    /// The obstacles, by source place, then in the source's order.
    pub fn as_slice(&self) -> &[TrackedObstacle] {
        &self.obstacles[..self.count]
    }
}

impl Default for TrackedSet {
    fn default() -> Self {
        Self::new()
    }
}

impl ObstacleTable {
    /// A table in which nothing was heard. `declared` sources (the first eight) must be present for motion.
    pub fn new(declared: &[u32]) -> Self {
        let mut table = Self { slots: std::array::from_fn(|_| Slot::empty()), sources_refused: 0, crowded_out: None };
        for (slot, &source_id) in table.slots.iter_mut().zip(declared) {
            slot.log.source_id = source_id;
            slot.declared = true;
            slot.used = true;
        }
        table
    }

    /// Takes over a message if it is valid. Does not allocate.
    ///
    /// # Errors
    /// The cause for which it was rejected; already counted for the source.
    pub fn accept(&mut self, message: &Obstacles, now_ns: u64, limits: &InputLimits) -> Result<(), RejectCause> {
        self.accept_from(message, 0, now_ns, limits)
    }

    /// The same of a port (0: not known), to which the source's id belongs from the first accepted message until the port
    /// is [gone](Self::set_gone) or the source has left.
    ///
    /// # Errors
    /// As [`Self::accept`].
    pub fn accept_from(
        &mut self,
        message: &Obstacles,
        publisher: u128,
        now_ns: u64,
        limits: &InputLimits,
    ) -> Result<(), RejectCause> {
        let Some(place) = self.place_of(message.header.source_id) else {
            self.sources_refused += 1;
            self.crowded_out = Some((message.header.source_id, now_ns));
            return Err(RejectCause::TooManySources);
        };
        let others = self.slots.iter().enumerate().filter(|&(i, _)| i != place).map(|(_, s)| s.obstacles().len()).sum();
        let slot = &mut self.slots[place];
        if slot.log.taken_by(publisher).is_some() {
            slot.log.reject(RejectCause::TooManySources);
            slot.contested_ns = slot.declared.then_some(now_ns);
            return Err(RejectCause::TooManySources);
        }
        // `validate` overwrites the standard deviations only after the whole message was found valid.
        let checked =
            slot.log.check(&message.header, now_ns, limits).and_then(|()| validate(message, others, &mut slot.sigma_m));
        slot.log.settle(checked, &message.header, publisher)?;
        copy_used(&mut slot.set, message);
        if message.flags & FLAG_LEAVING != 0 {
            slot.log.forget();
            slot.used = slot.declared;
        }
        Ok(())
    }

    /// The other port that has the id of a source; `None` if this one may have it.
    pub fn taken_by(&self, source_id: u32, publisher: u128) -> Option<u128> {
        let slot = self.slots.iter().find(|s| s.used && s.log.source_id == source_id)?;
        slot.log.taken_by(publisher)
    }

    /// Notes that the port of a source is gone: another may take its id, and a run in lockstep does not wait for it.
    pub fn set_gone(&mut self, publisher: u128) {
        for slot in self.slots.iter_mut().filter(|s| s.used && s.log.publisher == publisher) {
            slot.log.gone = slot.log.last.is_some();
        }
    }

    /// Ports that are not known to be gone, 0 for none.
    pub fn publishers(&self) -> [u128; MAX_SOURCES] {
        self.slots.each_ref().map(|s| if s.used && !s.log.gone && s.log.last.is_some() { s.log.publisher } else { 0 })
    }

    /// What is known of a source; `None` if it never sent.
    pub fn log(&self, source_id: u32) -> Option<&SourceLog> {
        self.slots.iter().find(|s| s.used && s.log.source_id == source_id).map(|s| &s.log)
    }

    /// The source's place; a new source takes a free one, or that of one of whom nothing was ever accepted.
    fn place_of(&mut self, source_id: u32) -> Option<usize> {
        if let Some(place) = self.slots.iter().position(|s| s.used && s.log.source_id == source_id) {
            return Some(place);
        }
        let free = self
            .slots
            .iter()
            .position(|s| !s.used)
            .or_else(|| self.slots.iter().position(|s| !s.declared && s.log.last.is_none() && !s.log.refused))
            .or_else(|| self.slots.iter().position(|s| !s.declared && s.log.last.is_none()))?;
        let slot = &mut self.slots[free];
        slot.log = SourceLog::new(source_id);
        slot.used = true;
        Some(free)
    }

    /// Overwrites this table with another's content, copying only what is in use.
    pub fn copy_from(&mut self, other: &Self) {
        self.sources_refused = other.sources_refused;
        self.crowded_out = other.crowded_out;
        for (mine, theirs) in self.slots.iter_mut().zip(&other.slots) {
            mine.log = theirs.log;
            mine.declared = theirs.declared;
            mine.used = theirs.used;
            mine.contested_ns = theirs.contested_ns;
            copy_used(&mut mine.set, &theirs.set);
            let count = theirs.set.used().len();
            mine.sigma_m[..count].copy_from_slice(&theirs.sigma_m[..count]);
        }
    }

    /// Every obstacle at `now + lookahead`, grown. Does not allocate.
    ///
    /// Position: constant velocity from the capture time, but no longer than `hold_after_s` plus the lookahead: an obstacle
    /// must not fly off on an old velocity. From there on it grows by its speed in place of moving, so that wherever it
    /// went at that speed it is inside. Growth: `sigma_multiple sigma + growth_mps (age - stale_after_s) +
    /// speed (age - hold_after_s)`, the parts with the age only when positive and together at most `growth_m_max`.
    pub fn track_into(&self, now_ns: u64, lookahead_s: f64, limits: &InputLimits, tracked: &mut TrackedSet) {
        tracked.count = 0;
        for (place, slot) in self.slots.iter().enumerate() {
            let Some(header) = slot.log.last else { continue };
            // Signed: a capture time within the tolerated future is extrapolated by less.
            let age_s = elapsed_s(header.capture_ns, now_ns);
            let moves_s = age_s.min(limits.hold_after_s);
            let health = slot.log.health(now_ns, limits);
            for (o, sigma_m) in slot.set.used().iter().zip(&slot.sigma_m) {
                let (Some(kind), Some(out)) =
                    (ObstacleKind::from_wire(o.kind), tracked.obstacles.get_mut(tracked.count))
                else {
                    continue;
                };
                *out = TrackedObstacle {
                    source_id: slot.log.source_id,
                    id: o.id,
                    kind,
                    dimensions_m: o.dimensions_m,
                    position_m: std::array::from_fn(|i| o.position_m[i] + o.velocity_mps[i] * (moves_s + lookahead_s)),
                    quaternion: check::normalised(&o.quaternion),
                    velocity_mps: o.velocity_mps,
                    growth_m: limits.sigma_multiple * sigma_m + growth_by_age_m(o, age_s, limits),
                    health,
                    hull: (place as u8, o.hull_offset as u16, o.hull_count as u16),
                };
                tracked.count += 1;
            }
        }
    }

    /// Vertices of a tracked hull (m), obstacle frame; empty for other kinds.
    ///
    /// Valid together with the table that `obstacle` was tracked from.
    pub fn hull_vertices(&self, obstacle: &TrackedObstacle) -> &[[f64; 3]] {
        let (place, offset, count) = obstacle.hull;
        let range = usize::from(offset)..usize::from(offset) + usize::from(count);
        self.slots[usize::from(place)].set.vertices_m.get(range).unwrap_or(&[])
    }

    /// What the sources ask for at `now`.
    pub fn demand(&self, now_ns: u64, limits: &InputLimits) -> ObstacleDemand {
        for slot in self.slots.iter().filter(|s| s.used) {
            let hold = match slot.health(now_ns, limits) {
                SourceHealth::Fresh | SourceHealth::Held | SourceHealth::Stale => false,
                SourceHealth::Absent => slot.declared,
                // It sees something, perhaps, and nobody knows what.
                SourceHealth::Refused => true,
                SourceHealth::Expired => true,
            };
            if hold {
                return ObstacleDemand::Hold { source_id: slot.log.source_id };
            }
        }
        match self.crowded_out {
            Some((source_id, at_ns)) if elapsed_s(at_ns, now_ns) <= limits.hold_after_s => {
                ObstacleDemand::Hold { source_id }
            }
            _ => ObstacleDemand::Proceed,
        }
    }

    /// Whether the obstacles of an expired source have grown as far as they may.
    pub fn is_lost(&self, now_ns: u64, limits: &InputLimits) -> bool {
        self.slots.iter().filter(|s| s.used && !s.obstacles().is_empty()).any(|slot| {
            let age_s = slot.log.age_s(now_ns);
            let fastest = slot.obstacles().iter().map(|o| growth_by_age_m(o, age_s, limits)).fold(0.0, f64::max);
            slot.log.health(now_ns, limits) == SourceHealth::Expired && fastest >= limits.growth_m_max
        })
    }

    /// Forgets sources that are expired, or of whom nothing was ever accepted, and not declared, as the operator's `clear`
    /// asks, and tells their ids; their counters stay until the place is needed.
    pub fn forget_expired(&mut self, now_ns: u64, limits: &InputLimits, mut forgotten: impl FnMut(u32)) {
        for slot in &mut self.slots {
            let health = slot.log.health(now_ns, limits);
            let useless = [SourceHealth::Expired, SourceHealth::Refused].contains(&health);
            if slot.used && !slot.declared && useless {
                slot.log.forget();
                forgotten(slot.log.source_id);
            }
        }
    }

    /// Whether every given source has delivered a set for `tick` or later (lockstep).
    pub fn is_ready_for(&self, tick: u64, sources: &[u32]) -> bool {
        sources.iter().all(|&id| {
            let slot = self.slots.iter().find(|s| s.used && s.log.source_id == id);
            slot.is_some_and(|s| s.log.has_come_for(tick))
        })
    }

    /// Fills the obstacle sources' part of a tick's record.
    pub fn report_into(&self, now_ns: u64, limits: &InputLimits, state: &mut State) {
        state.stale_sources = 0;
        for (slot, report) in self.slots.iter().zip(&mut state.obstacle_sources) {
            let health = slot.health(now_ns, limits);
            *report = match slot.used {
                true => SourceReport { health: health.wire(), ..slot.log.report(now_ns, limits) },
                false => SourceReport::default(),
            };
            state.stale_sources +=
                u64::from(matches!(health, SourceHealth::Stale | SourceHealth::Expired | SourceHealth::Refused));
        }
        state.obstacle_sources_refused = self.sources_refused;
    }
}

/// Growth of an obstacle whose set has an age (s).
fn growth_by_age_m(o: &Obstacle, age_s: f64, limits: &InputLimits) -> f64 {
    let speed = o.velocity_mps.iter().map(|v| v * v).sum::<f64>().sqrt();
    let growth =
        limits.growth_mps * (age_s - limits.stale_after_s).max(0.0) + speed * (age_s - limits.hold_after_s).max(0.0);
    growth.min(limits.growth_m_max)
}

fn copy_used(to: &mut Obstacles, from: &Obstacles) {
    let (count, vertices) = (from.used().len(), (from.vertex_count as usize).min(MAX_VERTICES));
    to.header = from.header;
    (to.count, to.vertex_count, to.flags) = (count as u32, vertices as u32, from.flags);
    to.obstacles[..count].copy_from_slice(&from.obstacles[..count]);
    to.vertices_m[..vertices].copy_from_slice(&from.vertices_m[..vertices]);
}

/// Checks the content of a set; on success alone, `sigma_m` holds the standard deviations.
fn validate(message: &Obstacles, others: usize, sigma_m: &mut [f64; MAX_OBSTACLES]) -> Result<(), RejectCause> {
    let count = message.count as usize;
    if count > MAX_OBSTACLES || message.vertex_count as usize > MAX_VERTICES || others + count > MAX_TRACKED {
        return Err(RejectCause::Overfull);
    }
    if message.flags & FLAG_LEAVING != 0 && count != 0 {
        return Err(RejectCause::UnknownKind);
    }
    let mut sigma = [0.0; MAX_OBSTACLES];
    for (i, o) in message.used().iter().enumerate() {
        validate_one(o, message)?;
        sigma[i] = check::largest_sigma(&o.covariance_m2)?;
        if message.obstacles[..i].iter().any(|other| other.id == o.id) {
            return Err(RejectCause::DuplicateId);
        }
    }
    *sigma_m = sigma;
    Ok(())
}

fn validate_one(o: &Obstacle, message: &Obstacles) -> Result<(), RejectCause> {
    let kind = ObstacleKind::from_wire(o.kind).ok_or(RejectCause::UnknownKind)?;
    check::coordinates(&o.position_m)?;
    check::coordinates(&o.velocity_mps)?;
    check::quaternion(&o.quaternion)?;
    check::finite(&o.dimensions_m)?;
    let d = &o.dimensions_m;
    match kind {
        ObstacleKind::Ball => check::lengths(&d[..1]),
        ObstacleKind::Capsule => check::lengths(&d[..2]),
        ObstacleKind::Box => check::lengths(d),
        ObstacleKind::HalfSpace => Ok(()),
        ObstacleKind::Hull => {
            let (start, count) = (o.hull_offset as usize, o.hull_count as usize);
            let used = &message.vertices_m[..message.vertex_count as usize];
            let vertices = start.checked_add(count).and_then(|end| used.get(start..end));
            check::hull(vertices.ok_or(RejectCause::Hull)?)
        }
    }
}

#[cfg(test)]
#[path = "obstacles_tests.rs"]
mod tests;
