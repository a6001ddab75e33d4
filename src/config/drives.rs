//! `[drives]`: buses, and the drive of every cable.

use super::arm::ArmConfig;
use super::reader::Section;
use super::safe_hold::{self, SafeHold};
use super::schema::{Key, Kind, Length, Range, TableSpec};
use serde::Serialize;
use std::collections::BTreeMap;
use std::rc::Rc;

/// What carries a bus's frames.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum BusKind {
    /// The user-space bus over shared memory.
    Virtual,
    /// A CAN interface of the kernel.
    Socketcan,
}

/// How the cyclic traffic of a bus lies in its frames.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum BusLayout {
    /// Classic frames, one of torque for each drive.
    Classic,
    /// CAN FD frames with bit-rate switch, one of torque for all drives.
    Packed,
}

/// Most drives of a bus with the packed layout: 64 bytes, four for each.
pub const PACKED_DRIVES_MAX: usize = 16;

/// One CAN bus.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct BusConfig {
    /// Name in reports.
    pub name: String,
    /// What carries it.
    pub kind: BusKind,
    /// Interface (`can0`) or name of the virtual bus.
    pub interface: String,
    /// Bit rate, of the arbitration phase with FD (bit/s).
    pub bitrate_bps: u32,
    /// CAN FD.
    pub fd: bool,
    /// Bit rate of the data phase (bit/s); equal to `bitrate_bps` without FD.
    pub data_bitrate_bps: u32,
    /// How its cyclic traffic lies in its frames.
    pub layout: BusLayout,
    /// Share of the bus that its cyclic traffic may take, worst case.
    pub load_limit: f64,
}

/// One drive.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct DriveConfig {
    /// Segment of its cable, from 1.
    pub segment: usize,
    /// Number of its cable within the segment, from 1.
    pub cable: usize,
    /// Index of its bus in [`DrivesConfig::buses`].
    pub bus: usize,
    /// CANopen node id, 1 to 127.
    pub node_id: u8,
    /// Radius of the drum (m).
    pub drum_radius_m: f64,
    /// Motor turns per drum turn.
    pub gear_ratio: f64,
    /// +1 if positive torque pulls the cable, -1 if it lets it out.
    pub sign: i8,
    /// Rated torque of the motor, unit of CiA 402 torques (N m).
    pub rated_torque_nm: f64,
    /// Encoder counts per motor turn.
    pub counts_per_turn: u32,
    /// Largest motor torque that the drive is told to permit (N m).
    pub torque_nm_max: f64,
    /// Vendor that the drive must show (1018:01); `None` for any.
    pub vendor_id: Option<u32>,
    /// Product code that it must show (1018:02); `None` for any.
    pub product_code: Option<u32>,
    /// What it does by itself when its master is silent.
    pub safe_hold: SafeHold,
}

/// Vendor and product code of sinew's simulated drive, whose guard of SYNC is objects 2000:01 and 2000:02.
pub const SIMULATED_DRIVE: (u32, u32) = (0, 0x5349_4e57);

/// What protects an arm against a master that is silent, and a drive may lack.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum Protection {
    /// 1400:05: without torques the drive goes safe.
    RpdoTimeout,
    /// Without SYNC the drive goes to its safe torque: 2000:01 and 2000:02 of the simulated drive.
    SyncGuard,
    /// 6087: the torque falls at a slope, not at once.
    TorqueSlope,
}

impl Protection {
    /// Every one.
    pub const ALL: [Self; 3] = [Self::RpdoTimeout, Self::SyncGuard, Self::TorqueSlope];

    /// As the configuration has it.
    pub const fn name(self) -> &'static str {
        match self {
            Self::RpdoTimeout => "rpdo_timeout",
            Self::SyncGuard => "sync_guard",
            Self::TorqueSlope => "torque_slope",
        }
    }
}

