//! Indices of the objects that master and drive share, with their units.

use crate::canopen::Mapped;

/// Device type: profile number in the low half (402), servo drive in bit 17.
pub const DEVICE_TYPE: u16 = 0x1000;
/// Error register.
pub const ERROR_REGISTER: u16 = 0x1001;
/// Pre-defined error field: the history of emergency codes, newest first.
pub const ERROR_FIELD: u16 = 0x1003;
/// COB-ID of SYNC.
pub const COB_SYNC: u16 = 0x1005;
/// Communication cycle period (us).
pub const CYCLE_PERIOD: u16 = 0x1006;
/// Consumed heartbeats: node in bits 16 to 23, time (ms) in bits 0 to 15.
pub const HEARTBEAT_CONSUMER: u16 = 0x1016;
/// Produced heartbeat (ms).
pub const HEARTBEAT_PRODUCER: u16 = 0x1017;
/// Identity: vendor, product, revision, serial number.
pub const IDENTITY: u16 = 0x1018;
/// Error behaviour; sub 1: after a communication error (0 pre-operational, 1 no change, 2 stopped).
pub const ERROR_BEHAVIOUR: u16 = 0x1029;
/// Communication parameters of the first RPDO.
pub const RPDO_COMMUNICATION: u16 = 0x1400;
/// Sub-index of a PDO's communication parameters: event timer (ms, 0 off). Of an RPDO, the time within which the next
/// one must come.
pub const EVENT_TIMER: u8 = 5;
/// Mapping of the first RPDO.
pub const RPDO_MAPPING: u16 = 0x1600;
/// Communication parameters of the first TPDO.
pub const TPDO_COMMUNICATION: u16 = 0x1800;
/// Mapping of the first TPDO.
pub const TPDO_MAPPING: u16 = 0x1a00;
/// Sinew's own: communication guard, what the drive does when its master is silent.
pub const GUARD: u16 = 0x2000;
/// Sub-index of [`GUARD`]: SYNC timeout (us, 0 off).
pub const GUARD_SYNC: u8 = 1;
/// Sub-index of [`GUARD`]: safe torque (per mille of rated torque), to which the torque goes at [`TORQUE_SLOPE`].
pub const GUARD_TORQUE: u8 = 2;
/// Sub-index of [`GUARD`]: 0, the torque goes to the safe torque; 1, it stays as it is.
pub const GUARD_KEEPS: u8 = 3;
/// Sinew's own: frames in which a drive sends its PDOs and how long they may be; [`PDO_FORMAT_CLASSIC`],
/// [`PDO_FORMAT_FD`] or [`PDO_FORMAT_FD_BRS`].
pub const PDO_FORMAT: u16 = 0x2002;
/// Abort connection option code: 0 nothing, 1 fault, 2 disable voltage, 3 quick stop.
pub const ABORT_CONNECTION: u16 = 0x6007;
/// Error code of the latest fault.
pub const ERROR_CODE: u16 = 0x603f;
/// Controlword.
pub const CONTROLWORD: u16 = 0x6040;
/// Statusword.
pub const STATUSWORD: u16 = 0x6041;
/// Quick stop option code.
pub const QUICK_STOP_OPTION: u16 = 0x605a;
/// Modes of operation.
pub const MODE: u16 = 0x6060;
/// Modes of operation display.
pub const MODE_DISPLAY: u16 = 0x6061;
/// Position actual value (counts).
pub const POSITION: u16 = 0x6064;
/// Velocity actual value (counts/s).
pub const VELOCITY: u16 = 0x606c;
/// Target torque (per mille of rated torque).
pub const TARGET_TORQUE: u16 = 0x6071;
/// Max torque (per mille of rated torque).
pub const MAX_TORQUE: u16 = 0x6072;
/// Torque demand (per mille of rated torque).
pub const TORQUE_DEMAND: u16 = 0x6074;
/// Motor rated torque (mN m).
pub const RATED_TORQUE: u16 = 0x6076;
/// Torque actual value (per mille of rated torque).
pub const TORQUE: u16 = 0x6077;
/// Torque slope (per mille of rated torque per second), 0: at once.
pub const TORQUE_SLOPE: u16 = 0x6087;
/// Supported drive modes; bit 9 is cyclic synchronous torque.
pub const SUPPORTED_MODES: u16 = 0x6502;

/// [`PDO_FORMAT`]: classic frames, at most 8 bytes (power-up value).
pub const PDO_FORMAT_CLASSIC: u8 = 0;
/// [`PDO_FORMAT`]: CAN FD frames at one bit rate, at most 64 bytes.
pub const PDO_FORMAT_FD: u8 = 1;
/// [`PDO_FORMAT`]: CAN FD frames with bit-rate switch, at most 64 bytes.
pub const PDO_FORMAT_FD_BRS: u8 = 2;

/// Mode of operation: cyclic synchronous torque.
pub const MODE_CST: i8 = 10;
/// Bit of [`SUPPORTED_MODES`] for cyclic synchronous torque.
pub const SUPPORTS_CST: u32 = 1 << 9;

/// RPDO 1 as the master sets it: controlword, target torque.
pub const RPDO1: [Mapped; 2] = [Mapped::new(CONTROLWORD, 0, 16), Mapped::new(TARGET_TORQUE, 0, 16)];
/// TPDO 1 as the master sets it: statusword, position, torque.
pub const TPDO1: [Mapped; 3] =
    [Mapped::new(STATUSWORD, 0, 16), Mapped::new(POSITION, 0, 32), Mapped::new(TORQUE, 0, 16)];

/// Payload of RPDO 1.
pub const fn encode_rpdo1(controlword: u16, torque_permille: i16) -> [u8; 4] {
    let [c0, c1] = controlword.to_le_bytes();
    let [t0, t1] = torque_permille.to_le_bytes();
    [c0, c1, t0, t1]
}

/// Statusword, position (counts) and torque (per mille) of TPDO 1; `None` if it is shorter than eight bytes.
pub fn decode_tpdo1(data: &[u8]) -> Option<(u16, i32, i16)> {
    let &[s0, s1, p0, p1, p2, p3, t0, t1] = data.get(..8)? else { return None };
    Some((u16::from_le_bytes([s0, s1]), i32::from_le_bytes([p0, p1, p2, p3]), i16::from_le_bytes([t0, t1])))
}
