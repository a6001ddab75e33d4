//! The DBC files of the cyclic traffic: RPDO 1, TPDO 1 and heartbeat of each node, and SYNC. `hal/dbc/sinew.dbc` is the
//! classic layout of nodes 1 to 24, `hal/dbc/sinew_packed.dbc` the packed one of a bus with nodes 1 to 6.

use super::layout::{Layout, PACKED_RPDO, SLOT_BYTES, packed_len};
use crate::canopen::NodeId;
use crate::canopen::cob::{HEARTBEAT, RPDO, SYNC, TPDO};
use std::fmt::Write;

/// DBC text for the nodes given, which in the packed layout are those of one bus in the order of their ranks. Torques
/// are per mille of rated torque, positions encoder counts.
pub fn dbc(layout: Layout, nodes: &[NodeId]) -> String {
    let mut t = String::from("VERSION \"sinew cyclic synchronous torque\"\n\nNS_ :\n\nBS_:\n\nBU_: MASTER");
    for n in nodes {
        let _ = write!(t, " DRIVE{n}");
    }
    let _ = write!(t, "\n\nBO_ {} SYNC: 0 MASTER\n", u32::from(SYNC));
    if layout == Layout::Packed {
        let _ = write!(t, "\nBO_ {PACKED_RPDO} RPDO1_ALL: {} MASTER\n", packed_len(nodes.len()));
        for (rank, n) in nodes.iter().enumerate() {
            targets(&mut t, *n, 8 * SLOT_BYTES * rank);
        }
    }
    for n in nodes {
        if layout == Layout::Classic {
            let _ = write!(t, "\nBO_ {} RPDO1_{n}: 4 MASTER\n", n.cob(RPDO));
            targets(&mut t, *n, 0);
        }
        let _ = write!(
            t,
            "\nBO_ {tpdo} TPDO1_{n}: 8 DRIVE{n}\n \
             SG_ Statusword_{n} : 0|16@1+ (1,0) [0|65535] \"\" MASTER\n \
             SG_ Position_{n} : 16|32@1- (1,0) [-2147483648|2147483647] \"counts\" MASTER\n \
             SG_ Torque_{n} : 48|16@1- (1,0) [-32768|32767] \"permille\" MASTER\n\
             \nBO_ {beat} HEARTBEAT_{n}: 1 DRIVE{n}\n \
             SG_ NmtState_{n} : 0|7@1+ (1,0) [0|127] \"\" MASTER\n",
            tpdo = n.cob(TPDO),
            beat = n.cob(HEARTBEAT),
        );
    }
    t.push_str("\nCM_ BO_ 128 \"Latches the target torques and samples the feedback.\";\n");
    if layout == Layout::Packed {
        frame_formats(&mut t, nodes);
    }
    for n in nodes {
        let _ = writeln!(
            t,
            "VAL_ {} NmtState_{n} 0 \"boot-up\" 4 \"stopped\" 5 \"operational\" 127 \"pre-operational\" ;",
            n.cob(HEARTBEAT)
        );
    }
    t
}

/// The four bytes of a drive's targets from this bit on.
fn targets(t: &mut String, n: NodeId, bit: usize) {
    let _ = write!(
        t,
        " SG_ Controlword_{n} : {bit}|16@1+ (1,0) [0|65535] \"\" DRIVE{n}\n \
         SG_ TargetTorque_{n} : {}|16@1- (1,0) [-10000|10000] \"permille\" DRIVE{n}\n",
        bit + 16
    );
}

/// Which messages are CAN FD frames with bit-rate switch, by the attributes that DBC tools agreed on.
fn frame_formats(t: &mut String, nodes: &[NodeId]) {
    let reserved = "\"reserved\",".repeat(10);
    let _ = write!(
        t,
        "BA_DEF_ \"BusType\" STRING ;\n\
         BA_DEF_ BO_ \"VFrameFormat\" ENUM \"StandardCAN\",\"ExtendedCAN\",\"reserved\",\"J1939PG\",{reserved}\
         \"StandardCAN_FD\",\"ExtendedCAN_FD\";\n\
         BA_DEF_ BO_ \"CANFD_BRS\" ENUM \"0\",\"1\";\n\
         BA_DEF_DEF_ \"BusType\" \"CAN FD\";\nBA_DEF_DEF_ \"VFrameFormat\" \"StandardCAN\";\n\
         BA_DEF_DEF_ \"CANFD_BRS\" \"0\";\nBA_ \"BusType\" \"CAN FD\";\n"
    );
    for cob in std::iter::once(PACKED_RPDO).chain(nodes.iter().map(|n| n.cob(TPDO))) {
        let _ = writeln!(t, "BA_ \"VFrameFormat\" BO_ {cob} 14;\nBA_ \"CANFD_BRS\" BO_ {cob} 1;");
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_files_in_the_repository_are_what_the_code_says() {
        for (file, layout, last) in [("sinew.dbc", Layout::Classic, 24), ("sinew_packed.dbc", Layout::Packed, 6)] {
            let nodes: Vec<_> = (1..=last).map(|n| NodeId::new(n).unwrap()).collect();
            let path = format!("{}/dbc/{file}", env!("CARGO_MANIFEST_DIR"));
            if std::env::var_os("SINEW_WRITE_FILES").is_some() {
                std::fs::write(&path, dbc(layout, &nodes)).unwrap();
            }
            let text = std::fs::read_to_string(&path).unwrap();
            assert_eq!(text, dbc(layout, &nodes), "{file}: regenerate with SINEW_WRITE_FILES=1");
        }
    }
}
