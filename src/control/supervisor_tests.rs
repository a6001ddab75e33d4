//! Every row of the tables in the module's documentation.

use super::*;

const SECOND: u64 = 1_000_000_000;

const ENABLED: DrivesInput =
    DrivesInput { phase: DrivesPhase::Enabled, ready: true, fault: None, bus_lost: None, emergency_stop: None };
const OFF: DrivesInput =
    DrivesInput { phase: DrivesPhase::Off, ready: true, fault: None, bus_lost: None, emergency_stop: None };

fn supervisor() -> Supervisor {
    let config = crate::config::Config::builtin();
    let timing = LoopConfig { overruns_fault: 5, ..config.timing };
    Supervisor::new(&timing, &config.observer, false, false)
}

/// Everything as it should be while the arm is under power.
fn well() -> Observed {
    Observed {
        tick: 1,
        now_ns: SECOND,
        request: None,
        drives: ENABLED,
        faults: FaultList::default(),
        progress: Progress::Done,
        target_fresh: true,
        obstacles: ObstacleDemand::Proceed,
        hold: None,
        unreachable: false,
        at_safe_tension: false,
        at_home: false,
        lowered: true,
        bent: false,
        moves: false,
        missed: 0,
    }
}

fn with(fault: Fault) -> Observed {
    let mut faults = FaultList::default();
    faults.push(fault);
    Observed { faults, ..well() }
}

const SILENT: Fault = Fault::EncoderSilent { cable: 3, age_s: 0.06 };
const HOLD: ObstacleDemand = ObstacleDemand::Hold { source: 4 };

/// A supervisor that was led into a mode by ordinary means.
fn in_mode(mode: Mode) -> Supervisor {
    let mut s = supervisor();
    if mode == Mode::Disarmed {
        return s;
    }
    let starting = Observed { progress: Progress::Drives, ..well() };
    s.step(&Observed { request: Some(Request::Arm), drives: OFF, ..starting });
    if mode == Mode::Starting {
        assert_eq!(s.mode(), mode);
        return s;
    }
    s.step(&well());
    match mode {
        Mode::Tracking => _ = s.step(&Observed { request: Some(Request::Track), ..well() }),
        Mode::Homing => _ = s.step(&Observed { request: Some(Request::Home), ..well() }),
        Mode::Stopping => _ = s.step(&Observed { request: Some(Request::Stop), ..well() }),
        Mode::Faulted => _ = s.step(&with(SILENT)),
        _ => {}
    }
    assert_eq!(s.mode(), mode);
    s
}

/// Asks in a mode; the mode afterwards, or the refusal.
fn ask(mode: Mode, request: Request, seen: &Observed) -> Result<Mode, Refusal> {
    let mut s = in_mode(mode);
    // A start that is done would go on by itself.
    let progress = if mode == Mode::Starting { Progress::Drives } else { seen.progress };
    let decision = s.step(&Observed { request: Some(request), progress, ..*seen });
    let answer = decision.answer.expect("every request is answered");
    assert_eq!(answer.request, request);
    match answer.refusal {
        None => Ok(s.mode()),
        Some(refusal) => {
            assert_eq!(s.mode(), mode, "a refused request changes nothing");
            Err(refusal)
        }
    }
}

#[test]
fn a_target_that_is_refused_leads_to_a_hold_that_tells_why() {
    let mut supervisor = in_mode(Mode::Tracking);
    let decision = supervisor.step(&Observed { unreachable: true, ..well() });
    assert_eq!((supervisor.mode(), decision.action), (Mode::Holding, Action::Hold));
    assert!(decision.limits.contains(Limit::OutOfReach));
    assert!(supervisor.step(&well()).limits.contains(Limit::OutOfReach), "as long as it holds for it");
    let decision = supervisor.step(&Observed { request: Some(Request::Track), ..well() });
    assert!(supervisor.mode() == Mode::Tracking && !decision.limits.contains(Limit::OutOfReach));
}