impl DriveConfig {
    /// Whether it is expected to be sinew's simulated drive, by its identity.
    pub fn is_simulated(&self) -> bool {
        (self.vendor_id, self.product_code) == (Some(SIMULATED_DRIVE.0), Some(SIMULATED_DRIVE.1))
    }

    /// Motor torque (N m, without sign) for a cable tension (N), friction not counted.
    pub fn torque_nm(&self, tension_n: f64) -> f64 {
        tension_n * self.drum_radius_m / self.gear_ratio
    }

    /// Step of the tension on the wire (N): a thousandth of the rated torque.
    pub fn tension_step_n(&self) -> f64 {
        1e-3 * self.rated_torque_nm * self.gear_ratio / self.drum_radius_m
    }

    /// Cable length per encoder count (m).
    pub fn length_per_count_m(&self) -> f64 {
        std::f64::consts::TAU * self.drum_radius_m / (self.gear_ratio * f64::from(self.counts_per_turn))
    }
}

/// All drives, in the order of the arm's cables (segment by segment).
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct DrivesConfig {
    /// Buses.
    pub buses: Vec<BusConfig>,
    /// One per cable.
    pub drives: Vec<DriveConfig>,
    /// Period of the master's and the drives' heartbeats (s).
    pub heartbeat_s: f64,
    /// Time without a heartbeat after which the other side is dead (s).
    pub heartbeat_timeout_s: f64,
    /// Time without SYNC, or without torques, after which a drive goes to its safe torque (s).
    pub sync_timeout_s: f64,
    /// Time granted to a drive for each SDO response (s).
    pub sdo_timeout_s: f64,
    /// Time granted to a drive from its reset to its boot-up (s).
    pub boot_timeout_s: f64,
    /// Cable tension to which a drive whose `safe_hold` is `ramp` goes when its master is dead (N).
    pub safe_tension_n: f64,
    /// Time in which a drive ramps to it (s).
    pub safe_ramp_s: f64,
    /// The master's own node id; `None` for the highest that no drive has.
    pub master_node_id: Option<u8>,
    /// Protection that drives may lack.
    pub accept_without: Vec<Protection>,
    /// Time between two looks at what the drives hold (s); 0 for none.
    pub read_back_s: f64,
    /// Bit of the statusword that is the input of an emergency stop; `None` for none.
    pub emergency_stop_bit: Option<u8>,
    /// Whether it is pressed where the bit is 0.
    pub emergency_stop_low: bool,
}

