//! Moving drives towards the goal: which transition comes next, in which order, and what is given up when.
//!
//! Enters: the states that the drives report, the goal. Leaves: controlwords, which the next cycle carries. It must
//! never drive a drive back that left its state by itself: what took it out may be a person with an emergency stop.

use super::super::config::Order;
use super::super::cyclic::Address;
use super::super::fault::Fault;
use super::super::state::{Command, FAULT_RESET_BIT, State};
use super::Master;
use super::status::{Goal, Phase};
use crate::canopen::NmtCommand;
use std::sync::atomic::Ordering;

/// Cycles that a drive may leave unanswered however long they take.
const CYCLES_UNANSWERED: u64 = 5;

impl Master {
    /// Moves each drive one transition nearer to the goal, in the order wanted. On the way to less power nobody waits for a
    /// drive that is not heard: it is told the same, and those behind it would keep their torque for its sake.
    pub(super) fn follow_goal(&mut self, now_ns: u64) {
        let order = if self.goal == Goal::Enabled {
            self.config.order_of_enabling
        } else if self.goal == Goal::Disabled {
            self.config.order_of_disabling
        } else {
            Order::Parallel // a quick stop waits for nobody
        };
        for i in indices(order, self.slots.len()) {
            if self.slots[i].status.phase != Phase::Ready {
                continue;
            }
            let arrived = self.step_towards_goal(i, now_ns);
            if !arrived && !self.is_not_waited_for(i, now_ns) && order != Order::Parallel && !self.slots[i].stuck {
                break;
            }
        }
    }

    /// True when the drive is where the goal wants it.
    fn step_towards_goal(&mut self, i: usize, now_ns: u64) -> bool {
        let waited_ns = now_ns.saturating_sub(self.slots[i].since_ns);
        let late = waited_ns > u64::from(self.config.transition_timeout_ms) * 1_000_000;
        let timeout_ms = self.config.transition_timeout_ms;
        let Some(statusword) = self.slots[i].status.statusword else {
            if late && !self.slots[i].stuck {
                self.give_up(i);
                self.fault(i, now_ns, Fault::NoFeedback { timeout_ms });
            }
            return false;
        };
        let Some(found) = State::from_statusword(statusword) else {
            if late && !self.slots[i].stuck {
                self.give_up(i);
                let (wanted, found) = (State::SwitchOnDisabled, State::NotReadyToSwitchOn);
                self.fault(i, now_ns, Fault::Transition { wanted, found, statusword, timeout_ms });
            }
            return false;
        };
        if self.fault_reset(i, found, now_ns) {
            return false;
        }
        let slot = &mut self.slots[i];
        if self.goal == Goal::Enabled && found == State::OperationEnabled {
            slot.was_enabled = true;
        }
        if self.goal == Goal::Enabled && slot.was_enabled && !slot.stuck && found != State::OperationEnabled {
            // Never driven back by itself: what took it out may be a person with an emergency stop.
            slot.stuck = true;
            self.shared.controlwords[i].store(Command::DisableVoltage.controlword(), Ordering::Release);
            self.fault(i, now_ns, Fault::LeftOperation { found, statusword });
            return false;
        }
        let Some((wanted, word)) = next(self.goal, found) else {
            slot.wanted = None;
            slot.since_ns = now_ns;
            return reached(self.goal, found);
        };
        if slot.stuck {
            return false;
        }
        if slot.wanted != Some(wanted) {
            slot.wanted = Some(wanted);
            slot.since_ns = now_ns;
        } else if late {
            self.give_up(i);
            let torque = matches!(found, State::OperationEnabled | State::QuickStopActive);
            if torque && self.goal != Goal::Enabled && !self.is_unheard(i, now_ns) {
                // It is heard and does not obey its controlword: another node may have unmapped it. NMT is another way.
                let Address { bus, node, .. } = self.addresses[i];
                self.send(bus, NmtCommand::ResetNode.encode(Some(node)));
            }
            self.fault(i, now_ns, Fault::Transition { wanted, found, statusword, timeout_ms });
            return false;
        }
        self.shared.controlwords[i].store(word, Ordering::Release);
        false
    }

    /// No further transition until the goal is set anew. Where there shall be no torque, the last word is the one that takes
    /// the power away in any state: the drive may hear although it is not heard, and would keep its power on at the word
    /// of a transition on the way.
    fn give_up(&mut self, i: usize) {
        self.slots[i].stuck = true;
        if self.goal != Goal::Enabled {
            self.shared.controlwords[i].store(Command::DisableVoltage.controlword(), Ordering::Release);
        }
    }

