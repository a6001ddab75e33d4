//! Obstacles from shared memory to the planner: shapes are built on the I/O thread, poses are set on the control thread.
//!
//! A hull costs allocations, so a pair of obstacle sets is built where a message was accepted and only when shapes, ids
//! or their number changed. It travels through a triple buffer, whose slots come back to the builder. On the control
//! thread each obstacle of the pair is moved to where the newest table says it is when the tick's tensions begin to act
//! and at the end of the lookahead. The pair is published before the table that belongs to it, so it is never older; an
//! obstacle that the table does not know is parked far away, and one for which there is no place asks for a hold.

use crate::collision::{OBSTACLES_MAX, Shape};
use crate::config::ShapeConfig;
use crate::control::ObstaclePair;
use crate::control::obstacles::Placement;
use crate::ipc::intake::{InputLimits, ObstacleTable, TrackedObstacle, TrackedSet};
use crate::ipc::payload::{FLAG_LEAVING, MAX_SOURCES, Obstacle, ObstacleKind, Obstacles};
use triple_buffer::{Input, Output, triple_buffer};

/// Where an obstacle without a pose waits (m, base frame): out of every arm's reach.
const PARKED_M: [f64; 3] = [0.0, 0.0, -1e4];

/// Source and id of an obstacle as one number, as the planner's sets have it.
pub const fn key(source_id: u32, id: u32) -> u64 {
    (source_id as u64) << 32 | id as u64
}

/// Source and id of a [`key`].
pub const fn unkey(key: u64) -> (u32, u32) {
    ((key >> 32) as u32, key as u32)
}

/// What travels.
#[derive(Debug, Clone, Default)]
struct Built {
    pair: ObstaclePair,
    /// Key of each obstacle of the pair.
    keys: Vec<u64>,
    /// First source with an obstacle that found no place.
    overfull: Option<u32>,
}

/// What makes the obstacles of a source another set of shapes.
#[derive(Debug, Clone, PartialEq)]
struct Outline {
    id: u32,
    kind: u32,
    dimensions_m: [f64; 3],
    vertices_m: Vec<[f64; 3]>,
}

/// Builds pairs, on the I/O thread.
#[derive(Debug)]
pub struct PairBuilder {
    capacity: usize,
    /// By source id, so that the order of arrival does not matter.
    sources: Vec<(u32, Vec<Outline>)>,
    out: Input<Built>,
}

/// Places obstacles, on the control thread.
#[derive(Debug)]
pub struct PairReader {
    built: Output<Built>,
    now: TrackedSet,
    ahead: TrackedSet,
    parked: [bool; OBSTACLES_MAX],
}

/// Both ends, for at most `capacity` obstacles of all sources together.
pub fn pairs(capacity: usize) -> (PairBuilder, PairReader) {
    let initial = Built { pair: ObstaclePair::new(), keys: Vec::with_capacity(OBSTACLES_MAX), overfull: None };
    let (out, built) = triple_buffer(&initial);
    (
        PairBuilder { capacity: capacity.min(OBSTACLES_MAX), sources: Vec::new(), out },
        PairReader { built, now: TrackedSet::new(), ahead: TrackedSet::new(), parked: [false; OBSTACLES_MAX] },
    )
}

impl PairBuilder {
    /// Takes over an accepted set; publishes a new pair if the shapes are others than before.
    pub fn accept(&mut self, message: &Obstacles) {
        let source = message.header.source_id;
        let outlines: Vec<Outline> = message.used().iter().map(|o| outline(o, message)).collect();
        let place = self.sources.binary_search_by_key(&source, |s| s.0);
        match place {
            _ if message.flags & FLAG_LEAVING != 0 => match place {
                Ok(place) => drop(self.sources.remove(place)),
                Err(_) => return,
            },
            Ok(place) if self.sources[place].1 == outlines => return,
            Ok(place) => self.sources[place].1 = outlines,
            Err(place) => {
                // The table has places for so many sources; whoever is beyond them was not accepted, or has left its
                // place to another one, which the table no longer tracks.
                if self.sources.len() >= 2 * MAX_SOURCES {
                    self.sources.retain(|s| !s.1.is_empty());
                }
                let place = place.min(self.sources.len());
                self.sources.insert(place, (source, outlines));
                self.sources.sort_by_key(|s| s.0);
            }
        }
        self.build();
    }