/// `[drives]`.
pub static DRIVES: TableSpec = TableSpec {
    header: "[drives]",
    name: "drives",
    about: "Buses, and the drive of every cable. The arm's cables, segment by segment, are dealt to the buses in equal runs with rising node ids; `[[drives.overrides]]` says where one differs.",
    keys: &[
        Key::default(
            "heartbeat_s",
            Kind::Float(Range::closed(0.001, 10.0)),
            "s",
            "0.05",
            "Period of the master's and the drives' heartbeats.",
        ),
        Key::default(
            "heartbeat_timeout_s",
            Kind::Float(Range::closed(0.002, 60.0)),
            "s",
            "0.15",
            "Time without a heartbeat after which the other side is dead; at least two heartbeats.",
        ),
        Key::default(
            "sync_timeout_s",
            Kind::Float(Range::closed(0.002, 10.0)),
            "s",
            "0.1",
            "Time without SYNC (guard 2000:01), or without torques (event timer 1400:05 of the RPDO, in whole milliseconds, rounded up), after which a drive does what its `safe_hold` says; at least two periods of the loop.",
        ),
        Key::default(
            "sdo_timeout_s",
            Kind::Float(Range::closed(0.005, 10.0)),
            "s",
            "0.1",
            "Time granted to a drive for each SDO response while it is configured, in whole milliseconds; after one that does not come, the transfer is aborted, the drive must be silent for as long, and the transfer is repeated, twice at most.",
        ),
        Key::default(
            "boot_timeout_s",
            Kind::Float(Range::closed(0.1, 120.0)),
            "s",
            "5.0",
            "Time granted to a drive from its reset to its boot-up, in whole milliseconds.",
        ),
        Key::default(
            "safe_tension_n",
            Kind::Float(Range::closed(0.0, 1e5)),
            "N",
            "0.0",
            "Cable tension to which a drive with `safe_hold = \"ramp\"` goes when its master is dead; at most the arm's `tension_n_max`.",
        ),
        Key::default(
            "safe_ramp_s",
            Kind::Float(Range::closed(0.0, 60.0)),
            "s",
            "0.2",
            "Time in which such a drive goes there from the largest tension.",
        ),
        Key::optional(
            "master_node_id",
            Kind::Integer(1, 127),
            "",
            "the highest that no drive has",
            "Node id of sinew's own heartbeat; no other node of any bus may have it.",
        ),
        Key::default(
            "accept_without",
            Kind::Texts(Length::Between(0, 3), 16),
            "",
            "[]",
            "Protection that drives may lack: `rpdo_timeout` (1400:05), `sync_guard` (2000:01 and 2000:02, which sinew's \
             simulated drive alone has), `torque_slope` (6087). A drive that lacks another is not used.",
        ),
        Key::default(
            "read_back_s",
            Kind::Float(Range::closed(0.0, 10.0)),
            "s",
            "0.02",
            "Time between two objects that are read back from the drives in operation, one after the other: every second one is a drive's torque limit (6072), the others are what was written at the start. One that was changed stops the arm. 0 for none. The tensions of `safe_hold = \"rest\"` are told as often.",
        ),
        Key::optional(
            "emergency_stop_bit",
            Kind::Integer(0, 15),
            "",
            "none",
            "Bit of the drives' statusword (6041) that is the input of an emergency stop; 8, 14 and 15 are the manufacturer's. Pressed at any drive, the arm stops, and may not be armed.",
        ),
        Key::default(
            "emergency_stop_low",
            Kind::Bool,
            "",
            "true",
            "Whether it is pressed where the bit is 0, so that a broken wire is a pressed stop.",
        ),
        Key::required(
            "buses",
            Kind::Tables(Length::Between(1, 16), &BUS),
            "",
            "The buses, in the order in which cables are dealt.",
        ),
        Key::required("defaults", Kind::Table(&DEFAULTS), "", "What the drives have in common."),
        Key::optional("overrides", Kind::Tables(Length::Between(1, 96), &OVERRIDE), "", "none", "Drives that differ."),
    ],
};

static BUS: TableSpec = TableSpec {
    header: "[[drives.buses]]",
    name: "buses",
    about: "One CAN bus.",
    keys: &[
        Key::required("name", Kind::Text(32), "", "Name in reports; different for every bus."),
        Key::required(
            "kind",
            Kind::Choice(&["virtual", "socketcan"]),
            "",
            "`virtual`: the user-space bus over shared memory; `socketcan`: an interface of the kernel.",
        ),
        Key::required(
            "interface",
            Kind::Text(15),
            "",
            "Interface, e.g. `can0`, or the virtual bus's name; different for every bus. An interface's transmit queue \
             (`txqueuelen`) must hold a cycle: a frame of torques for every drive, or one in the packed layout, and SYNC.",
        ),
        Key::default(
            "bitrate_bps",
            Kind::Integer(10_000, 1_000_000),
            "bit/s",
            "1000000",
            "Bit rate; with FD that of the arbitration phase.",
        ),
        Key::default("fd", Kind::Bool, "", "false", "CAN FD with bit-rate switch."),
        Key::optional(
            "data_bitrate_bps",
            Kind::Integer(100_000, 8_000_000),
            "bit/s",
            "5000000 with FD",
            "Bit rate of FD's data phase; only with `fd = true`.",
        ),
        Key::default(
            "layout",
            Kind::Choice(&["classic", "packed"]),
            "",
            "\"classic\"",
            "`classic`: classic frames, one of torque for each drive; `packed`: CAN FD frames with bit-rate switch, one of torque for all drives of the bus, at most 16; only with `fd = true`.",
        ),
        Key::default(
            "load_limit",
            Kind::Float(Range::above(0.0, 1.0)),
            "",
            "0.7",
            "Share of the bus that its cyclic traffic may take with worst-case stuffing.",
        ),
        Key::default("first_node_id", Kind::Integer(1, 127), "", "1", "Node id of the first cable dealt to this bus."),
    ],
};