#[test]
fn a_stop_lowers_the_arm_before_it_lets_go_and_tells_disarmed_only_of_one_at_rest() {
    let going = Observed { lowered: false, ..well() };
    for mode in [Mode::Holding, Mode::Tracking, Mode::Homing] {
        let mut s = in_mode(mode);
        let decision = s.step(&Observed { request: Some(Request::Stop), ..going });
        assert_eq!((s.mode(), decision.action, s.is_planning()), (Mode::Stopping, Action::Lower, true));
        // However long the way is blocked.
        for _ in 0..1000 {
            assert_eq!(s.step(&going).action, Action::Lower);
        }
        assert_eq!(s.step(&well()).action, Action::Ramp, "there");
        assert_eq!(s.step(&Observed { at_safe_tension: true, ..well() }).action, Action::Off);
        let off = DrivesInput { phase: DrivesPhase::Off, ..ENABLED };
        s.step(&Observed { drives: off, moves: true, ..well() });
        assert_eq!(s.mode(), Mode::Stopping, "it still swings");
        s.step(&Observed { drives: off, ..well() });
        assert_eq!(s.mode(), Mode::Disarmed);
    }
    // Without power over it nothing is lowered, and torque is taken off at once where that is asked for.
    let mut s = in_mode(Mode::Holding);
    s.step(&Observed { request: Some(Request::Stop), ..going });
    assert_eq!(s.step(&Observed { request: Some(Request::Disarm), ..going }).action, Action::Off);
    let mut s = in_mode(Mode::Starting);
    assert_eq!(
        s.step(&Observed { request: Some(Request::Stop), progress: Progress::Settling, ..going }).action,
        Action::Ramp
    );
}

#[test]
fn a_stop_of_an_arm_that_its_start_tensions_bend_lowers_it_once_it_is_known() {
    let bent = Observed { bent: true, progress: Progress::Settling, lowered: false, ..well() };
    let stopped = || {
        let mut s = in_mode(Mode::Starting);
        let decision = s.step(&Observed { request: Some(Request::Stop), ..bent });
        assert_eq!((s.mode(), decision.action), (Mode::Stopping, Action::Tighten));
        assert_eq!(s.step(&bent).action, Action::Tighten);
        s
    };
    let mut s = stopped();
    let known = Observed { progress: Progress::Done, ..bent };
    assert_eq!((s.step(&known).action, s.mode()), (Action::Lower, Mode::Stopping));
    assert_eq!(s.step(&Observed { lowered: true, ..known }).action, Action::Ramp);
    // One that never becomes known is a fault, as in a start; one that is not to be waited for is let go of.
    let mut s = stopped();
    s.step(&Observed { now_ns: 100 * SECOND, ..bent });
    assert!(matches!(s.latch().first.map(|l| l.fault), Some(Fault::NotSettled { .. })), "{:?}", s.latch().first);
    let mut s = stopped();
    assert_eq!(s.step(&Observed { request: Some(Request::Disarm), ..bent }).action, Action::Off);
}

#[test]
fn an_arm_that_moves_is_not_armed_and_one_that_rests_elsewhere_is_raised_to_its_start() {
    let mut s = in_mode(Mode::Disarmed);
    let arm = Observed { request: Some(Request::Arm), ..well() };
    let answer = s.step(&Observed { moves: true, ..arm }).answer.expect("an answer");
    assert_eq!((answer.refusal, s.mode()), (Some(Refusal::NotAtRest), Mode::Disarmed));
    s.step(&arm);
    let raising = Observed { progress: Progress::Posture, now_ns: 100 * SECOND, ..well() };
    assert_eq!(s.step(&Observed { now_ns: SECOND, ..raising }).action, Action::Raise);
    assert_eq!((s.step(&raising).action, s.mode()), (Action::Raise, Mode::Starting), "a way takes its time");
    s.step(&well());
    assert_eq!(s.mode(), Mode::Holding);
}