    /// Takes out a source that the table has forgotten: what it outlined needs its places no more.
    pub fn forget(&mut self, source_id: u32) {
        if let Ok(place) = self.sources.binary_search_by_key(&source_id, |s| s.0) {
            self.sources.remove(place);
            self.build();
        }
    }

    fn build(&mut self) {
        let built = self.out.input_buffer_mut();
        built.pair.clear();
        built.keys.clear();
        built.overfull = None;
        for (source, outline) in self.sources.iter().flat_map(|(source, o)| o.iter().map(move |o| (*source, o))) {
            let full = built.keys.len() >= self.capacity;
            let shape = outline.shape();
            match shape {
                Some(shape) if !full && built.pair.insert(key(source, outline.id), &shape).is_ok() => {
                    built.keys.push(key(source, outline.id));
                }
                // Also a shape that the intake passed and the planner refuses: unknown is not absent.
                _ => built.overfull = built.overfull.or(Some(source)),
            }
        }
        self.out.publish();
    }
}

fn outline(o: &Obstacle, message: &Obstacles) -> Outline {
    let range = o.hull_offset as usize..o.hull_offset as usize + o.hull_count as usize;
    let vertices_m = message.vertices_m.get(range).unwrap_or(&[]).to_vec();
    Outline { id: o.id, kind: o.kind, dimensions_m: o.dimensions_m, vertices_m }
}

impl Outline {
    fn shape(&self) -> Option<Shape> {
        let d = self.dimensions_m;
        let config = match ObstacleKind::from_wire(self.kind)? {
            ObstacleKind::Ball => ShapeConfig::Ball { radius_m: d[0] },
            ObstacleKind::Capsule => ShapeConfig::Capsule { half_length_m: d[0], radius_m: d[1] },
            ObstacleKind::Box => ShapeConfig::Box { half_extents_m: d },
            ObstacleKind::HalfSpace => ShapeConfig::HalfSpace,
            ObstacleKind::Hull => ShapeConfig::Hull { points_m: self.vertices_m.clone() },
        };
        Shape::new(&config).ok()
    }
}

impl PairReader {
    /// Takes over the newest pair and moves its obstacles to where `table` has them `after_s` (s) after `now_ns`: the two
    /// times of the pair. Call it after the table was taken over. Returns the first source with an obstacle that has no
    /// place. Does not allocate.
    pub fn place(
        &mut self,
        table: &ObstacleTable,
        now_ns: u64,
        after_s: [f64; 2],
        limits: &InputLimits,
    ) -> Option<u32> {
        self.built.update();
        self.move_to(table, now_ns, after_s, limits)
    }

    /// Moves the obstacles of the last [`Self::place`], with the same table, to two other times. Does not allocate.
    pub fn move_to(
        &mut self,
        table: &ObstacleTable,
        now_ns: u64,
        [now_s, ahead_s]: [f64; 2],
        limits: &InputLimits,
    ) -> Option<u32> {
        table.track_into(now_ns, now_s, limits, &mut self.now);
        table.track_into(now_ns, ahead_s, limits, &mut self.ahead);
        let (now, ahead) = (self.now.as_slice(), self.ahead.as_slice());
        let built = self.built.output_buffer_mut();
        let mut unplaced = built.overfull;
        for (index, &key) in built.keys.iter().enumerate() {
            let tracked = find(now, index, key).and_then(|place| now.get(place).zip(ahead.get(place)));
            let placement = match tracked {
                Some((now, ahead)) => Placement {
                    position_now_m: now.position_m,
                    position_ahead_m: ahead.position_m,
                    quaternion: now.quaternion,
                    growth_m: now.growth_m,
                },
                None => Placement {
                    position_now_m: PARKED_M,
                    position_ahead_m: PARKED_M,
                    quaternion: [1.0, 0.0, 0.0, 0.0],
                    growth_m: 0.0,
                },
            };
            self.parked[index] = tracked.is_none();
            if built.pair.place(index, &placement).is_err() {
                unplaced = unplaced.or(Some(unkey(key).0));
            }
        }
        unplaced
    }