const fn drive_key(name: &'static str, kind: Kind, unit: &'static str, meaning: &'static str) -> Key {
    Key::required(name, kind, unit, meaning)
}

const DRUM: Key =
    drive_key("drum_radius_m", Kind::Float(Range::above(0.0, 1.0)), "m", "Radius of the drum that the cable runs on.");
const GEAR: Key = drive_key("gear_ratio", Kind::Float(Range::above(0.0, 10_000.0)), "", "Motor turns per drum turn.");
const SIGN: Key = Key::default(
    "sign",
    Kind::Choice(&["+", "-"]),
    "",
    "\"+\"",
    "`+` if positive torque and rising position pull the cable in, `-` if they let it out.",
);
/// Least rated torque that object 6076 shows (N m).
pub(super) const RATED_NM_MIN: f64 = 1e-3;
const RATED: Key = drive_key(
    "rated_torque_nm",
    Kind::Float(Range::closed(RATED_NM_MIN, 1e4)),
    "N m",
    "Rated torque of the motor as its drive shows it (object 6076, whole mN m); drives count torque in thousandths of it.",
);
const COUNTS: Key = drive_key("counts_per_turn", Kind::Integer(1, 100_000_000), "", "Encoder counts per motor turn.");
const LIMIT: Key = drive_key(
    "torque_nm_max",
    Kind::Float(Range::above(0.0, 1e4)),
    "N m",
    "Largest motor torque that the drive permits; at least what `tension_n_max` needs, at most ten times the rated torque.",
);

const VENDOR: Key = Key::optional(
    "vendor_id",
    Kind::Integer(0, u32::MAX as i64),
    "",
    "any",
    "Vendor that the drive must show (1018:01) before anything is written to it.",
);
const PRODUCT: Key = Key::optional(
    "product_code",
    Kind::Integer(0, u32::MAX as i64),
    "",
    "any",
    "Product code that it must show (1018:02). Vendor 0 with product code 0x53494e57 is sinew's simulated drive: objects of \
     its own are written to no other.",
);

static DEFAULTS: TableSpec = TableSpec {
    header: "[drives.defaults]",
    name: "defaults",
    about: "What the drives have in common.",
    keys: &[DRUM, GEAR, SIGN, RATED, COUNTS, LIMIT, VENDOR, PRODUCT, safe_hold::KEY],
};

static OVERRIDE: TableSpec = TableSpec {
    header: "[[drives.overrides]]",
    name: "overrides",
    about: "A drive that differs: which cable, and what is different. Other keys are taken from `[drives.defaults]`.",
    keys: &[
        Key::required("segment", Kind::Integer(1, 16), "", "Segment of the cable, from 1."),
        Key::required("cable", Kind::Integer(1, 12), "", "Number of the cable within the segment, from 1."),
        Key::optional("bus", Kind::Text(32), "", "as dealt", "Name of its bus."),
        Key::optional(
            "node_id",
            Kind::Integer(1, 127),
            "",
            "as dealt",
            "Its CANopen node id; different for every drive of a bus.",
        ),
        DRUM,
        GEAR,
        SIGN,
        RATED,
        COUNTS,
        LIMIT,
        VENDOR,
        PRODUCT,
        safe_hold::KEY,
    ],
};

/// Why no bus of this kind can have this name; `None` if one can.
fn misnamed(kind: BusKind, interface: &str) -> Option<String> {
    match kind {
        BusKind::Virtual => sinew_hal::virtual_bus::path_of(interface).err().map(|error| error.to_string()),
        // As the kernel's own check of a device's name.
        BusKind::Socketcan => {
            let refused = |c: char| c == '/' || c == ':' || c.is_whitespace();
            (matches!(interface, "." | "..") || interface.contains(refused))
                .then(|| format!("{interface:?} is no name of a network interface"))
        }
    }
}