#[test]
fn every_request_in_every_mode_has_the_answer_of_the_table() {
    use Mode::*;
    use Refusal as R;
    type Row = (Mode, [Result<Mode, Refusal>; 7]);
    // Columns: arm, disarm, hold, track, home, stop, clear; all inputs as they should be.
    let table: [Row; 7] = [
        (
            Disarmed,
            [
                Ok(Starting),
                Ok(Disarmed),
                Err(R::Disarmed),
                Err(R::Disarmed),
                Err(R::Disarmed),
                Ok(Disarmed),
                Err(R::NothingLatched),
            ],
        ),
        (
            Starting,
            [
                Ok(Starting),
                Ok(Stopping),
                Ok(Starting),
                Err(R::NotSettled),
                Err(R::NotSettled),
                Ok(Stopping),
                Err(R::NothingLatched),
            ],
        ),
        (
            Holding,
            [Ok(Holding), Ok(Stopping), Ok(Holding), Ok(Tracking), Ok(Homing), Ok(Stopping), Err(R::NothingLatched)],
        ),
        (
            Tracking,
            [Ok(Tracking), Ok(Stopping), Ok(Holding), Ok(Tracking), Ok(Homing), Ok(Stopping), Err(R::NothingLatched)],
        ),
        (
            Homing,
            [Ok(Homing), Ok(Stopping), Ok(Holding), Ok(Tracking), Ok(Homing), Ok(Stopping), Err(R::NothingLatched)],
        ),
        (
            Stopping,
            [
                Err(R::Stopping),
                Ok(Stopping),
                Err(R::Stopping),
                Err(R::Stopping),
                Err(R::Stopping),
                Ok(Stopping),
                Err(R::NothingLatched),
            ],
        ),
        (
            Faulted,
            [
                Err(R::Faulted),
                Ok(Faulted),
                Err(R::Faulted),
                Err(R::Faulted),
                Err(R::Faulted),
                Ok(Faulted),
                Err(R::StillRamping),
            ],
        ),
    ];
    assert_eq!(table.map(|row| row.0), Mode::ALL);
    for (mode, row) in table {
        for (request, want) in Request::ALL.into_iter().zip(row) {
            assert_eq!(ask(mode, request, &well()), want, "{request:?} while {mode:?}");
        }
    }
}

#[test]
fn arming_needs_drives_that_are_ready_and_a_bus() {
    for drives in [
        DrivesInput { ready: false, ..OFF },
        DrivesInput { fault: Some((2, 7)), ..OFF },
        DrivesInput { bus_lost: Some(1), ..OFF },
    ] {
        let seen = Observed { drives, ..well() };
        assert_eq!(ask(Mode::Disarmed, Request::Arm, &seen), Err(Refusal::DrivesNotReady), "{drives:?}");
    }
}

#[test]
fn tracking_needs_a_fresh_target_and_known_obstacles_and_homing_needs_known_obstacles() {
    let no_target = Observed { target_fresh: false, ..well() };
    let expired = Observed { obstacles: HOLD, ..well() };
    assert_eq!(ask(Mode::Holding, Request::Track, &no_target), Err(Refusal::NoTarget));
    assert_eq!(ask(Mode::Homing, Request::Track, &no_target), Err(Refusal::NoTarget));
    assert_eq!(ask(Mode::Holding, Request::Home, &no_target), Ok(Mode::Homing));
    assert_eq!(ask(Mode::Holding, Request::Track, &expired), Err(Refusal::ObstaclesExpired));
    assert_eq!(ask(Mode::Holding, Request::Home, &expired), Err(Refusal::ObstaclesExpired));
}

#[test]
fn a_start_that_is_done_becomes_a_hold_and_one_that_is_not_stays() {
    for progress in [Progress::Drives, Progress::Tensions, Progress::Encoder(1, 0.1), Progress::Settling] {
        let mut s = in_mode(Mode::Starting);
        let decision = s.step(&Observed { progress, ..well() });
        assert_eq!((s.mode(), decision.action), (Mode::Starting, Action::Tighten));
    }
    let mut s = in_mode(Mode::Starting);
    assert_eq!(s.step(&well()).action, Action::Hold);
    assert_eq!(s.mode(), Mode::Holding);
}

