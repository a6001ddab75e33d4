//! The packed CAN FD layout: what is on the wire, what the drives' mappings say, and that nothing else changes.
#![allow(clippy::unwrap_used, clippy::expect_used)] // a test may panic

mod bench;

use bench::{Bench, MemoryBus, configure, node, transfer};
use proptest::prelude::*;
use sim_plant::drive::{Drive, Nameplate};
use sinew_hal::can::{CanBus, Frame, Id, Kind};
use sinew_hal::canopen::AbortCode;
use sinew_hal::canopen::sdo_client::{Outcome, SdoError};
use sinew_hal::cia402::config::SetupError;
use sinew_hal::cia402::layout::{PACKED_DRIVES_MAX, packed_frame, packed_len};
use sinew_hal::cia402::objects as o;
use sinew_hal::cia402::state::Command;
use sinew_hal::cia402::{DriveSetup, Layout, Master, MasterConfig};

const FD_BRS: Kind = Kind::Fd { bit_rate_switch: true };

#[test]
fn one_fd_frame_with_bit_rate_switch_carries_the_torques_of_a_bus_and_each_drive_takes_its_own() {
    let mut b = Bench::new(Layout::Packed, 2, 5, |_| {});
    b.enable();
    let mut writer = b.master.take_writer().unwrap();
    let torques: Vec<i16> = (0..10).map(|i| 70 * i - 300).collect();
    b.wire.clear();
    let report = writer.write_cycle(&torques);
    b.serve();
    assert!(report.not_sent.is_empty() && report.limited.is_empty());
    for bus in 0..2 {
        let frames: Vec<Frame> = b.wire.iter().filter(|(at, _)| *at == bus).map(|(_, f)| *f).collect();
        let cyclic = |f: &&Frame| matches!(f.id(), Id::Standard(id) if id < 0x580);
        let [rpdo, sync, tpdos @ ..] = &frames.iter().filter(cyclic).copied().collect::<Vec<_>>()[..] else {
            panic!("{frames:?}")
        };
        // Five drives fill 20 bytes, which is a length that CAN FD has.
        assert_eq!((rpdo.id(), rpdo.kind(), rpdo.len()), (Id::Standard(0x200), FD_BRS, 20));
        for rank in 0..5 {
            let word = Command::EnableOperation.controlword();
            assert_eq!(rpdo.data()[4 * rank..][..4], o::encode_rpdo1(word, torques[5 * bus + rank]));
            assert_eq!(b.banks[bus].1.drives()[rank].torque_permille(), torques[5 * bus + rank]);
        }
        assert_eq!((sync.id(), sync.kind(), sync.len()), (Id::Standard(0x80), Kind::Classic, 0));
        assert_eq!(tpdos.len(), 5);
        for (rank, tpdo) in (1..).zip(tpdos) {
            assert_eq!((tpdo.id(), tpdo.kind(), tpdo.len()), (Id::Standard(0x180 + rank), FD_BRS, 8));
        }
    }
}

#[test]
fn the_mappings_in_the_drives_are_those_of_the_documentation() {
    let mut b = Bench::new(Layout::Packed, 1, 7, |_| {});
    b.enable();
    assert_eq!(b.master.take_faults(), []);
    for (rank, d) in b.banks[0].1.drives().iter().enumerate() {
        let d = d.dictionary();
        let entries: Vec<i64> = (1..=d.int(0x1600, 0)).map(|sub| d.int(0x1600, sub as u8)).collect();
        // Seven slots and one of padding: 32 bytes.
        let mut expected = vec![0x0007_0020; 8];
        expected.splice(rank..=rank, [0x6040_0010, 0x6071_0010]);
        assert_eq!(entries, expected, "rank {rank}");
        assert_eq!((d.int(0x1400, 1), d.int(0x1400, 2)), (0x200, 1));
        assert_eq!(d.int(0x1800, 1) & 0x7ff, 0x181 + rank as i64);
        assert_eq!(d.int(o::PDO_FORMAT, 0), 2);
    }
}

