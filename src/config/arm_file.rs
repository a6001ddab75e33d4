//! `[arm]`: reading and checking the arm.

use super::arm::{ArmConfig, ChordRule, PayloadConfig, Routing, SegmentConfig, StrainRule};
use super::error::ConfigError;
use super::reader::{self, Document, Section};
use super::schema::{Key, Kind, Length, Range, TableSpec};
use super::stations::{self, DEFAULT_PLACE, DEFAULT_STATION, PLACE, STATION, route_key, stations_key};
use std::path::Path;
use std::rc::Rc;

/// `[arm]`.
pub static ARM: TableSpec = TableSpec {
    header: "[arm]",
    name: "arm",
    about: "The arm: base, cables' limits, integrator, and its segments from base to tip.",
    keys: &[
        Key::required(
            "name",
            Kind::Text(32),
            "",
            "Name; part of the names of its shared-memory services: letters, digits, `-`, `_`.",
        ),
        Key::default(
            "base_position_m",
            Kind::Floats(Length::Exactly(3), Range::closed(-100.0, 100.0)),
            "m",
            "[0.0, 0.0, 0.0]",
            "Position of the clamped base node, base frame.",
        ),
        Key::default(
            "base_quaternion",
            Kind::Quaternion,
            "",
            "[0.7071067811865476, 0.0, 0.7071067811865476, 0.0]",
            "Orientation of the base node, body to base frame; local x is the backbone's tangent. The default points it to -z.",
        ),
        Key::default(
            "gravity_mps2",
            Kind::Floats(Length::Exactly(3), Range::closed(-100.0, 100.0)),
            "m/s^2",
            "[0.0, 0.0, 0.0]",
            "Gravity, base frame; none in the paper.",
        ),
        Key::default(
            "damping_mass_1ps",
            Kind::Float(Range::closed(0.0, 1000.0)),
            "1/s",
            "0.0",
            "Mass-proportional damping.",
        ),
        Key::default(
            "chord",
            Kind::Choice(&["simpson", "trapezoid"]),
            "",
            "\"simpson\"",
            "How an element's chord follows from its tangents. Stiffness is not transferable between the two.",
        ),
        Key::default(
            "strain",
            Kind::Choice(&["vector_part", "logarithm"]),
            "",
            "\"vector_part\"",
            "How an element's curvature follows from the quaternions of its nodes.",
        ),
        Key::default(
            "routing",
            Kind::Choice(&["local", "through"]),
            "",
            "\"local\"",
            "`local`: a segment's cables act from its own base disk, before it they run in sheaths; `through`: they run through holes in every disk from the robot's base on.",
        ),
        Key::default(
            "rho_inf",
            Kind::Float(Range::closed(0.0, 1.0)),
            "",
            "0.8",
            "Spectral radius of the generalised-alpha integrator.",
        ),
        Key::default(
            "tension_n_min",
            Kind::Float(Range::closed(0.0, 1e5)),
            "N",
            "0.0",
            "Least tension of every cable; above 0 on hardware, so that no cable goes slack.",
        ),
        Key::required("tension_n_max", Kind::Float(Range::above(0.0, 1e5)), "N", "Largest tension of every cable."),
        Key::optional(
            "tension_rate_npsmax",
            Kind::Float(Range::above(0.0, 1e7)),
            "N/s",
            "5 tension_n_max omega; unlimited in a scenario's plan",
            "Largest change of a tension per second, however a target is given; part of each tick's box. omega is the first angular frequency of the straight arm.",
        ),
        Key::default(
            "payload_mass_kg",
            Kind::Float(Range::closed(0.0, 1000.0)),
            "kg",
            "0.0",
            "Point mass at the last node.",
        ),
        Key::optional(
            "segment_count",
            Kind::Integer(1, 16),
            "",
            "one per `[[arm.segments]]`",
            "Number of equal segments, all as `[arm.segment_defaults]` says.",
        ),
        Key::optional(
            "segment_defaults",
            Kind::Table(&SEGMENT_DEFAULTS),
            "",
            "none",
            "What the segments have in common.",
        ),
        Key::optional(
            "segments",
            Kind::Tables(Length::Between(1, 16), &SEGMENT),
            "",
            "none",
            "The segments, base to tip, each with what differs from the defaults; give this or `segment_count`, or both with the same number.",
        ),
    ],
};