#[test]
fn a_start_that_takes_too_long_is_a_fault_by_what_is_missing() {
    let end_ns = SECOND + seconds_to_ns(crate::config::Config::builtin().observer.settle_timeout_s);
    for (progress, code) in
        [(Progress::Drives, 12), (Progress::Encoder(5, 0.2), 20), (Progress::Tensions, 32), (Progress::Settling, 32)]
    {
        let mut s = in_mode(Mode::Starting);
        s.step(&Observed { progress, now_ns: end_ns, ..well() });
        assert_eq!(s.mode(), Mode::Starting, "there is still time");
        s.step(&Observed { progress, now_ns: end_ns + 1, ..well() });
        assert_eq!(s.mode(), Mode::Faulted);
        assert_eq!(s.latch().first.unwrap().fault.code(), code, "{progress:?}");
    }
}

#[test]
fn a_stale_target_holds_and_does_not_start_again_by_itself() {
    let mut s = in_mode(Mode::Tracking);
    let decision = s.step(&Observed { target_fresh: false, ..well() });
    assert_eq!((s.mode(), decision.action), (Mode::Holding, Action::Hold));
    assert!(decision.limits.contains(Limit::TargetStale));
    let again = s.step(&well());
    assert_eq!(s.mode(), Mode::Holding);
    assert!(again.limits.contains(Limit::TargetStale), "the cause of the hold stays on show");
    let resumed = s.step(&Observed { request: Some(Request::Track), ..well() });
    assert_eq!((s.mode(), resumed.limits), (Mode::Tracking, Limits::default()));
}

#[test]
fn expired_obstacles_hold_a_tracking_and_a_homing_arm_and_leave_a_holding_one() {
    for mode in [Mode::Tracking, Mode::Homing, Mode::Holding] {
        let mut s = in_mode(mode);
        let decision = s.step(&Observed { obstacles: HOLD, ..well() });
        assert_eq!((s.mode(), decision.action), (Mode::Holding, Action::Hold), "{mode:?}");
        assert_eq!(decision.limits.contains(Limit::ObstaclesExpired), mode != Mode::Holding);
    }
}

#[test]
fn homing_ends_in_a_hold() {
    let mut s = in_mode(Mode::Homing);
    assert_eq!(s.step(&well()).action, Action::Home);
    s.step(&Observed { at_home: true, ..well() });
    assert_eq!(s.mode(), Mode::Holding);
}

#[test]
fn a_stop_ramps_then_takes_the_torque_off_and_is_disarmed_when_the_drives_are_off() {
    let mut s = in_mode(Mode::Tracking);
    let decision = s.step(&Observed { request: Some(Request::Stop), ..well() });
    assert_eq!((decision.action, decision.drives), (Action::Ramp, DrivesCommand::On));
    assert_eq!(s.step(&well()).action, Action::Ramp);
    let decision = s.step(&Observed { at_safe_tension: true, ..well() });
    assert_eq!((s.mode(), decision.action, decision.drives), (Mode::Stopping, Action::Off, DrivesCommand::Off));
    let going = DrivesInput { phase: DrivesPhase::Changing, ..ENABLED };
    s.step(&Observed { at_safe_tension: true, drives: going, ..well() });
    assert_eq!(s.mode(), Mode::Stopping);
    s.step(&Observed { at_safe_tension: true, drives: OFF, ..well() });
    assert_eq!(s.mode(), Mode::Disarmed);
}

#[test]
fn a_disarm_does_not_ramp_and_cuts_a_ramp_short() {
    for mode in [Mode::Starting, Mode::Holding, Mode::Tracking, Mode::Homing, Mode::Stopping, Mode::Faulted] {
        let mut s = in_mode(mode);
        let progress = if mode == Mode::Starting { Progress::Drives } else { Progress::Done };
        let decision = s.step(&Observed { request: Some(Request::Disarm), progress, ..well() });
        assert_eq!((decision.action, decision.drives), (Action::Off, DrivesCommand::Off), "{mode:?}");
    }
}