/// Reads `[drives]` for this arm and this period of the loop (`None` where no loop is configured).
pub(super) fn read(table: &Section<'_>, arm: &ArmConfig, period_s: Option<f64>) -> DrivesConfig {
    let bus_tables = table.tables("buses", None);
    let mut first_ids = Vec::new();
    let mut buses: Vec<BusConfig> = Vec::new();
    for section in &bus_tables {
        let bus = bus(section);
        if let Some(why) = misnamed(bus.kind, &bus.interface)
            && section.is_clean()
        {
            section.refuse("interface", why, "permitted: e.g. `can0`, or for a virtual bus `arm0`");
        }
        for (key, taken) in [
            ("name", buses.iter().any(|b| b.name == bus.name)),
            ("interface", buses.iter().any(|b| b.interface == bus.interface)),
        ] {
            if taken {
                section.refuse(key, "another bus has it already", "permitted: different for every bus");
            }
        }
        first_ids.push(section.count("first_node_id"));
        buses.push(bus);
    }

    let defaults = Rc::new(table.table("defaults"));
    let overrides = table.tables("overrides", Some(&defaults));
    // A cable's position, counted from 0 over the whole arm, to its override.
    let mut differing = BTreeMap::new();
    for section in &overrides {
        let (segment, cable) = (section.count("segment"), section.count("cable"));
        let exists =
            arm.segments.get(segment.wrapping_sub(1)).is_some_and(|s| (1..=s.hole_angles_rad.len()).contains(&cable));
        if !exists && section.is_clean() {
            section.refuse(
                "cable",
                format!("the arm has no cable {segment},{cable}"),
                "permitted: a cable of the arm, `segment` and `cable` from 1",
            );
        } else if differing.insert((segment, cable), section).is_some() {
            section.refuse(
                "cable",
                format!("cable {segment},{cable} has an override already"),
                "permitted: one override per cable",
            );
        }
    }

    let numbered: Vec<(usize, usize)> = arm
        .segments
        .iter()
        .enumerate()
        .flat_map(|(s, segment)| (1..=segment.hole_angles_rad.len()).map(move |cable| (s + 1, cable)))
        .collect();
    let run = numbered.len().div_ceil(buses.len().max(1));
    let mut drives = Vec::with_capacity(numbered.len());
    let mut taken: BTreeMap<(usize, usize), (usize, usize)> = BTreeMap::new();
    for (index, &(segment, cable)) in numbered.iter().enumerate() {
        let dealt_bus = index / run.max(1);
        let dealt_node = first_ids.get(dealt_bus).copied().unwrap_or(1) + index % run.max(1);
        let common;
        let section = match differing.get(&(segment, cable)) {
            Some(section) => *section,
            None => {
                common = table.absent(&OVERRIDE, format!("drives of cable {segment},{cable}"), Some(&defaults));
                &common
            }
        };
        let is_own = section.is_present();
        let bus = match is_own.then(|| section.text_opt("bus")).flatten() {
            Some(name) => buses.iter().position(|bus| bus.name == name).unwrap_or_else(|| {
                let names: Vec<_> = buses.iter().map(|bus| bus.name.as_str()).collect();
                section.refuse("bus", "there is no such bus", &format!("permitted: {}", names.join(", ")));
                0
            }),
            None => dealt_bus,
        };
        let node = is_own.then(|| section.count_opt("node_id")).flatten().unwrap_or(dealt_node);
        if let Some((other_segment, other_cable)) = taken.insert((bus, node), (segment, cable))
            && table.is_clean()
        {
            let bus = buses.get(bus).map_or("", |bus| bus.name.as_str());
            let message = format!(
                "node id {node} of bus `{bus}` is taken twice, by cable {other_segment},{other_cable} and by cable {segment},{cable}"
            );
            let help = "permitted: node ids 1 to 127, different for every drive of a bus";
            // The override that can be edited: this cable's, or the one that it collides with.
            match (is_own, differing.get(&(other_segment, other_cable))) {
                (false, Some(other)) => other.refuse("node_id", message, help),
                (true, _) => section.refuse("node_id", message, help),
                (false, None) => table.refuse("buses", message, help),
            }
        }
        if node > 127 && table.is_clean() {
            let message = format!("cable {segment},{cable} would get node id {node}");
            table.refuse("buses", message, "permitted: node ids 1 to 127; use more buses or lower `first_node_id`");
        }
        let drive = drive(section, segment, cable, bus, node);
        let own = arm.segments.get(segment.wrapping_sub(1)).map_or(arm.tension_n_max, |s| arm.segment_tension_n_max(s));
        check_torque(section, own, &drive);
        safe_hold::check(section, &drive);
        drives.push(drive);
    }
    check_layouts(&bus_tables, &buses, &drives);
    let config = DrivesConfig {
        buses,
        drives,
        heartbeat_s: table.float("heartbeat_s"),
        heartbeat_timeout_s: table.float("heartbeat_timeout_s"),
        sync_timeout_s: table.float("sync_timeout_s"),
        sdo_timeout_s: table.float("sdo_timeout_s"),
        boot_timeout_s: table.float("boot_timeout_s"),
        safe_tension_n: table.float("safe_tension_n"),
        safe_ramp_s: table.float("safe_ramp_s"),
        master_node_id: table.integer_opt("master_node_id").and_then(|id| u8::try_from(id).ok()),
        accept_without: accept_without(table),
        read_back_s: table.float("read_back_s"),
        emergency_stop_bit: table.integer_opt("emergency_stop_bit").and_then(|bit| u8::try_from(bit).ok()),
        emergency_stop_low: table.boolean("emergency_stop_low"),
    };
    if let Some(drive) = config.drives.iter().find(|d| Some(d.node_id) == config.master_node_id)
        && table.is_clean()
    {
        let message = format!("the drive of cable {},{} has it", drive.segment, drive.cable);
        table.refuse("master_node_id", message, "permitted: 1 to 127, different from every drive's");
    }
    if let Some(drive) = config.drives.iter().find(|d| !d.is_simulated())
        && !config.accept_without.contains(&Protection::SyncGuard)
        && table.is_clean()
    {
        let message = format!(
            "the drive of cable {},{} is not expected to be sinew's simulated one (`vendor_id`, `product_code`), so it has \
             no guard of SYNC that sinew knows",
            drive.segment, drive.cable
        );
        let help = "add \"sync_guard\": a silent master is then noticed by the drive's heartbeat consumer (1016) and by the \
                    time-out of its torques (1400:05)";
        table.refuse("accept_without", message, help);
    }
    check_times(table, &config, arm, period_s);
    config
}

