use super::super::link::{DrivesEnd, drives_link};
use super::super::obstacles::pairs;
use super::super::setup::{master_config, motor_bank};
use super::*;
use crate::config::builtin_texts;
use crate::control::Settings;
use crate::estimator::Observer;
use crate::ipc::payload::{Obstacle, Obstacles, SupervisorState};
use crate::ipc::{ChannelCapacity, IoEnds, channels};
use rand::SeedableRng;
use sinew_hal::cia402::Master;
use sinew_hal::memory_bus::MemoryBus;

const NOW: u64 = 1_000_000_000;
const SPEED_MPS: f64 = 0.5;

/// A controller whose channels end in the test's hands.
struct Bench {
    controller: Controller<Observer>,
    writer: CycleWriter,
    ends: IoEnds,
    drives: DrivesEnd,
}

impl Bench {
    /// With a ball beside the arm that flies past, measured at [`NOW`].
    /// Two of them do not fit into the stack of a test beside what makes them.
    #[inline(never)]
    fn new(latency_ticks: usize) -> Self {
        let mut config = Config::parse(builtin_texts("drives.toml")).unwrap();
        config.observer.latency_ticks = latency_ticks;
        let (inputs, outputs, mut ends, _) = channels(24, 4, &[], ChannelCapacity::default());
        let (mut builder, obstacles) = pairs(8);
        let mut set = Obstacles { header: Header::new(3, 0, NOW), ..Obstacles::default() };
        let ball = Obstacle::ball(1, [0.3, 0.1, -1.0], 0.1);
        assert!(set.push(Obstacle { velocity_mps: [SPEED_MPS, 0.0, 0.0], ..ball }));
        ends.obstacles.input_buffer_mut().accept(&set, NOW, &InputLimits::default()).unwrap();
        ends.obstacles.publish();
        builder.accept(&set);
        let (link, drives) = drives_link();
        let mut master = Master::new(master_config(&config).unwrap(), vec![Box::new(MemoryBus::default())]).unwrap();
        let parts = Parts {
            cycle: Cycle::new(
                &Settings::new(&config),
                Observer::new(&config.arm, &config.observer, config.timing.period_s),
            ),
            inputs,
            outputs,
            obstacles,
            drives: link,
            bank: motor_bank(&config).unwrap(),
            time: LoopTime::new(true),
            rng: Xoshiro256PlusPlus::seed_from_u64(0),
            auto: AutoRequests::default(),
        };
        Self { controller: Controller::new(&config, parts), writer: master.take_writer().unwrap(), ends, drives }
    }

    fn tick(&mut self) -> State {
        let time = TickTime {
            tick: 0,
            now_ns: NOW,
            woke_ns: monotonic_ns(),
            wakeup_ns: 0,
            missed: 0,
            budget: None,
            left_out: 0,
        };
        self.controller.tick(&time, false, &mut self.writer);
        self.ends.records.pop().unwrap()
    }

    /// Where the ball is in both sets (m along its way).
    fn x(&self) -> [f64; 2] {
        let pair = self.controller.obstacles.pair();
        [pair.now(), pair.ahead()].map(|set| set.as_slice()[0].position().x)
    }
}

#[test]
fn the_planner_has_obstacles_where_they_are_when_its_tensions_act_and_the_record_where_they_are_at_the_tick() {
    // Two controllers on one stack are more than a test's thread has.
    let thread = std::thread::Builder::new().stack_size(16 << 20).spawn(planner_and_record).unwrap();
    thread.join().unwrap();
}

fn planner_and_record() {
    let (mut without, mut late) = (Bench::new(0), Bench::new(3));
    let (period_s, lookahead_s) = (late.controller.period_ns as f64 * 1e-9, late.controller.lookahead_s);
    for (bench, latency_s) in [(&mut without, 0.0), (&mut late, 3.0 * period_s)] {
        bench.controller.inputs.update();
        assert_eq!(bench.controller.place_obstacles(NOW), ObstacleDemand::Proceed);
        let [now, ahead] = bench.x();
        assert!((now - (0.3 + SPEED_MPS * latency_s)).abs() < 1e-12, "{now}");
        assert!((ahead - (0.3 + SPEED_MPS * (latency_s + lookahead_s))).abs() < 1e-12, "{ahead}");
    }
    let distances = [&mut without, &mut late].map(|bench| {
        let state = bench.tick();
        assert_eq!(state.distance_count, 1);
        state.distances[0].surface_distance_m
    });
    assert_eq!(distances[0], distances[1], "state and obstacles of a record are of one time");
    // Had it been measured where the planner had it, it would be another distance by far more than rounding.
    assert!(SPEED_MPS * 3.0 * period_s > 1e-3);
}

#[test]
fn a_slow_map_of_obstacles_leaves_targets_as_they_are_and_their_own_keys_rule_them() {
    let mut config = Config::parse(builtin_texts("drives.toml")).unwrap();
    let before = limits(&config, false);
    assert_eq!((before.target.stale_after_s, before.target.hold_after_s), (0.2, 1.0));
    // A static map that comes every 20 s.
    (config.obstacles.stale_after_s, config.obstacles.hold_after_s) = (30.0, 60.0);
    config.obstacles.future_tolerance_s = 0.5;
    let slow = limits(&config, false);
    assert_eq!((slow.obstacles.stale_after_s, slow.obstacles.hold_after_s), (30.0, 60.0));
    assert_eq!(slow.target, before.target);
    (config.target.stale_after_s, config.target.hold_after_s) = (0.3, 2.0);
    config.target.future_tolerance_s = 0.25;
    let own = limits(&config, false);
    let target = own.target;
    assert_eq!((target.stale_after_s, target.hold_after_s, target.future_tolerance_s), (0.3, 2.0, 0.25));
    assert_eq!(own.obstacles, slow.obstacles);
}

#[test]
fn arming_on_start_waits_for_the_bus_and_is_not_spent_on_a_refusal() {
    let mut bench = Bench::new(0);
    bench.controller.auto.arm = true;
    let ready = DrivesInput { ready: true, ..DrivesInput::default() };
    let not_yet = [
        DrivesInput { ready: false, ..ready },
        DrivesInput { bus_lost: Some(0), ..ready },
        DrivesInput { fault: Some((3, 0x1234)), ..ready },
    ];
    for drives in not_yet {
        bench.drives.write(drives);
        assert_eq!(bench.tick().supervisor, SupervisorState::Disarmed.wire(), "{drives:?}");
        assert!(bench.controller.auto.arm, "{drives:?}");
    }
    bench.drives.write(ready);
    assert_eq!(bench.tick().supervisor, SupervisorState::Arming.wire());
    assert!(!bench.controller.auto.arm);
}