#[test]
fn a_fault_in_every_mode_under_power_ramps_down_and_is_latched() {
    for mode in [Mode::Starting, Mode::Holding, Mode::Tracking, Mode::Homing, Mode::Stopping] {
        let mut s = in_mode(mode);
        let decision = s.step(&with(SILENT));
        assert_eq!((s.mode(), decision.action), (Mode::Faulted, Action::Ramp), "{mode:?}");
        assert_eq!(s.latch().first.unwrap().fault, SILENT);
        let decision = s.step(&Observed { at_safe_tension: true, ..well() });
        assert_eq!((decision.action, decision.drives), (Action::Off, DrivesCommand::Off));
        s.step(&Observed { at_safe_tension: true, drives: OFF, ..well() });
        assert_eq!(s.mode(), Mode::Faulted, "latched although the cause is gone");
    }
}

#[test]
fn faults_of_a_disarmed_arm_are_not_latched() {
    let mut s = in_mode(Mode::Disarmed);
    let drives = DrivesInput { fault: Some((1, 2)), bus_lost: Some(0), ..OFF };
    s.step(&Observed { drives, ..with(SILENT) });
    assert_eq!(s.mode(), Mode::Disarmed);
    assert!(!s.latch().is_latched());
}

#[test]
fn the_drives_own_faults_and_lost_torque_are_faults() {
    for (drives, code) in [
        (DrivesInput { fault: Some((17, 3)), ..ENABLED }, 10),
        (DrivesInput { phase: DrivesPhase::Changing, ..ENABLED }, 11),
        (DrivesInput { bus_lost: Some(2), phase: DrivesPhase::Off, ..ENABLED }, 13),
    ] {
        for mode in [Mode::Holding, Mode::Tracking, Mode::Homing] {
            let mut s = in_mode(mode);
            s.step(&Observed { drives, ..well() });
            assert_eq!(s.mode(), Mode::Faulted);
            assert_eq!(s.latch().first.unwrap().fault.code(), code, "{drives:?}");
        }
    }
}

#[test]
fn clear_waits_for_the_ramp_the_drives_the_bus_and_the_encoders() {
    let mut s = in_mode(Mode::Faulted);
    let mut clear = |seen: Observed| {
        let decision = s.step(&Observed { request: Some(Request::Clear), ..seen });
        (decision.answer.unwrap().refusal, decision.drives, s.mode())
    };
    let off = Observed { drives: OFF, at_safe_tension: true, ..well() };
    assert_eq!(clear(well()).0, Some(Refusal::StillRamping));
    // The ramp is over only after a step that saw it.
    assert_eq!(clear(Observed { at_safe_tension: true, ..well() }).0, Some(Refusal::StillRamping));
    assert_eq!(clear(Observed { at_safe_tension: true, ..well() }).0, Some(Refusal::StillRamping), "drives on");
    let lost = DrivesInput { bus_lost: Some(0), ..OFF };
    assert_eq!(clear(Observed { drives: lost, ..off }).0, Some(Refusal::CausePersists));
    assert_eq!(clear(Observed { faults: with(SILENT).faults, ..off }).0, Some(Refusal::CausePersists));
    assert_eq!(clear(off), (None, DrivesCommand::Reset, Mode::Disarmed));
    assert!(!s.latch().is_latched());
}

#[test]
fn clear_resets_a_faulted_drive_although_its_encoder_is_silent() {
    let mut s = in_mode(Mode::Faulted);
    let drives = DrivesInput { fault: Some((3, 9)), ready: false, ..OFF };
    let seen = Observed { drives, at_safe_tension: true, ..with(SILENT) };
    s.step(&seen);
    let decision = s.step(&Observed { request: Some(Request::Clear), ..seen });
    assert_eq!((decision.drives, s.mode()), (DrivesCommand::Reset, Mode::Disarmed));
    let arm = s.step(&Observed { request: Some(Request::Arm), ..seen });
    assert_eq!(arm.answer.unwrap().refusal, Some(Refusal::DrivesNotReady), "until the drive is well");
}