    /// Those behind it go on although it is not where the goal wants it.
    fn is_not_waited_for(&self, i: usize, now_ns: u64) -> bool {
        match self.slots[i].status.state() {
            // It gives no torque and goes nowhere before a reset.
            Some(State::Fault | State::FaultReactionActive) => true,
            _ if self.goal == Goal::Enabled => false,
            // Without power, and no command is obeyed.
            Some(State::NotReadyToSwitchOn) => true,
            _ => self.is_unheard(i, now_ns),
        }
    }

    /// Nothing is known of where the drive is: its heartbeat is lost, or its statusword stays out although there were SYNCs.
    fn is_unheard(&self, i: usize, now_ns: u64) -> bool {
        let slot = &self.slots[i];
        let old =
            now_ns.saturating_sub(slot.feedback_ns) > u64::from(self.config.drive_heartbeat_timeout_ms) * 1_000_000;
        let asked = self.shared.cycle.load(Ordering::Acquire).saturating_sub(slot.feedback_cycle) > CYCLES_UNANSWERED;
        slot.heartbeat_lost || old && asked
    }

    /// The edge of bit 7 over two cycles each way, so that a lost frame does not swallow it; true while under way.
    fn fault_reset(&mut self, i: usize, found: State, now_ns: u64) -> bool {
        let cycle = self.shared.cycle.load(Ordering::Acquire);
        let slot = &mut self.slots[i];
        let Some(changed) = slot.resetting else { return false };
        let word = &self.shared.controlwords[i];
        if found != State::Fault {
            slot.resetting = None;
            slot.since_ns = now_ns;
            slot.status.error_register = 0;
            word.store(0, Ordering::Release);
            return false;
        }
        let timeout_ms = self.config.transition_timeout_ms;
        if now_ns.saturating_sub(slot.since_ns) > u64::from(timeout_ms) * 1_000_000 {
            slot.resetting = None;
            slot.stuck = true;
            word.store(0, Ordering::Release);
            let statusword = slot.status.statusword.unwrap_or(0);
            self.fault(i, now_ns, Fault::Transition { wanted: State::SwitchOnDisabled, found, statusword, timeout_ms });
            return true;
        }
        if cycle >= changed + 2 {
            let set = word.load(Ordering::Acquire) & FAULT_RESET_BIT != 0;
            word.store(if set { 0 } else { Command::FaultReset.controlword() }, Ordering::Release);
            slot.resetting = Some(cycle);
        }
        true
    }
}

/// Drives in the order of a procedure.
pub(super) fn indices(order: Order, count: usize) -> impl Iterator<Item = usize> {
    (0..count).map(move |i| if order == Order::OneByOneReversed { count - 1 - i } else { i })
}

/// Whether a state is where the goal wants a drive.
pub(super) fn reached(goal: Goal, state: State) -> bool {
    match goal {
        Goal::Disabled => state == State::SwitchOnDisabled,
        Goal::Enabled => state == State::OperationEnabled,
        Goal::QuickStop => matches!(state, State::QuickStopActive | State::SwitchOnDisabled),
    }
}

/// Next state and the controlword that leads there; `None` if the goal is reached or nothing can be commanded.
fn next(goal: Goal, state: State) -> Option<(State, u16)> {
    use State as S;
    let step = |to: State, command: Command| Some((to, command.controlword()));
    match (goal, state) {
        (_, S::NotReadyToSwitchOn | S::FaultReactionActive | S::Fault) => None,
        (Goal::Enabled, S::SwitchOnDisabled) => step(S::ReadyToSwitchOn, Command::Shutdown),
        (Goal::Enabled, S::ReadyToSwitchOn) => step(S::SwitchedOn, Command::SwitchOn),
        (Goal::Enabled, S::SwitchedOn) => step(S::OperationEnabled, Command::EnableOperation),
        (Goal::Enabled, S::OperationEnabled) => None,
        (Goal::Enabled, S::QuickStopActive) => step(S::SwitchOnDisabled, Command::DisableVoltage),
        (Goal::QuickStop, S::OperationEnabled) => step(S::QuickStopActive, Command::QuickStop),
        (Goal::QuickStop, S::QuickStopActive | S::SwitchOnDisabled) => None,
        (Goal::Disabled, S::OperationEnabled) => step(S::SwitchedOn, Command::SwitchOn),
        (Goal::Disabled | Goal::QuickStop, S::SwitchedOn) => step(S::ReadyToSwitchOn, Command::Shutdown),
        (Goal::Disabled | Goal::QuickStop, S::ReadyToSwitchOn) => step(S::SwitchOnDisabled, Command::DisableVoltage),
        (Goal::Disabled, S::QuickStopActive) => step(S::SwitchOnDisabled, Command::DisableVoltage),
        (Goal::Disabled, S::SwitchOnDisabled) => None,
    }
}