const POSITIVE_LENGTH: Kind = Kind::Float(Range::above(0.0, 10.0));

/// Keys of a segment; the same in the defaults and in each segment.
const fn segment_keys(stations: Key, route: Key) -> [Key; 24] {
    [
        Key::required("length_m", POSITIVE_LENGTH, "m", "Backbone length without the connector."),
        Key::required("elements", Kind::Integer(1, 50), "", "Number of beam elements, each with a disk at its end."),
        Key::required("bending_stiffness_nm2", Kind::Float(Range::above(0.0, 1e6)), "N m^2", "EI."),
        Key::required("torsional_stiffness_nm2", Kind::Float(Range::above(0.0, 1e6)), "N m^2", "GJ."),
        Key::required(
            "damping_stiffness_s",
            Kind::Float(Range::closed(0.0, 10.0)),
            "s",
            "Stiffness-proportional damping beta; 0.0005 to 0.05 s were tried.",
        ),
        Key::required("disk_mass_kg", Kind::Float(Range::above(0.0, 100.0)), "kg", "Mass of one disk."),
        Key::required(
            "disk_radius_m",
            POSITIVE_LENGTH,
            "m",
            "Radius of a disk: its inertia, and the body's default radius.",
        ),
        Key::required("disk_thickness_m", POSITIVE_LENGTH, "m", "Thickness of a disk."),
        Key::required(
            "backbone_mass_kgpm",
            Kind::Float(Range::closed(0.0, 100.0)),
            "kg/m",
            "Backbone mass per length, lumped at the nodes.",
        ),
        Key::required("backbone_radius_m", POSITIVE_LENGTH, "m", "Backbone radius, for its rotary inertia."),
        Key::default(
            "connector_length_m",
            Kind::Float(Range::closed(0.0, 10.0)),
            "m",
            "0.0",
            "Rigid connector behind the end disk; the last segment has none, whatever the defaults say.",
        ),
        Key::default(
            "connector_mass_kg",
            Kind::Float(Range::closed(0.0, 100.0)),
            "kg",
            "0.0",
            "Mass that the connector adds at the end disk; the last segment has none.",
        ),
        Key::required("hole_radius_m", POSITIVE_LENGTH, "m", "Radius of the circle of cable holes."),
        Key::optional(
            "tension_n_max",
            Kind::Float(Range::above(0.0, 1e5)),
            "N",
            "the arm's",
            "Largest tension of the segment's cables; at most the arm's, above its least.",
        ),
        Key::optional(
            "cables",
            Kind::Integer(1, 12),
            "",
            "as many as `hole_angles_deg`",
            "Number of cables, equally spaced; fewer than three do not bend a segment to every side (`sinew check`).",
        ),
        Key::default(
            "hole_start_deg",
            Kind::Float(Range::closed(-360.0, 360.0)),
            "deg",
            "0.0",
            "Angle of cable 1 from local y towards local z, with `cables`.",
        ),
        Key::default(
            "hole_offset_deg",
            Kind::Float(Range::closed(-360.0, 360.0)),
            "deg",
            "0.0",
            "Added to all hole angles of the segment, so that segments can differ by it alone.",
        ),
        Key::optional(
            "hole_angles_deg",
            Kind::Floats(Length::Between(1, 12), Range::closed(-720.0, 720.0)),
            "deg",
            "equally spaced",
            "Angle of each cable's hole, in place of `cables` and `hole_start_deg`.",
        ),
        Key::optional(
            "cables_from",
            Kind::Integer(1, 16),
            "",
            "as `routing` says",
            "Segment, counted from 1, from whose base the cables run through the disks; before it they run in sheaths.",
        ),
        Key::optional(
            "cable_end_disks",
            Kind::Floats(Length::Between(1, 12), Range::closed(1.0, 50.0)),
            "",
            "the last one",
            "Disk of the segment, counted from 1, at which each cable ends.",
        ),
        Key::optional(
            "cable_stiffness_n",
            Kind::Float(Range::above(0.0, 1e9)),
            "N",
            "cables do not stretch",
            "Axial stiffness EA of each cable: force over strain. Encoders then tell the length that the drum has let out, and the arm's follows by the tension.",
        ),
        Key::default(
            "cable_feed_m",
            Kind::Float(Range::closed(0.0, 100.0)),
            "m",
            "0.0",
            "Length of each cable between its drum and the arm, which stretches as well.",
        ),
        stations,
        route,
    ]
}