#[test]
fn missed_deadlines_hold_then_ramp_then_fault_and_ticks_in_time_end_it() {
    for mode in [Mode::Holding, Mode::Tracking, Mode::Homing] {
        let mut s = in_mode(mode);
        let missed = Observed { missed: 1, ..well() };
        let actions: Vec<Action> = (0..4).map(|_| s.step(&missed).action).collect();
        assert_eq!(actions, [Action::Keep, Action::Keep, Action::Ramp, Action::Ramp]);
        assert_eq!((s.mode(), s.deadlines_missed()), (mode, 4));
        // Four more ticks in time of the ramp, then the plan.
        let actions: Vec<Action> = (0..5).map(|_| s.step(&well()).action).collect();
        assert_eq!(actions[..4], [Action::Ramp; 4]);
        assert!(!matches!(actions[4], Action::Keep | Action::Ramp), "in time again");
        let decision = s.step(&missed);
        assert_eq!((decision.action, s.mode()), (Action::Ramp, Mode::Faulted), "the fifth");
        assert_eq!(s.latch().first.unwrap().fault, Fault::Overruns { count: 5 });
    }
}

#[test]
fn deadlines_missed_together_count_each() {
    let mut s = in_mode(Mode::Holding);
    let decision = s.step(&Observed { missed: 4, ..well() });
    assert!(decision.limits.contains(Limit::OverrunRamp) && s.mode() == Mode::Holding);
    let mut s = in_mode(Mode::Holding);
    s.step(&Observed { missed: 5, ..well() });
    assert_eq!(s.latch().first.unwrap().fault, Fault::Overruns { count: 5 });
}

#[test]
fn a_request_that_changes_what_is_planned_does_not_forget_missed_deadlines() {
    let mut s = in_mode(Mode::Holding);
    s.step(&Observed { missed: 2, ..well() });
    let decision = s.step(&Observed { missed: 2, request: Some(Request::Track), ..well() });
    assert_eq!((s.mode(), decision.action, s.deadlines_missed()), (Mode::Tracking, Action::Ramp, 4));
}

#[test]
fn deadlines_missed_without_planning_do_not_count() {
    for mode in [Mode::Disarmed, Mode::Starting, Mode::Stopping] {
        let mut s = in_mode(mode);
        for _ in 0..20 {
            s.step(&Observed { missed: 3, progress: Progress::Settling, ..well() });
        }
        assert_eq!((s.mode(), s.deadlines_missed()), (mode, 0));
    }
}

#[test]
fn a_fault_comes_before_the_request_of_the_same_tick() {
    let mut s = in_mode(Mode::Holding);
    let decision = s.step(&Observed { request: Some(Request::Track), ..with(SILENT) });
    assert_eq!(decision.answer.unwrap().refusal, Some(Refusal::Faulted));
    assert_eq!(s.mode(), Mode::Faulted);
}

#[test]
fn what_happened_can_be_read_from_the_events() {
    let mut s = in_mode(Mode::Tracking);
    while s.events_mut().pop().is_some() {}
    s.step(&Observed { tick: 9, ..with(SILENT) });
    s.step(&Observed { tick: 10, ..with(SILENT) });
    let mut limits = Limits::default();
    limits.insert(Limit::Relaxed);
    s.note_limits(limits, 11, 0);
    s.note_limits(limits, 12, 0);
    s.note_limits(Limits::default(), 13, 0);
    let events: Vec<(u64, EventKind)> = std::iter::from_fn(|| s.events_mut().pop()).map(|e| (e.tick, e.kind)).collect();
    let changed = EventKind::Mode { from: Mode::Tracking, to: Mode::Faulted, cause: Cause::Fault(SILENT) };
    assert_eq!(
        events,
        [
            (9, EventKind::Fault(SILENT)),
            (9, changed),
            (11, EventKind::LimitOn(Limit::Relaxed)),
            (13, EventKind::LimitOff(Limit::Relaxed)),
        ],
        "a fault that goes on is one event"
    );
    assert_eq!(s.latch().count, 2);
}

