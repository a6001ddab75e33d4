//! `[[arm.segments.stations]]` and `[[arm.segments.route]]`: what changes along a segment, and where its cables run.

use super::arm::{Route, Taper};
use super::profile::Profile;
use super::reader::Section;
use super::schema::{Key, Kind, Length, Range, TableSpec};

/// Most stations of a segment.
const STATIONS_MAX: usize = 200;
const STATIONS: Length = Length::Between(1, STATIONS_MAX);

/// `stations` among the keys of a segment.
pub(super) const fn stations_key(spec: &'static TableSpec) -> Key {
    Key::optional(
        "stations",
        Kind::Tables(STATIONS, spec),
        "",
        "the same all along",
        "What changes along the segment, from its base to its end. A number that stations give is not given beside them.",
    )
}

/// `route` among the keys of a segment.
pub(super) const fn route_key(spec: &'static TableSpec) -> Key {
    Key::optional(
        "route",
        Kind::Tables(STATIONS, spec),
        "",
        "parallel to the backbone",
        "Where the holes of the segment's cables lie along the arm, from base to tip.",
    )
}

const POSITIVE_LENGTH: Kind = Kind::Float(Range::above(0.0, 10.0));
const POSITIVE: Kind = Kind::Float(Range::above(0.0, 1e6));

/// `stations` of a segment.
pub(super) static STATION: TableSpec = station("[[arm.segments.stations]]");
/// `stations` of the defaults.
pub(super) static DEFAULT_STATION: TableSpec = station("[[arm.segment_defaults.stations]]");

const fn station(header: &'static str) -> TableSpec {
    TableSpec {
        header,
        name: "stations",
        about: "Values at one place of a segment; linear between the stations that give them, constant before the first and behind the last. Two stations at the same place make a step.",
        keys: STATION_KEYS,
    }
}

const STATION_KEYS: &[Key] = &[
    Key::required(
        "at",
        Kind::Float(Range::closed(0.0, 1.0)),
        "",
        "Place: share of the segment's length; not before that of the station above.",
    ),
    Key::optional(
        "bending_stiffness_nm2",
        POSITIVE,
        "N m^2",
        "as its neighbours",
        "EI. An element bends as the beam there does.",
    ),
    Key::optional("torsional_stiffness_nm2", POSITIVE, "N m^2", "as its neighbours", "GJ."),
    Key::optional(
        "backbone_mass_kgpm",
        Kind::Float(Range::above(0.0, 100.0)),
        "kg/m",
        "as its neighbours",
        "Backbone mass per length.",
    ),
    Key::optional("backbone_radius_m", POSITIVE_LENGTH, "m", "as its neighbours", "Backbone radius."),
    Key::optional(
        "disk_mass_kg",
        Kind::Float(Range::above(0.0, 100.0)),
        "kg",
        "as its neighbours",
        "Mass of a disk at this place.",
    ),
    Key::optional("disk_radius_m", POSITIVE_LENGTH, "m", "as its neighbours", "Radius of a disk at this place."),
];

/// `route` of a segment.
pub(super) static PLACE: TableSpec = place("[[arm.segments.route]]");
/// `route` of the defaults.
pub(super) static DEFAULT_PLACE: TableSpec = place("[[arm.segment_defaults.route]]");

const fn place(header: &'static str) -> TableSpec {
    TableSpec {
        header,
        name: "route",
        about: "Holes of the segment's cables at one place of the arm; linear between places, constant before the first and behind the last.",
        keys: PLACE_KEYS,
    }
}

const PLACE_KEYS: &[Key] = &[
    Key::optional(
        "segment",
        Kind::Integer(1, 16),
        "",
        "the cables' own",
        "Segment of the place, counted from 1; one that the cables pass, or their own.",
    ),
    Key::required(
        "at",
        Kind::Float(Range::closed(0.0, 1.0)),
        "",
        "Share of that segment's length; not before the place above.",
    ),
    Key::optional(
        "hole_radius_m",
        POSITIVE_LENGTH,
        "m",
        "as its neighbours",
        "Radius of the circle of holes; a converging cable has another one at the next place.",
    ),
    Key::optional(
        "turn_deg",
        Kind::Float(Range::closed(-36000.0, 36000.0)),
        "deg",
        "as its neighbours",
        "Turn of all holes about the backbone, added to their angles; a helical cable has another one at the next place.",
    ),
];