static SEGMENT_DEFAULTS: TableSpec = TableSpec {
    header: "[arm.segment_defaults]",
    name: "segment_defaults",
    about: "What the segments have in common: the keys of `[[arm.segments]]`. A key is required in one of the two places.",
    keys: &segment_keys(stations_key(&DEFAULT_STATION), route_key(&DEFAULT_PLACE)),
};

static SEGMENT: TableSpec = TableSpec {
    header: "[[arm.segments]]",
    name: "segments",
    about: "One segment, base to tip. A key that is absent is taken from `[arm.segment_defaults]`.",
    keys: &segment_keys(stations_key(&STATION), route_key(&PLACE)),
};

/// Most cables of an arm.
const CABLES_MAX: usize = 96;
/// Least length of an element over the thickness of its disk: of shorter ones the disks would lie inside one another.
const ELEMENT_MIN: f64 = 0.5;

/// Builds the arm from an opened document.
pub(super) fn arm(document: &Document<'_>) -> ArmConfig {
    let table = document.table(&ARM);
    let name = table.text("name");
    if !name.chars().all(|c| c.is_ascii_alphanumeric() || c == '-' || c == '_') {
        table.refuse("name", "contains other characters", "permitted: letters, digits, `-` and `_`");
    }
    let arm = ArmConfig {
        name,
        base_position_m: table.vector("base_position_m"),
        base_quaternion: table.quaternion("base_quaternion"),
        gravity_mps2: table.vector("gravity_mps2"),
        damping_mass_1ps: table.float("damping_mass_1ps"),
        chord: if table.choice("chord") == "trapezoid" { ChordRule::Trapezoid } else { ChordRule::Simpson },
        strain: if table.choice("strain") == "logarithm" { StrainRule::Logarithm } else { StrainRule::VectorPart },
        routing: if table.choice("routing") == "through" { Routing::Through } else { Routing::Local },
        rho_inf: table.float("rho_inf"),
        tension_n_min: table.float("tension_n_min"),
        tension_n_max: table.float("tension_n_max"),
        tension_rate_npsmax: table.float_opt("tension_rate_npsmax").unwrap_or(f64::INFINITY),
        payload: PayloadConfig { mass_kg: table.float("payload_mass_kg") },
        segments: segments(&table),
    };
    if arm.cable_count() > CABLES_MAX {
        let help = format!("permitted: at most {CABLES_MAX} cables in all, and at least one for each segment");
        table.refuse("segments", format!("{} cables", arm.cable_count()), &help);
    }
    if arm.tension_n_min >= arm.tension_n_max {
        table.refuse(
            "tension_n_min",
            "not below `tension_n_max`",
            &format!("permitted: 0 to less than {} N", arm.tension_n_max),
        );
    }
    arm
}

/// What a segment needs of the arm: its number (0-based), whether it is the last one, least and largest tension (N), whether
/// cables run through all disks.
struct Of {
    index: usize,
    last: bool,
    low_n: f64,
    high_n: f64,
    through: bool,
}