fn accept_without(table: &Section<'_>) -> Vec<Protection> {
    let mut accepted = Vec::new();
    for text in table.texts_opt("accept_without").unwrap_or_default() {
        match Protection::ALL.into_iter().find(|protection| protection.name() == text) {
            Some(protection) => accepted.push(protection),
            None => {
                let names: Vec<String> = Protection::ALL.iter().map(|p| format!("\"{}\"", p.name())).collect();
                let help = format!("permitted: some of {}", names.join(", "));
                table.refuse("accept_without", format!("there is no protection \"{text}\""), &help);
            }
        }
    }
    accepted
}

fn bus(section: &Section<'_>) -> BusConfig {
    let bitrate_bps = section.integer("bitrate_bps") as u32;
    let fd = section.boolean("fd");
    let data =
        if fd { section.integer_opt("data_bitrate_bps").map_or(5_000_000, |rate| rate as u32) } else { bitrate_bps };
    if data < bitrate_bps {
        section.refuse(
            "data_bitrate_bps",
            "below `bitrate_bps`",
            &format!("permitted: {bitrate_bps} to 8000000 bit/s"),
        );
    }
    let layout = if section.choice("layout") == "packed" { BusLayout::Packed } else { BusLayout::Classic };
    if layout == BusLayout::Packed && !fd {
        section.refuse(
            "layout",
            "packed torques do not fit the 8 bytes of a classic frame",
            "permitted: `classic`, or `packed` with `fd = true` on an interface that carries CAN FD",
        );
    }
    BusConfig {
        name: section.text("name"),
        kind: if section.choice("kind") == "socketcan" { BusKind::Socketcan } else { BusKind::Virtual },
        interface: section.text("interface"),
        bitrate_bps,
        fd,
        data_bitrate_bps: data,
        layout,
        load_limit: section.float("load_limit"),
    }
}