/// A supervisor of cables that stay, in a hold that a fault has ended.
fn held(fault: Fault) -> Supervisor {
    let config = crate::config::Config::builtin();
    let mut s = Supervisor::new(&config.timing, &config.observer, true, false);
    s.step(&Observed { request: Some(Request::Arm), drives: OFF, ..well() });
    s.step(&well());
    assert_eq!(s.mode(), Mode::Holding);
    s.step(&with(fault));
    assert_eq!(s.mode(), Mode::Faulted);
    s
}

#[test]
fn a_fault_that_permits_it_leaves_the_arm_held_until_a_stop() {
    let mut s = held(SILENT);
    for _ in 0..3 {
        let decision = s.step(&Observed { at_safe_tension: true, ..well() });
        assert_eq!((decision.action, decision.drives), (Action::Stay, DrivesCommand::On));
    }
    let clear = s.step(&Observed { request: Some(Request::Clear), ..well() });
    assert_eq!(clear.answer.unwrap().refusal, Some(Refusal::StillHeld));
    // The estimate is not to be believed, so nothing is lowered: it is let go, slowly.
    let decision = s.step(&Observed { request: Some(Request::Stop), ..well() });
    assert_eq!((decision.action, decision.answer.unwrap().refusal), (Action::Release, None));
    assert_eq!(s.step(&Observed { at_safe_tension: true, ..well() }).action, Action::Off);
    s.step(&Observed { drives: OFF, ..well() });
    s.step(&Observed { request: Some(Request::Clear), drives: OFF, ..well() });
    assert_eq!(s.mode(), Mode::Disarmed);
}

#[test]
fn an_arm_that_is_held_by_a_sound_loop_is_lowered_and_one_whose_loop_fails_on_the_way_is_held_again() {
    let mut s = held(Fault::TargetNotFinite);
    let stop = Observed { request: Some(Request::Stop), lowered: false, ..well() };
    assert_eq!(s.step(&stop).action, Action::Lower);
    assert_eq!(s.step(&Observed { lowered: false, ..with(SILENT) }).action, Action::Stay);
    assert_eq!(s.latch().first.unwrap().fault, Fault::TargetNotFinite, "the first cause stays");
    assert_eq!(s.step(&stop).action, Action::Lower);
    s.step(&well());
    assert_eq!(s.step(&well()).action, Action::Ramp);
    assert_eq!(s.mode(), Mode::Faulted);
}

#[test]
fn what_does_not_permit_a_hold_ends_it() {
    let wrong = Fault::TensionError { cable: 1, error_n: 90.0 };
    assert_eq!(held(wrong).step(&well()).action, Action::Ramp);
    let mut s = held(SILENT);
    assert_eq!(s.step(&well()).action, Action::Stay);
    assert_eq!(s.step(&with(wrong)).action, Action::Ramp);
    let mut s = held(SILENT);
    assert_eq!(s.step(&Observed { request: Some(Request::Disarm), ..well() }).action, Action::Off);
    // A bus that is lost: its drives hold by themselves, and when they are heard again they are told the same.
    let lost = DrivesInput { bus_lost: Some(0), ..OFF };
    let mut s = held(SILENT);
    assert_eq!(s.step(&Observed { drives: lost, ..well() }).action, Action::Stay);
    assert_eq!(s.step(&well()).action, Action::Stay);
    s.step(&Observed { drives: OFF, ..well() });
    assert_eq!(s.step(&Observed { drives: OFF, ..well() }).action, Action::Off);
}

#[test]
fn arming_needs_known_obstacles_or_a_word_that_it_does_not() {
    let config = crate::config::Config::builtin();
    for (unknown, refusal) in [(false, Some(Refusal::ObstaclesExpired)), (true, None)] {
        let mut s = Supervisor::new(&config.timing, &config.observer, true, unknown);
        let arm = Observed { request: Some(Request::Arm), drives: OFF, obstacles: HOLD, ..well() };
        assert_eq!(s.step(&arm).answer.unwrap().refusal, refusal);
    }
}
