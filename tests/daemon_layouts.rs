//! The layouts of a bus's frames in the whole: what `check` accepts, that the loop does not notice which one it is, and
//! what `status` says when a bus takes no frames.

#![allow(clippy::unwrap_used, clippy::expect_used)] // a helper that fails is a test that fails

mod daemon_support;

use daemon_support::{Place, lockstep_run};
use sinew_hal::can::BusState;
use sinew_hal::virtual_bus::VirtualBus;

/// The shipped drives on four CAN FD buses of shared memory in this layout.
fn on_four_fd_buses(layout: &str, change: impl Fn(&str, String) -> String) -> Place {
    Place::new(|file, text| {
        if file != "drives.toml" {
            return change(file, text);
        }
        let (head, rest) = text.split_once("[[drives.buses]]").unwrap();
        let (bus, defaults) = rest.split_once("[drives.defaults]").unwrap();
        let interface = bus.split("interface = \"").nth(1).unwrap().split('"').next().unwrap();
        let four: String = (0..4)
            .map(|i| {
                format!(
                    "[[drives.buses]]\nname = \"bus{i}\"\nkind = \"virtual\"\ninterface = \"{interface}{i}\"\n\
                     fd = true\nlayout = \"{layout}\"\n\n"
                )
            })
            .collect();
        change(file, format!("{head}{four}[drives.defaults]{defaults}"))
    })
}

#[test]
fn tensions_are_the_same_bit_for_bit_in_both_layouts() {
    let run = |layout| lockstep_run(&on_four_fd_buses(layout, |_, text| text), "3", 400);
    let (classic, packed) = (run("classic"), run("packed"));
    assert_eq!(classic.iter().zip(&packed).position(|(a, b)| a != b), None, "first tick that differs");
    assert_eq!(classic.len(), packed.len());
    assert!(packed.last().unwrap().iter().any(|t| *t != 0), "tensions were sent at all");
}

#[test]
fn a_kilohertz_is_refused_on_a_classic_bus_and_accepted_on_four_packed_ones() {
    let kilohertz = |_: &str, text: String| text.replace("period_s = 0.01\n", "period_s = 0.001\n");
    let (code, said) = Place::new(kilohertz).operate(&["check"]);
    assert_eq!(code, Some(2), "{said}");
    assert!(said.contains("the cyclic traffic takes 5") && said.contains("period of 1 ms"), "{said}");
    let (code, said) = on_four_fd_buses("classic", kilohertz).operate(&["check"]);
    assert_eq!(code, Some(2), "{said}");
    let (code, said) = on_four_fd_buses("packed", kilohertz).operate(&["check"]);
    assert_eq!(code, Some(0), "{said}");
    for bus in 0..4 {
        let line = said.lines().find(|line| line.contains(&format!("load bus{bus}"))).unwrap();
        assert!(line.contains("worst-case stuffing, at most 70 %"), "{line}");
    }
}

#[test]
fn frames_that_a_bus_does_not_take_are_counted_in_the_status() {
    let place = Place::shipped();
    let daemon = place.daemon(&[]);
    // Without a plant nobody answers, yet cycles are sent, and taken.
    let before = place.until("cycles are sent", |s| s.ticks > 20 && !s.buses[0].state.is_empty());
    assert_eq!(before.buses[0].unsent, 0, "{before:#?}");
    let bus = VirtualBus::open(&place.bus, false).unwrap();
    bus.set_state(BusState::Down);
    // A cycle is 24 frames and SYNC.
    let down = place.until("refused frames are counted", |s| s.buses[0].unsent >= 250);
    assert_eq!(down.buses[0].state, "Down");
    bus.set_state(BusState::ErrorActive);
    place.until("the bus is back", |s| s.buses[0].state == "ErrorActive");
    let (_, said) = place.operate(&["status"]);
    let header = said.lines().find(|line| line.contains("load computed")).unwrap();
    assert!(header.contains("unsent"), "{said}");
    drop(bus);
    drop(daemon);
}