fn segments(table: &Section<'_>) -> Vec<SegmentConfig> {
    let (low_n, high_n) = (table.float("tension_n_min"), table.float("tension_n_max"));
    let through = table.choice("routing") == "through";
    let of = |index, count| Of { index, last: index + 1 == count, low_n, high_n, through };
    let defaults = Rc::new(table.table("segment_defaults"));
    let listed = table.tables("segments", Some(&defaults));
    let count = table.count_opt("segment_count");
    match (count, listed.len()) {
        (Some(count), given) if given > 0 && count != given => {
            let help = format!("permitted: {given}, the number of [[arm.segments]], or leave one of the two out");
            table.refuse("segment_count", format!("but there are {given} [[arm.segments]]"), &help);
        }
        (None, 0) if table.is_present() && !table.has("segment_count") && !table.has("segments") => {
            let help =
                "permitted: `segment_count` 1 to 16 with [arm.segment_defaults], or 1 to 16 tables [[arm.segments]]";
            table.refuse("segments", "the arm has no segments", help);
        }
        _ => {}
    }
    if listed.is_empty() {
        let count = count.unwrap_or(0);
        let one = |index| table.absent(&SEGMENT, format!("arm.segments[{index}]"), Some(&defaults));
        (0..count).map(|index| segment(&one(index), &of(index, count))).collect()
    } else {
        listed.iter().enumerate().map(|(index, section)| segment(section, &of(index, listed.len()))).collect()
    }
}

fn segment(section: &Section<'_>, of: &Of) -> SegmentConfig {
    let connector = |name: &'static str| {
        let value = section.float(name);
        if !of.last {
            return value;
        }
        if section.has_own(name) && value != 0.0 {
            section.refuse(name, "the last segment has no connector behind it", "permitted at the last segment: 0");
        }
        0.0
    };
    let (numbers, taper) = stations::numbers(section);
    let cables_from = cables_from(section, of);
    let usual = if of.through { 0 } else { of.index };
    let (hole_radius_m, route) = stations::route(section, of.index, cables_from.unwrap_or(usual));
    let hole_angles_rad = hole_angles(section);
    let elements = section.count("elements");
    let config = SegmentConfig {
        length_m: section.float("length_m"),
        elements,
        bending_stiffness_nm2: numbers.bending,
        torsional_stiffness_nm2: numbers.torsion,
        damping_stiffness_s: section.float("damping_stiffness_s"),
        disk_mass_kg: numbers.disk_mass,
        disk_radius_m: numbers.disk_radius,
        disk_thickness_m: section.float("disk_thickness_m"),
        backbone_mass_kgpm: numbers.backbone_mass,
        backbone_radius_m: numbers.backbone_radius,
        connector_length_m: connector("connector_length_m"),
        connector_mass_kg: connector("connector_mass_kg"),
        hole_radius_m,
        cable_ends: cable_ends(section, elements, hole_angles_rad.len()),
        hole_angles_rad,
        tension_n_max: section.float_opt("tension_n_max"),
        taper,
        route,
        cables_from,
        cable_stiffness_n: section.float_opt("cable_stiffness_n"),
        cable_feed_m: section.float("cable_feed_m"),
    };
    let (low_n, high_n) = (of.low_n, of.high_n);
    if !config.tension_n_max.is_none_or(|n| n > low_n && n <= high_n) && section.is_clean() {
        let help = format!("permitted: > {low_n} N (`tension_n_min`) and <= {high_n} N (`tension_n_max` of the arm)");
        section.refuse("tension_n_max", "outside the arm's tension box", &help);
    }
    let element_m = config.length_m / config.elements as f64;
    if element_m < ELEMENT_MIN * config.disk_thickness_m && section.is_clean() {
        let help = format!(
            "permitted: {} m or more (`elements` times half of `disk_thickness_m`); or fewer elements",
            ELEMENT_MIN * config.disk_thickness_m * config.elements as f64
        );
        section.refuse("length_m", format!("an element is {element_m} m long, shorter than half a disk"), &help);
    }
    check_holes(section, of.index, &config);
    config
}