#[test]
fn sixteen_drives_fit_a_bus_and_seventeen_are_refused() {
    let mut b = Bench::new(Layout::Packed, 1, 16, |_| {});
    b.enable();
    let mut writer = b.master.take_writer().unwrap();
    let torques: Vec<i16> = (0..16).map(|i| 10 * i + 1).collect();
    b.cycle(&mut writer, &torques);
    assert!((0..16).all(|i| b.drive(0, i).torque_permille() == torques[i]));

    let drives = (1..=17).map(|n| DriveSetup::new(0, node(n))).collect();
    let mut config = MasterConfig::new(drives, node(127), 1000);
    let handles = || vec![Box::new(MemoryBus::default()) as Box<dyn CanBus>];
    assert!(Master::new(config.clone(), handles()).is_ok());
    config.layouts = vec![Layout::Packed];
    let refused = Master::new(config, handles()).err().unwrap();
    assert_eq!(refused, SetupError::Full { bus: 0, found: 17, most: PACKED_DRIVES_MAX });
    assert!(refused.to_string().contains("17 drives"), "{refused}");
}

#[test]
fn a_lost_packed_frame_leaves_all_drives_of_its_bus_and_no_other_at_their_last_torques() {
    let mut b = Bench::new(Layout::Packed, 2, 4, |_| {});
    b.enable();
    let mut writer = b.master.take_writer().unwrap();
    b.cycle(&mut writer, &[100; 8]);
    writer.write_cycle(&[200; 8]);
    // Lost on the wire: the sender does not know.
    let lost = b.banks[1].0.receive(std::time::Duration::ZERO).unwrap().unwrap();
    assert_eq!(lost.frame.id(), Id::Standard(0x200));
    b.serve();
    let torques: Vec<_> = (0..8).map(|i| b.drive(i / 4, i % 4).torque_permille()).collect();
    assert_eq!(torques, [200, 200, 200, 200, 100, 100, 100, 100]);
    b.cycle(&mut writer, &[300; 8]);
    assert!((0..8).all(|i| b.drive(i / 4, i % 4).torque_permille() == 300));
    assert_eq!(b.master.take_faults(), []);
}

#[test]
fn two_layouts_may_live_side_by_side() {
    let mut b = Bench::new(Layout::Packed, 2, 3, |c| c.layouts = vec![Layout::Classic, Layout::Packed]);
    b.enable();
    let mut writer = b.master.take_writer().unwrap();
    b.wire.clear();
    b.cycle(&mut writer, &[10, 20, 30, 40, 50, 60]);
    let rpdos = |bus: usize| {
        let is_rpdo = |id| matches!(id, Id::Standard(0x200..0x280));
        b.wire.iter().filter(|(at, f)| *at == bus && is_rpdo(f.id())).count()
    };
    assert_eq!((rpdos(0), rpdos(1)), (3, 1));
    for i in 0..6 {
        assert_eq!(b.drive(i / 3, i % 3).torque_permille(), 10 * (i as i16 + 1));
    }
}