fn check_layouts(sections: &[Section<'_>], buses: &[BusConfig], drives: &[DriveConfig]) {
    for (index, (section, bus)) in sections.iter().zip(buses).enumerate() {
        let count = drives.iter().filter(|drive| drive.bus == index).count();
        if bus.layout == BusLayout::Packed && count > PACKED_DRIVES_MAX && section.is_clean() {
            section.refuse(
                "layout",
                format!("bus `{}` has {count} drives, but a packed frame has places for {PACKED_DRIVES_MAX}", bus.name),
                &format!("permitted: at most {PACKED_DRIVES_MAX} drives on a packed bus; use more buses"),
            );
        }
    }
}

fn drive(section: &Section<'_>, segment: usize, cable: usize, bus: usize, node: usize) -> DriveConfig {
    DriveConfig {
        segment,
        cable,
        bus,
        node_id: u8::try_from(node).unwrap_or(0),
        drum_radius_m: section.float("drum_radius_m"),
        gear_ratio: section.float("gear_ratio"),
        sign: if section.choice("sign") == "-" { -1 } else { 1 },
        rated_torque_nm: section.float("rated_torque_nm"),
        counts_per_turn: section.integer("counts_per_turn") as u32,
        torque_nm_max: section.float("torque_nm_max"),
        vendor_id: section.integer_opt("vendor_id").and_then(|id| u32::try_from(id).ok()),
        product_code: section.integer_opt("product_code").and_then(|code| u32::try_from(code).ok()),
        safe_hold: safe_hold::read(section),
    }
}

fn check_torque(section: &Section<'_>, tension_n_max: f64, drive: &DriveConfig) {
    let needed = drive.torque_nm(tension_n_max);
    let most = 10.0 * drive.rated_torque_nm;
    if drive.torque_nm_max >= needed && drive.torque_nm_max <= most || !section.is_clean() {
        return;
    }
    let help = format!(
        "permitted: {needed:.4} N m ({} N on a drum of {} m behind a gear of {}) to {most} N m",
        tension_n_max, drive.drum_radius_m, drive.gear_ratio
    );
    section.refuse("torque_nm_max", "does not fit the arm's `tension_n_max` or the rated torque", &help);
}

fn check_times(table: &Section<'_>, config: &DrivesConfig, arm: &ArmConfig, period_s: Option<f64>) {
    if config.heartbeat_timeout_s < 2.0 * config.heartbeat_s {
        let help = format!("permitted: {} s (two heartbeats) to 60 s", 2.0 * config.heartbeat_s);
        table.refuse("heartbeat_timeout_s", "shorter than two heartbeats", &help);
    }
    if let Some(period_s) = period_s
        && config.sync_timeout_s < 2.0 * period_s
    {
        let help = format!("permitted: {} s (two periods of the loop) to 10 s", 2.0 * period_s);
        table.refuse("sync_timeout_s", "shorter than two periods of the loop", &help);
    }
    if config.safe_tension_n > arm.tension_n_max {
        let help = format!("permitted: 0 to {} N", arm.tension_n_max);
        table.refuse("safe_tension_n", "above the arm's `tension_n_max`", &help);
    }
}