/// Refuses holes outside a disk of the segment.
fn check_holes(section: &Section<'_>, index: usize, config: &SegmentConfig) {
    if config.route.radius.is_empty() && config.taper.disk_radius.is_empty() {
        if config.hole_radius_m > config.disk_radius_m {
            let help = format!("permitted: > 0 and <= {} m", config.disk_radius_m);
            section.refuse("hole_radius_m", "the holes lie outside the disk (`disk_radius_m`)", &help);
        }
        return;
    }
    for disk in 1..=config.elements {
        let place = disk as f64 / config.elements as f64;
        let hole_m = config.hole_radius_m * config.route.radius.at(index as f64 + place, 1.0);
        let disk_m = config.disk_radius_m * config.taper.disk_radius.at(place, 1.0);
        if hole_m > disk_m * (1.0 + 1e-9) {
            let key = if config.route.radius.is_empty() { "stations" } else { "route" };
            let message =
                format!("disk {disk} has holes at {hole_m:.4} m, outside its `disk_radius_m` of {disk_m:.4} m");
            section.refuse(key, message, "permitted: holes within every disk of the segment");
            return;
        }
    }
}

/// The segment (0-based) that the cables start at, where the file says.
fn cables_from(section: &Section<'_>, of: &Of) -> Option<usize> {
    let from = section.count_opt("cables_from")?;
    if from > of.index + 1 {
        let help = format!("permitted: 1 to {}, its own", of.index + 1);
        section.refuse("cables_from", "lies behind the segment itself", &help);
        return None;
    }
    Some(from - 1)
}

/// Where the cables end, as shares of the segment's elements.
fn cable_ends(section: &Section<'_>, elements: usize, cables: usize) -> Vec<f64> {
    let Some(disks) = section.floats_opt("cable_end_disks") else { return Vec::new() };
    if disks.len() != cables && section.is_clean() {
        let help = format!("permitted: {cables}, one for each cable");
        section.refuse("cable_end_disks", format!("{} disks", disks.len()), &help);
    }
    if disks.iter().any(|disk| disk.fract() != 0.0 || *disk > elements as f64) {
        let help = format!("permitted: whole numbers from 1 to {elements}, the segment's `elements`");
        section.refuse("cable_end_disks", "names a disk that the segment does not have", &help);
        return Vec::new();
    }
    disks.iter().map(|disk| disk / elements as f64).collect()
}

fn hole_angles(section: &Section<'_>) -> Vec<f64> {
    let offset = section.float("hole_offset_deg");
    // A segment's own choice between the two ways overrides the other way in the defaults.
    for name in ["cables", "hole_start_deg", "hole_angles_deg"] {
        section.ignore_behind(name);
    }
    let explicit = section.has_own("hole_angles_deg") || (section.has("hole_angles_deg") && !section.has_own("cables"));
    if explicit {
        if section.has_own("hole_angles_deg") && section.has_own("cables") {
            section.refuse("cables", "`hole_angles_deg` is given as well", "give one of the two");
        }
        return section.floats("hole_angles_deg").iter().map(|angle| (angle + offset).to_radians()).collect();
    }
    let start = section.float("hole_start_deg");
    let Some(cables) = section.count_opt("cables") else {
        if section.is_clean() {
            section.refuse(
                "cables",
                "neither `cables` nor `hole_angles_deg` is given",
                "permitted: `cables` 1 to 12, or 1 to 12 angles",
            );
        }
        return Vec::new();
    };
    (0..cables).map(|cable| (start + offset + 360.0 / cables as f64 * cable as f64).to_radians()).collect()
}

impl ArmConfig {
    /// Reads the table `[arm]` of one file; other tables in it are not looked at.
    ///
    /// # Errors
    /// Everything wrong in the file, as [`ConfigError`].
    pub fn load(path: &Path) -> Result<Self, ConfigError> {
        reader::read_files(&[path.to_path_buf()], super::KNOWN_TABLES, arm)
    }

    /// Reads the table `[arm]` of a text; `name` stands for the file in messages.
    ///
    /// # Errors
    /// Everything wrong in the text, as [`ConfigError`].
    pub fn parse(name: &str, text: &str) -> Result<Self, ConfigError> {
        reader::read(vec![(name.to_owned(), text.to_owned())], super::KNOWN_TABLES, arm)
    }
}