#[test]
fn a_drive_maps_dummies_in_rpdos_only_and_long_ones_in_fd_frames_only() {
    let mut d = Drive::new(node(1), Nameplate::default(), 0);
    let aborted = |c| Outcome::Failed(SdoError::Aborted(c));
    let ok = Outcome::Done(vec![]);
    let mut write = |index, sub, data: &[u8]| transfer(&mut d, index, sub, Some(data));
    for base in [0x1400, 0x1800] {
        assert_eq!(write(base, 1, &0xc000_0201u32.to_le_bytes()), ok);
        assert_eq!(write(base + 0x200, 0, &[0]), ok);
    }
    for (entry, outcome) in [
        (0x0007_0020u32, ok.clone()),
        (0x0005_0008, ok.clone()),
        (0x0007_0010, aborted(AbortCode::NOT_MAPPABLE)), // wrong length
        (0x0007_0120, aborted(AbortCode::NOT_MAPPABLE)), // types have no sub-indices
        (0x0001_0001, aborted(AbortCode::NO_OBJECT)),    // single bits
        (0x0009_0008, aborted(AbortCode::NO_OBJECT)),    // no type of fixed length
    ] {
        assert_eq!(write(0x1600, 1, &entry.to_le_bytes()), outcome, "{entry:08X}");
        let outcome = if outcome == ok { aborted(AbortCode::NOT_MAPPABLE) } else { outcome };
        assert_eq!(write(0x1a00, 1, &entry.to_le_bytes()), outcome, "{entry:08X}");
    }
    for sub in 1..=3 {
        assert_eq!(write(0x1600, sub, &0x0007_0020u32.to_le_bytes()), ok);
    }
    assert_eq!(write(0x1600, 0, &[3]), aborted(AbortCode::PDO_LENGTH)); // 12 bytes
    assert_eq!(write(o::PDO_FORMAT, 0, &[3]), aborted(AbortCode::VALUE_HIGH));
    assert_eq!(write(o::PDO_FORMAT, 0, &[o::PDO_FORMAT_FD_BRS]), ok);
    assert_eq!(write(0x1600, 0, &[3]), ok);
    assert_eq!(write(o::PDO_FORMAT, 0, &[o::PDO_FORMAT_CLASSIC]), aborted(AbortCode::PDO_LENGTH));
    assert_eq!(write(o::PDO_FORMAT, 0, &[o::PDO_FORMAT_FD]), ok);
}

#[test]
fn a_packed_frame_too_short_for_the_mapping_is_reported_and_changes_nothing() {
    let mut d = Drive::new(node(1), Nameplate::default(), 0);
    configure(&mut d, Layout::Packed, 6);
    let sync = Frame::classic(Id::Standard(0x80), &[]).unwrap();
    let mut slots = vec![0; packed_len(6)];
    slots[..4].copy_from_slice(&o::encode_rpdo1(Command::Shutdown.controlword(), 0));
    d.on_frame(&packed_frame(&slots[..20]).unwrap(), 0);
    d.on_frame(&sync, 0);
    let state = d.state();
    let told = std::iter::from_fn(|| d.pop()).any(|f| f.id() == Id::Standard(0x81) && f.data()[..2] == [0x10, 0x82]);
    assert!(told, "no emergency object 8210");
    d.on_frame(&packed_frame(&slots).unwrap(), 0);
    d.on_frame(&sync, 0);
    assert_ne!(d.state(), state, "the whole frame is obeyed");
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(8))]

    #[test]
    fn torques_and_feedback_do_not_depend_on_the_layout(
        per_bus in 1u8..=6,
        cycles in proptest::collection::vec(proptest::collection::vec(any::<i16>(), 12), 1..20)
    ) {
        let run = |layout| {
            let mut b = Bench::new(layout, 2, per_bus, |_| {});
            b.enable();
            let mut writer = b.master.take_writer().unwrap();
            let mut seen = Vec::new();
            for torques in &cycles {
                let count = 2 * usize::from(per_bus);
                let report = writer.write_cycle(&torques[..count]);
                b.serve();
                for i in 0..count {
                    let torque = b.drive(i / usize::from(per_bus), i % usize::from(per_bus)).torque_permille();
                    seen.push((report.limited, torque, i32::from(b.decoder.feedback()[i].statusword)));
                    let d = b.drive(i / usize::from(per_bus), i % usize::from(per_bus));
                    d.set_feedback(seen.len() as i32 * 1000, 0, torque);
                }
                seen.extend(b.decoder.feedback().iter().map(|f| (report.limited, f.torque_permille, f.position_counts)));
                for _ in 0..5 { b.step(); }
            }
            seen
        };
        prop_assert_eq!(run(Layout::Classic), run(Layout::Packed));
    }
}