    /// The obstacles as last placed.
    pub fn pair(&self) -> &ObstaclePair {
        &self.built.output_buffer().pair
    }

    /// Whether the obstacle of an index is parked, hence in no report.
    pub fn is_parked(&self, index: usize) -> bool {
        self.parked.get(index).copied().unwrap_or(true)
    }
}

/// Place of an obstacle among the tracked ones, most often its own index.
fn find(tracked: &[TrackedObstacle], index: usize, wanted: u64) -> Option<usize> {
    let is = |o: &TrackedObstacle| key(o.source_id, o.id) == wanted;
    if tracked.get(index).is_some_and(is) { Some(index) } else { tracked.iter().position(is) }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::ipc::payload::Header;

    const NOW: u64 = 1_000_000_000;
    const CUBE: [[f64; 3]; 4] = [[0.0; 3], [0.1, 0.0, 0.0], [0.0, 0.1, 0.0], [0.0, 0.0, 0.1]];

    fn set(source: u32, sequence: u64, obstacles: &[Obstacle]) -> Obstacles {
        let mut set = Obstacles { header: Header::new(source, sequence, NOW), ..Obstacles::default() };
        obstacles.iter().for_each(|o| assert!(set.push(*o)));
        set
    }

    fn ball(id: u32, x: f64) -> Obstacle {
        Obstacle::ball(id, [x, 0.0, 0.0], 0.1)
    }

    struct Bench {
        table: ObstacleTable,
        builder: PairBuilder,
        reader: PairReader,
    }

    impl Bench {
        fn new(capacity: usize) -> Self {
            let (builder, reader) = pairs(capacity);
            Self { table: ObstacleTable::new(&[]), builder, reader }
        }

        fn send(&mut self, message: &Obstacles) {
            self.table.accept(message, NOW, &InputLimits::default()).unwrap();
            self.builder.accept(message);
        }

        fn place(&mut self) -> (Vec<(u64, f64, bool)>, Option<u32>) {
            let unplaced = self.reader.place(&self.table, NOW, [0.0, 0.1], &InputLimits::default());
            let now = self.reader.pair().now().as_slice();
            (
                now.iter().enumerate().map(|(i, o)| (o.id(), o.position().x, self.reader.is_parked(i))).collect(),
                unplaced,
            )
        }
    }

    #[test]
    fn obstacles_of_two_sources_stand_in_the_order_of_their_sources() {
        for order in [[3, 9], [9, 3]] {
            let mut bench = Bench::new(64);
            order.iter().for_each(|&s| bench.send(&set(s, 0, &[ball(1, f64::from(s))])));
            assert_eq!(bench.place(), (vec![(key(3, 1), 3.0, false), (key(9, 1), 9.0, false)], None));
        }
    }

    #[test]
    fn an_obstacle_is_placed_ahead_by_its_velocity() {
        let mut bench = Bench::new(64);
        let moving = Obstacle { velocity_mps: [2.0, 0.0, 0.0], ..ball(1, 1.0) };
        bench.send(&set(3, 0, &[moving]));
        bench.place();
        let pair = bench.reader.pair();
        assert!((pair.ahead().as_slice()[0].position().x - 1.2).abs() < 1e-12);
        assert!((pair.now().as_slice()[0].position().x - 1.0).abs() < 1e-12);
    }

    #[test]
    fn both_times_of_the_pair_are_later_by_the_latency_and_the_tick_can_be_asked_for_afterwards() {
        let mut bench = Bench::new(64);
        bench.send(&set(3, 0, &[Obstacle { velocity_mps: [2.0, 0.0, 0.0], ..ball(1, 1.0) }]));
        let at = |reader: &PairReader| {
            let pair = reader.pair();
            [pair.now(), pair.ahead()].map(|set| (1e6 * set.as_slice()[0].position().x).round() as i64)
        };
        assert_eq!(bench.reader.place(&bench.table, NOW, [0.03, 0.13], &InputLimits::default()), None);
        assert_eq!(at(&bench.reader), [1_060_000, 1_260_000]);
        assert_eq!(bench.reader.move_to(&bench.table, NOW, [0.0, 0.1], &InputLimits::default()), None);
        assert_eq!(at(&bench.reader), [1_000_000, 1_200_000]);
    }

    #[test]
    fn moving_builds_nothing_and_another_shape_does() {
        let mut bench = Bench::new(64);
        bench.send(&set(3, 0, &[ball(1, 0.0)]));
        bench.place();
        bench.send(&set(3, 1, &[ball(1, 0.5)]));
        assert!(!bench.reader.built.updated(), "the same shape at another place");
        assert_eq!(bench.place().0, [(key(3, 1), 0.5, false)]);
        bench.send(&set(3, 2, &[Obstacle::ball(1, [0.5, 0.0, 0.0], 0.2)]));
        assert!(bench.reader.built.updated());
    }

    #[test]
    fn a_source_that_leaves_takes_its_obstacles_along() {
        let mut bench = Bench::new(64);
        bench.send(&set(3, 0, &[ball(1, 0.0)]));
        let mut leaving = set(3, 1, &[]);
        leaving.flags = FLAG_LEAVING;
        bench.send(&leaving);
        assert_eq!(bench.place(), (vec![], None));
    }

    #[test]
    fn an_obstacle_that_the_table_does_not_know_is_parked() {
        let mut bench = Bench::new(64);
        bench.builder.accept(&set(3, 0, &[ball(1, 0.0)]));
        assert_eq!(bench.place().0, [(key(3, 1), 0.0, true)]);
        assert_eq!(bench.reader.pair().now().as_slice()[0].position().z, PARKED_M[2]);
    }

    #[test]
    fn more_obstacles_than_places_name_their_source() {
        let mut bench = Bench::new(2);
        bench.send(&set(3, 0, &[ball(1, 0.0), ball(2, 0.0)]));
        assert_eq!(bench.place().1, None);
        bench.send(&set(9, 0, &[ball(1, 0.0)]));
        assert_eq!(bench.place().1, Some(9));
    }

    #[test]
    fn a_forgotten_source_gives_its_places_back_and_may_return() {
        let mut bench = Bench::new(2);
        bench.send(&set(3, 0, &[ball(1, 3.0), ball(2, 3.0)]));
        bench.send(&set(9, 0, &[ball(1, 9.0)]));
        assert_eq!(bench.place().1, Some(9));
        let later = NOW + 10_000_000_000;
        let mut fresh = set(9, 1, &[ball(1, 9.0)]);
        fresh.header.capture_ns = later;
        bench.table.accept(&fresh, later, &InputLimits::default()).unwrap();
        bench.builder.accept(&fresh);
        let mut forgotten = Vec::new();
        bench.table.forget_expired(later, &InputLimits::default(), |source| forgotten.push(source));
        assert_eq!(forgotten, [3]);
        bench.builder.forget(3);
        bench.builder.forget(4);
        assert_eq!(bench.place(), (vec![(key(9, 1), 9.0, false)], None));
        bench.builder.accept(&set(3, 1, &[ball(1, 3.0)]));
        assert_eq!(bench.place().0.len(), 2);
    }

    #[test]
    fn a_hull_comes_from_the_pool_and_placing_it_allocates_nothing() {
        let mut bench = Bench::new(64);
        let mut message = set(3, 0, &[]);
        assert!(message.push_hull(Obstacle::new(5, ObstacleKind::Hull, [1.0, 0.0, 0.0], [0.0; 3]), &CUBE));
        bench.send(&message);
        assert_no_alloc::assert_no_alloc(|| {
            bench.reader.place(&bench.table, NOW, [0.02, 0.12], &InputLimits::default())
        });
        let pair = bench.reader.pair();
        let (distance, _) = pair.now().as_slice()[0].distance(&nalgebra::Vector3::new(1.0, 0.0, -0.05));
        assert!((distance - 0.05).abs() < 1e-6, "{distance}");
    }
}
