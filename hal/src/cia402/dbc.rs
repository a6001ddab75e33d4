//! The DBC file of the cyclic traffic: RPDO 1, TPDO 1 and heartbeat of each node, and SYNC; `hal/dbc/sinew.dbc` is this
//! for nodes 1 to 24.

use crate::canopen::NodeId;
use crate::canopen::cob::{HEARTBEAT, RPDO, SYNC, TPDO};
use std::fmt::Write;

/// DBC text for the nodes given. Torques are per mille of rated torque, positions encoder counts.
pub fn dbc(nodes: &[NodeId]) -> String {
    let mut t = String::from("VERSION \"sinew cyclic synchronous torque\"\n\nNS_ :\n\nBS_:\n\nBU_: MASTER");
    for n in nodes {
        let _ = write!(t, " DRIVE{n}");
    }
    let _ = write!(t, "\n\nBO_ {} SYNC: 0 MASTER\n", u32::from(SYNC));
    for n in nodes {
        let _ = write!(
            t,
            "\nBO_ {rpdo} RPDO1_{n}: 4 MASTER\n \
             SG_ Controlword_{n} : 0|16@1+ (1,0) [0|65535] \"\" DRIVE{n}\n \
             SG_ TargetTorque_{n} : 16|16@1- (1,0) [-1000|1000] \"permille\" DRIVE{n}\n\
             \nBO_ {tpdo} TPDO1_{n}: 8 DRIVE{n}\n \
             SG_ Statusword_{n} : 0|16@1+ (1,0) [0|65535] \"\" MASTER\n \
             SG_ Position_{n} : 16|32@1- (1,0) [-2147483648|2147483647] \"counts\" MASTER\n \
             SG_ Torque_{n} : 48|16@1- (1,0) [-32768|32767] \"permille\" MASTER\n\
             \nBO_ {beat} HEARTBEAT_{n}: 1 DRIVE{n}\n \
             SG_ NmtState_{n} : 0|7@1+ (1,0) [0|127] \"\" MASTER\n",
            rpdo = n.cob(RPDO),
            tpdo = n.cob(TPDO),
            beat = n.cob(HEARTBEAT),
        );
    }
    t.push_str("\nCM_ BO_ 128 \"Latches the target torques and samples the feedback.\";\n");
    for n in nodes {
        let _ = writeln!(
            t,
            "VAL_ {} NmtState_{n} 0 \"boot-up\" 4 \"stopped\" 5 \"operational\" 127 \"pre-operational\" ;",
            n.cob(HEARTBEAT)
        );
    }
    t
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_file_in_the_repository_is_what_the_code_says() {
        let nodes: Vec<_> = (1..=24).map(|n| NodeId::new(n).unwrap()).collect();
        let path = concat!(env!("CARGO_MANIFEST_DIR"), "/dbc/sinew.dbc");
        if std::env::var_os("SINEW_WRITE_FILES").is_some() {
            std::fs::write(path, dbc(&nodes)).unwrap();
        }
        assert_eq!(std::fs::read_to_string(path).unwrap(), dbc(&nodes), "regenerate with SINEW_WRITE_FILES=1");
    }
}