/// A number of a segment and how it changes along it: its own key, or its stations.
pub(super) fn along(
    section: &Section<'_>,
    stations: &[(f64, Section<'_>)],
    name: &'static str,
    number_of: impl Fn(&Profile) -> f64,
) -> (f64, Profile) {
    let points: Vec<[f64; 2]> =
        stations.iter().filter_map(|(at, station)| station.float_opt(name).map(|value| [*at, value])).collect();
    // A segment's own choice between the two ways overrides the other way in the defaults.
    let own = section.has_own(name);
    if points.is_empty() || (own && !section.has_own("stations")) {
        return (section.float(name), Profile::default());
    }
    section.ignore_behind(name);
    if own {
        section.refuse(name, "the segment's stations give it as well", "give it in one of the two places");
    }
    let profile = Profile(points);
    let number = number_of(&profile);
    (number, profile.times(1.0 / number))
}

/// The tables of `name`, each with its place; places that go back are refused.
fn places<'d>(
    section: &Section<'d>,
    name: &'static str,
    place_of: impl Fn(&Section<'d>, f64) -> f64,
) -> Vec<(f64, Section<'d>)> {
    let mut listed: Vec<(f64, Section<'d>)> = Vec::new();
    for table in section.tables(name, None) {
        let at = place_of(&table, table.float("at"));
        if let Some((before, _)) = listed.last()
            && at < *before
        {
            table.refuse("at", "lies before the place above", "permitted: places in ascending order, base to tip");
        }
        if listed.len() > 1 && listed[listed.len() - 2].0 == at {
            table.refuse("at", "is the third at this place", "permitted: one, or two that make a step");
        }
        listed.push((at, table));
    }
    listed
}

/// The stations of a segment.
pub(super) fn stations<'d>(section: &Section<'d>) -> Vec<(f64, Section<'d>)> {
    places(section, "stations", |_, at| at)
}

/// Radius of the segment's circle of holes (m), and where its cables run; `index` and what the segment's routing permits are
/// those of the segment (0-based).
pub(super) fn route(section: &Section<'_>, index: usize, from: usize) -> (f64, Route) {
    let listed = places(section, "route", |place, at| {
        let segment = place.count_opt("segment").map_or(index, |segment| segment - 1);
        if segment > index || segment < from {
            let help = format!("permitted: {} to {}, where these cables run", from + 1, index + 1);
            place.refuse("segment", "the segment's cables do not run there", &help);
        }
        segment as f64 + at
    });
    let own = index as f64;
    let radii = listed.iter().filter_map(|(x, place)| place.float_opt("hole_radius_m").map(|r| [*x, r]));
    let radius = Profile(radii.collect());
    let turns = listed.iter().filter_map(|(x, place)| place.float_opt("turn_deg").map(|turn| [*x, turn.to_radians()]));
    let turn = Profile(turns.collect());
    let given = section.has_own("hole_radius_m");
    if radius.is_empty() || (given && !section.has_own("route")) {
        return (section.float("hole_radius_m"), Route { radius: Profile::default(), turn });
    }
    section.ignore_behind("hole_radius_m");
    if given {
        section.refuse("hole_radius_m", "the segment's route gives it as well", "give it in one of the two places");
    }
    let number = radius.mean(own, own + 1.0);
    (number, Route { radius: radius.times(1.0 / number), turn })
}

/// Numbers of a segment that stations may give.
pub(super) struct Numbers {
    pub(super) bending: f64,
    pub(super) torsion: f64,
    pub(super) backbone_mass: f64,
    pub(super) backbone_radius: f64,
    pub(super) disk_mass: f64,
    pub(super) disk_radius: f64,
}

/// The numbers, and how they change along the segment.
pub(super) fn numbers(section: &Section<'_>) -> (Numbers, Taper) {
    let stations = stations(section);
    let mean = |p: &Profile| p.mean(0.0, 1.0);
    let in_series = |p: &Profile| 1.0 / p.mean_inverse(0.0, 1.0);
    let read = |name, of: &dyn Fn(&Profile) -> f64| along(section, &stations, name, of);
    let (bending, of_bending) = read("bending_stiffness_nm2", &in_series);
    let (torsion, of_torsion) = read("torsional_stiffness_nm2", &in_series);
    let (disk_mass, of_disk_mass) = read("disk_mass_kg", &mean);
    let (disk_radius, of_disk_radius) = read("disk_radius_m", &mean);
    let (backbone_mass, of_backbone_mass) = read("backbone_mass_kgpm", &mean);
    let (backbone_radius, of_backbone_radius) = read("backbone_radius_m", &mean);
    let taper = Taper {
        bending: of_bending,
        torsion: of_torsion,
        backbone_mass: of_backbone_mass,
        backbone_radius: of_backbone_radius,
        disk_mass: of_disk_mass,
        disk_radius: of_disk_radius,
    };
    (Numbers { bending, torsion, backbone_mass, backbone_radius, disk_mass, disk_radius }, taper)
}
