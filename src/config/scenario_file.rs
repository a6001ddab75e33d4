//! Scenario files: reading and checking an arm's task, weights, start, obstacles and published figures.

use super::arm::ArmConfig;
use super::builtin;
use super::error::ConfigError;
use super::planner_file::{SCENARIO_PLANNER, WARNINGS, warning};
use super::reader::{self, Document, Section};
use super::scale::Scale;
use super::scenario::{
    HULL_POINTS_MAX, Motion, ObstacleConfig, PublishedFigure, ScenarioConfig, ShapeConfig, Start, SweepRun, Task,
    TipPath, Waypoint,
};
use super::schema::{Key, Kind, Length, Range, TableSpec};
use super::weights::{POSITIVE_WEIGHT, SEGMENT_WEIGHTS, WEIGHT, refuse_other_length};
use super::{arm_file, planner_file};
use std::path::Path;

const COORDINATES: Kind = Kind::Floats(Length::Exactly(3), Range::closed(-1000.0, 1000.0));
const SIZE: Kind = Kind::Float(Range::above(0.0, 1000.0));
const SECONDS: Kind = Kind::Float(Range::above(0.0, 1e5));
const TIME: Kind = Kind::Float(Range::closed(0.0, 1e5));
const CURVATURES: Kind = Kind::Floats(Length::Between(2, 32), Range::closed(-1e4, 1e4));
const NO_TURN: &str = "[1.0, 0.0, 0.0, 0.0]";

/// The root of a scenario file.
pub static SCENARIO: TableSpec = TableSpec {
    header: "(top level)",
    name: "",
    about: "What an open-loop run is about. Time starts at 0 s.",
    keys: &[
        Key::required("name", Kind::Text(64), "", "Name in reports."),
        Key::optional(
            "arm",
            Kind::Text(256),
            "",
            "the built-in `arm.toml`",
            "File with the table `[arm]`; a relative path starts at the scenario's directory.",
        ),
        Key::required("duration_s", SECONDS, "s", "Length of the run."),
        Key::default("seed", Kind::Integer(0, i64::MAX), "", "1", "Seed of every random choice."),
        Key::optional(
            "weight_tension",
            POSITIVE_WEIGHT,
            "1/N^2",
            "1.0; without `weight_tension_change` 1e-4 of the least of W",
            "R = r I.",
        ),
        Key::optional(
            "weight_tension_change",
            SEGMENT_WEIGHTS,
            "1/N^2",
            "3e-4 of the diagonal of S^T Q S at the start of the straight arm",
            "Diagonal of W, one number per segment; S is what the outputs answer a tension with over the lookahead.",
        ),
        Key::required("task", Kind::Table(&TASK), "", "What the arm is asked to do."),
        Key::required("start", Kind::Table(&START), "", "How it stands at t = 0."),
        Key::optional("obstacles", Kind::Tables(Length::Between(0, 64), &OBSTACLE), "", "none", "Obstacles."),
        Key::optional("planner", Kind::Table(&SCENARIO_PLANNER), "", "its defaults", "The planner."),
        Key::optional(
            "figures",
            Kind::Tables(Length::Between(0, 64), &FIGURE),
            "",
            "none",
            "Published figures to show beside the run's own.",
        ),
        Key::optional(
            "sweep",
            Kind::Tables(Length::Between(0, 64), &SWEEP),
            "",
            "one run",
            "Runs of a sweep: each overrides some settings.",
        ),
    ],
};

static TASK: TableSpec = TableSpec {
    header: "[task]",
    name: "task",
    about: "What the arm is asked to do, with its output weights Q.",
    keys: &[
        Key::required(
            "mode",
            Kind::Choice(&["tip", "shape"]),
            "",
            "`tip`: follow poses with the tip, (41); `shape`: reach mean curvatures, (45).",
        ),
        Key::optional("path", Kind::Table(&PATH), "", "only with `shape`", "Desired pose over time (tip)."),
        Key::default(
            "weight_pose",
            POSITIVE_WEIGHT,
            "1/m^2, 1",
            "5e12",
            "Weight on the tip's position and quaternion (tip).",
        ),
        Key::default("weight_rate", WEIGHT, "s^2/m^2, s^2", "5e10", "Weight on their rates (tip)."),
        Key::default("weight_damping", WEIGHT, "s^2/m^2, s^2", "1e8", "Weight on the rates of all other nodes (tip)."),
        Key::required(
            "curvatures_1pm",
            CURVATURES,
            "1/m",
            "Desired mean curvatures about local y and z, segment by segment: two per segment (shape).",
        ),
        Key::default(
            "weight_end",
            POSITIVE_WEIGHT,
            "m^2",
            "1e10",
            "Weight on curvatures and rates from `end_s` on (shape).",
        ),
        Key::default(
            "weight_slope",
            WEIGHT,
            "m^2/s^2",
            "9.99e5",
            "Weight = `weight_end - weight_slope (t - end_s)^2` until `end_s`; never below 0 (shape).",
        ),
        Key::optional("end_s", SECONDS, "s", "the duration", "Time at which the weight is at its end value (shape)."),
    ],
};

static PATH: TableSpec = TableSpec {
    header: "[task.path]",
    name: "path",
    about: "Desired pose of the tip over time.",
    keys: &[
        Key::required(
            "kind",
            Kind::Choice(&["lemniscate", "waypoints"]),
            "",
            "`lemniscate`: the paper's curve (38)-(39); `waypoints`: poses at given times, joined by straight lines and slerp, the last one held.",
        ),
        Key::default("scale_m", SIZE, "m", "0.6", "Size of the curve (lemniscate)."),
        Key::default(
            "height_m",
            Kind::Float(Range::closed(-1000.0, 1000.0)),
            "m",
            "-2.4",
            "z throughout (lemniscate).",
        ),
        Key::optional("duration_s", SECONDS, "s", "the scenario's", "Time for the whole curve (lemniscate)."),
        Key::default(
            "quaternion",
            Kind::Quaternion,
            "",
            "[0.7071067811865476, 0.0, 0.7071067811865476, 0.0]",
            "Tip's attitude throughout, body to base, (40) (lemniscate).",
        ),
        Key::required("waypoints", Kind::Tables(Length::Between(1, 10_000), &WAYPOINT), "", "Poses (waypoints)."),
    ],
};

static WAYPOINT: TableSpec = TableSpec {
    header: "[[task.path.waypoints]]",
    name: "waypoints",
    about: "One pose of a path; times rise.",
    keys: &[
        Key::required("time_s", TIME, "s", "Time."),
        Key::required("position_m", COORDINATES, "m", "Position, base frame."),
        Key::required("quaternion", Kind::Quaternion, "", "Attitude, body to base."),
    ],
};

static START: TableSpec = TableSpec {
    header: "[start]",
    name: "start",
    about: "How the arm stands at t = 0.",
    keys: &[
        Key::required(
            "kind",
            Kind::Choice(&["straight", "tensions", "tip_pose"]),
            "",
            "`straight`: straight and without tension; `tensions`: equilibrium under given tensions; `tip_pose`: equilibrium with the tip at the task's first pose and the least sum of squared tensions.",
        ),
        Key::required(
            "tensions_n",
            Kind::Floats(Length::Between(1, 96), Range::closed(0.0, 1e5)),
            "N",
            "One per cable, inside the arm's tension box (tensions).",
        ),
        Key::required(
            "guess_curvatures_1pm",
            CURVATURES,
            "1/m",
            "Shape from which the equilibrium is sought, two per segment; it chooses the branch (tip_pose).",
        ),
    ],
};

static OBSTACLE: TableSpec = TableSpec {
    header: "[[obstacles]]",
    name: "obstacles",
    about: "One obstacle: a shape whose origin moves and whose attitude is constant.",
    keys: &[
        Key::required("id", Kind::Text(32), "", "Name in reports; different for every obstacle."),
        Key::required(
            "shape",
            Kind::Choice(&["ball", "capsule", "box", "half_space", "hull"]),
            "",
            "Shape; `half_space` is everything below the plane through the origin whose outward normal is local z.",
        ),
        Key::required("radius_m", SIZE, "m", "Radius (ball, capsule)."),
        Key::required(
            "half_length_m",
            SIZE,
            "m",
            "Half of the distance between the two centres along local z (capsule).",
        ),
        Key::required(
            "half_extents_m",
            Kind::Floats(Length::Exactly(3), Range::above(0.0, 1000.0)),
            "m",
            "Half extents along the local axes (box).",
        ),
        Key::required(
            "points_m",
            Kind::Points(Length::Between(4, HULL_POINTS_MAX)),
            "m",
            "Points whose hull it is, not all in one plane (hull).",
        ),
        Key::default("quaternion", Kind::Quaternion, "", NO_TURN, "Attitude, obstacle to base."),
        Key::default(
            "motion",
            Kind::Choice(&["linear", "circle", "waypoints"]),
            "",
            "\"linear\"",
            "Motion of the origin.",
        ),
        Key::required("position_m", COORDINATES, "m", "Position at t = 0 (linear)."),
        Key::default(
            "velocity_mps",
            Kind::Floats(Length::Exactly(3), Range::closed(-100.0, 100.0)),
            "m/s",
            "[0.0, 0.0, 0.0]",
            "Velocity (linear).",
        ),
        Key::required("centre_m", COORDINATES, "m", "Centre; the circle lies in the base frame's x-y plane (circle)."),
        Key::required("circle_radius_m", SIZE, "m", "Radius of the circle (circle)."),
        Key::default(
            "phase_rad",
            Kind::Float(Range::closed(-10.0, 10.0)),
            "rad",
            "0.0",
            "Angle at t = 0 from x towards y (circle).",
        ),
        Key::required(
            "rate_radps",
            Kind::Float(Range::closed(-100.0, 100.0)),
            "rad/s",
            "Its rate: angle = phase + rate t + acceleration t^2 (circle).",
        ),
        Key::default(
            "acceleration_radps2",
            Kind::Float(Range::closed(-100.0, 100.0)),
            "rad/s^2",
            "0.0",
            "Coefficient of t^2 (circle).",
        ),
        Key::required(
            "waypoints",
            Kind::Tables(Length::Between(1, 10_000), &STATION),
            "",
            "Positions at given times (waypoints).",
        ),
    ],
};

static STATION: TableSpec = TableSpec {
    header: "[[obstacles.waypoints]]",
    name: "waypoints",
    about: "Where an obstacle is at a time; times rise, straight lines between, the last position is held.",
    keys: &[Key::required("time_s", TIME, "s", "Time."), Key::required("position_m", COORDINATES, "m", "Position.")],
};

static FIGURE: TableSpec = TableSpec {
    header: "[[figures]]",
    name: "figures",
    about: "A published figure, shown beside the run's own at the end.",
    keys: &[
        Key::required("quantity", Kind::Text(128), "", "What it is."),
        Key::required("paper", Kind::Text(128), "", "The paper's value, or `-`."),
        Key::required("reference", Kind::Text(256), "", "The reference implementation's value, or `-`."),
        Key::required(
            "field",
            Kind::Text(128),
            "",
            "Path of the run's value in its JSON summary, e.g. `obstacles.0.points.surface_distance_min_m`.",
        ),
    ],
};

static SWEEP: TableSpec = TableSpec {
    header: "[[sweep]]",
    name: "sweep",
    about: "One run of a sweep; what is absent stays as the scenario has it.",
    keys: &[
        Key::required("label", Kind::Text(64), "", "Label in the table."),
        Key::optional("penalty", Kind::Float(Range::above(0.0, 1e20)), "", "unchanged", "Penalty factor nu."),
        Key::optional(
            "particles",
            Kind::Integer(1, 20_000),
            "",
            "unchanged",
            "Particles, normal plus uniform in the scenario's proportion.",
        ),
        Key::optional("warning", Kind::Choice(WARNINGS), "", "unchanged", "Branch."),
        Key::optional(
            "window_s",
            Kind::Floats(Length::Exactly(2), Range::closed(0.0, 1e5)),
            "s",
            "the whole run",
            "Window in which these settings hold; outside it the scenario's own.",
        ),
    ],
};

impl ScenarioConfig {
    /// Reads a scenario file, and the arm's file if it names one.
    ///
    /// # Errors
    /// Everything wrong in either, as [`ConfigError`].
    pub fn load(path: &Path) -> Result<Self, ConfigError> {
        reader::read_files(&[path.to_path_buf()], &[&SCENARIO], build)
    }

    /// Reads a scenario from a text; `name` stands for the file in messages, its directory for relative paths.
    ///
    /// # Errors
    /// As [`ScenarioConfig::load`].
    pub fn parse(name: &str, text: &str) -> Result<Self, ConfigError> {
        reader::read(vec![(name.to_owned(), text.to_owned())], &[&SCENARIO], build)
    }

    /// Reads the scenario that a user names: a file if there is one of this path, else a built-in scenario.
    ///
    /// # Errors
    /// Neither exists, or as [`ScenarioConfig::load`].
    pub fn find(name: &str) -> Result<Self, ConfigError> {
        let path = Path::new(name);
        if path.is_file() {
            return Self::load(path);
        }
        match builtin::scenario(name) {
            Some((path, text)) => Self::parse(&path, text),
            None => Err(builtin::no_such_scenario(name)),
        }
    }
}

fn build(document: &Document<'_>) -> ScenarioConfig {
    let root = document.root(&SCENARIO);
    let arm = arm(document, &root);
    let segments = arm.segments.len();
    let duration_s = root.float("duration_s");
    let weight_tension_change = root.floats_opt("weight_tension_change");
    if let Some(change) = &weight_tension_change {
        refuse_other_length(&root, "weight_tension_change", change.len(), segments, "one per segment");
    }
    let weight_tension = root.float_opt("weight_tension").or(weight_tension_change.as_ref().map(|_| 1.0));
    let disk_radius_m = arm.disk_radius_m();
    let planner_table = root.table("planner");
    let planner = planner_file::read(
        &planner_table,
        planner_table.float_opt("lookahead_s"),
        None,
        &Scale::of(&arm),
        disk_radius_m,
    );
    let mut obstacles: Vec<ObstacleConfig> = Vec::new();
    for section in root.tables("obstacles", None) {
        let next = obstacle(&section);
        if obstacles.iter().any(|other| other.id == next.id) {
            section.refuse("id", "another obstacle has it already", "permitted: different for every obstacle");
        }
        obstacles.push(next);
    }
    let task = task(&root.table("task"), &arm, duration_s);
    let start_table = root.table("start");
    let start = start(&start_table, &arm);
    if matches!((&task, &start), (Task::Shape { .. }, Start::TipPose { .. })) {
        start_table.refuse(
            "kind",
            "a shape task has no tip pose to start from",
            "permitted with `shape`: \"straight\", \"tensions\"",
        );
    }
    ScenarioConfig {
        name: root.text("name"),
        duration_s,
        seed: root.integer("seed").unsigned_abs(),
        weight_tension,
        weight_tension_change,
        task,
        start,
        obstacles,
        planner,
        figures: root.tables("figures", None).iter().map(figure).collect(),
        sweep: root.tables("sweep", None).iter().map(|section| sweep(section, duration_s)).collect(),
        arm,
    }
}

fn arm(document: &Document<'_>, root: &Section<'_>) -> ArmConfig {
    let Some(file) = root.text_opt("arm") else { return ArmConfig::paper() };
    let path = root.directory().join(file);
    let read = match builtin::arm_text(&path) {
        Some(text) if !path.is_file() => ArmConfig::parse(&format!("{} (built in)", path.display()), text),
        _ => ArmConfig::load(&path),
    };
    match read {
        Ok(arm) => arm,
        Err(error) => {
            document.note_all(error);
            ArmConfig::paper()
        }
    }
}

fn task(table: &Section<'_>, arm: &ArmConfig, duration_s: f64) -> Task {
    if table.choice("mode") == "shape" {
        let curvatures_1pm = table.floats("curvatures_1pm");
        let wanted = 2 * arm.segments.len();
        refuse_other_length(table, "curvatures_1pm", curvatures_1pm.len(), wanted, "two per segment");
        if table.is_clean()
            && let Some((segment, why)) = beyond_cables(arm, &curvatures_1pm)
        {
            let help = "permitted: curvatures to sides that the segment's cables can bend it to, others 0";
            table.refuse("curvatures_1pm", format!("segment {}: {why}", segment + 1), help);
        }
        let weight_end = table.float("weight_end");
        let weight_slope = table.float("weight_slope");
        let end_s = table.float_opt("end_s").unwrap_or(duration_s);
        if weight_end - weight_slope * end_s * end_s < 0.0 {
            let help = format!("permitted: 0 to {:e} (`weight_end` / `end_s`^2)", weight_end / (end_s * end_s));
            table.refuse("weight_slope", "the weight is negative at t = 0", &help);
        }
        return Task::Shape { curvatures_1pm, weight_end, weight_slope, end_s };
    }
    if !table.has("path") && table.is_clean() {
        table.refuse("path", "a tip task needs a path", "permitted: [task.path] with `kind`");
    }
    Task::Tip {
        path: path(&table.table("path"), duration_s),
        weight_pose: table.float("weight_pose"),
        weight_rate: table.float("weight_rate"),
        weight_damping: table.float("weight_damping"),
    }
}

/// The first segment whose own cables cannot hold its curvature (1/m) at all, and why not.
fn beyond_cables(arm: &ArmConfig, curvatures: &[f64]) -> Option<(usize, String)> {
    arm.segments.iter().zip(curvatures.chunks_exact(2)).enumerate().find_map(|(index, (segment, k))| {
        let size = k[0].hypot(k[1]);
        // A tension at hole (y, z) gives the moment (-z, y).
        let moments: Vec<[f64; 2]> = segment.hole_angles_rad.iter().map(|a| [-a.sin(), a.cos()]).collect();
        let wanted = [k[0] / size, k[1] / size];
        let cross = |a: &[f64; 2], b: &[f64; 2]| a[0] * b[1] - a[1] * b[0];
        let in_line = |m: &[f64; 2]| cross(m, &wanted).abs() < IN_LINE && m[0] * wanted[0] + m[1] * wanted[1] > 0.0;
        // Between two of them: a sum of both with shares of at least 0.
        let between = |a: &[f64; 2], b: &[f64; 2]| {
            let d = cross(a, b);
            d > IN_LINE && cross(&wanted, b) >= -IN_LINE * d && cross(a, &wanted) >= -IN_LINE * d
        };
        let held =
            size == 0.0 || moments.iter().any(in_line) || moments.iter().any(|a| moments.iter().any(|b| between(a, b)));
        let count = moments.len();
        (!held).then(|| {
            let cables = if count == 1 { "its one cable does".to_owned() } else { format!("its {count} cables do") };
            (index, format!("{cables} not bend it that way"))
        })
    })
}

/// Sine of an angle below which two directions count as one.
const IN_LINE: f64 = 1e-3;

fn path(table: &Section<'_>, duration_s: f64) -> TipPath {
    if table.choice("kind") == "waypoints" {
        let sections = table.tables("waypoints", None);
        let points = sections.iter().map(|section| Waypoint {
            time_s: section.float("time_s"),
            position_m: section.vector("position_m"),
            quaternion: section.quaternion("quaternion"),
        });
        let points: Vec<_> = points.collect();
        refuse_falling_times(&sections, points.iter().map(|point| point.time_s));
        return TipPath::Waypoints(points);
    }
    TipPath::Lemniscate {
        scale_m: table.float("scale_m"),
        height_m: table.float("height_m"),
        duration_s: table.float_opt("duration_s").unwrap_or(duration_s),
        quaternion: table.quaternion("quaternion"),
    }
}

fn refuse_falling_times(sections: &[Section<'_>], times: impl Iterator<Item = f64>) {
    let mut last = f64::NEG_INFINITY;
    for (section, time) in sections.iter().zip(times) {
        if time <= last {
            section.refuse("time_s", "not after the one before", &format!("permitted: > {last} s"));
        }
        last = time;
    }
}

fn start(table: &Section<'_>, arm: &ArmConfig) -> Start {
    match table.choice("kind") {
        "tensions" => {
            let tensions = table.floats("tensions_n");
            refuse_other_length(table, "tensions_n", tensions.len(), arm.cable_count(), "one per cable");
            let maxima = arm.tension_maxima_n();
            if tensions.iter().zip(&maxima).any(|(tension, most)| !(arm.tension_n_min..=*most).contains(tension)) {
                let help = format!("permitted: {} to {} N each", arm.tension_n_min, arm.tension_n_max);
                table.refuse("tensions_n", "outside the arm's tension box", &help);
            }
            Start::Tensions(tensions)
        }
        "tip_pose" => {
            let guess_curvatures_1pm = table.floats("guess_curvatures_1pm");
            let wanted = 2 * arm.segments.len();
            refuse_other_length(table, "guess_curvatures_1pm", guess_curvatures_1pm.len(), wanted, "two per segment");
            Start::TipPose { guess_curvatures_1pm }
        }
        _ => Start::Straight,
    }
}

fn obstacle(section: &Section<'_>) -> ObstacleConfig {
    let shape = match section.choice("shape") {
        "capsule" => {
            ShapeConfig::Capsule { half_length_m: section.float("half_length_m"), radius_m: section.float("radius_m") }
        }
        "box" => ShapeConfig::Box { half_extents_m: section.vector("half_extents_m") },
        "half_space" => ShapeConfig::HalfSpace,
        "hull" => {
            let points_m = section.points("points_m");
            if section.is_clean() && !spans_space(&points_m) {
                let help = format!("permitted: 4 to {HULL_POINTS_MAX} points, not all in one plane");
                section.refuse("points_m", "all points lie in one plane", &help);
            }
            ShapeConfig::Hull { points_m }
        }
        _ => ShapeConfig::Ball { radius_m: section.float("radius_m") },
    };
    let motion = match section.choice("motion") {
        "circle" => Motion::Circle {
            centre_m: section.vector("centre_m"),
            radius_m: section.float("circle_radius_m"),
            phase_rad: section.float("phase_rad"),
            rate_radps: section.float("rate_radps"),
            acceleration_radps2: section.float("acceleration_radps2"),
        },
        "waypoints" => {
            let stations = section.tables("waypoints", None);
            let points: Vec<_> = stations.iter().map(|s| (s.float("time_s"), s.vector("position_m"))).collect();
            refuse_falling_times(&stations, points.iter().map(|point| point.0));
            Motion::Waypoints(points)
        }
        _ => Motion::Linear { position_m: section.vector("position_m"), velocity_mps: section.vector("velocity_mps") },
    };
    ObstacleConfig { id: section.text("id"), shape, motion, quaternion: section.quaternion("quaternion") }
}

/// True if some four of the points span a volume of more than a millionth of the cube of their extent.
fn spans_space(points: &[[f64; 3]]) -> bool {
    let from = |p: &[f64; 3]| nalgebra::Vector3::new(p[0] - points[0][0], p[1] - points[0][1], p[2] - points[0][2]);
    let offsets: Vec<_> = points.iter().skip(1).map(from).collect();
    // The farthest point, the point farthest from that line, the point farthest from that plane.
    let Some(along) = offsets.iter().copied().max_by(|a, b| a.norm().total_cmp(&b.norm())) else { return false };
    let normals = offsets.iter().map(|offset| along.cross(offset));
    let Some(normal) = normals.max_by(|a, b| a.norm().total_cmp(&b.norm())) else { return false };
    let volume = offsets.iter().map(|offset| normal.dot(offset).abs()).fold(0.0, f64::max);
    volume > 1e-6 * along.norm().powi(3)
}

fn figure(section: &Section<'_>) -> PublishedFigure {
    PublishedFigure {
        quantity: section.text("quantity"),
        paper: section.text("paper"),
        reference: section.text("reference"),
        field: section.text("field"),
    }
}

fn sweep(section: &Section<'_>, duration_s: f64) -> SweepRun {
    let window_s: Option<[f64; 2]> = section.vector_opt("window_s");
    if let Some([from, to]) = window_s
        && !(from < to && to <= duration_s)
        && section.is_clean()
    {
        section.refuse(
            "window_s",
            "not a window of the run",
            &format!("permitted: [from, to], 0 <= from < to <= {duration_s} s"),
        );
    }
    SweepRun {
        label: section.text("label"),
        penalty: section.float_opt("penalty"),
        particles: section.count_opt("particles"),
        warning: section.choice_opt("warning").map(warning),
        window_s,
    }
}

/// Text of the arm's file that a scenario names, as [`ScenarioConfig::find`] finds the scenario; `None` where it names none and
/// the built-in arm is meant, or cannot be read.
pub fn arm_text_of(scenario: &str) -> Option<String> {
    let path = Path::new(scenario);
    let (place, text) = if path.is_file() {
        (scenario.to_owned(), std::fs::read_to_string(path).ok()?)
    } else {
        builtin::scenario(scenario).map(|(place, text)| (place, text.to_owned()))?
    };
    let tables: toml::Table = text.parse().ok()?;
    let file = Path::new(&place).parent()?.join(tables.get("arm")?.as_str()?);
    std::fs::read_to_string(&file).ok().or_else(|| builtin::arm_text(&file).map(str::to_owned))
}

/// The arm that `[arm]` of an opened document describes, for programs whose files hold further tables.
pub fn arm_of(document: &Document<'_>) -> ArmConfig {
    arm_file::arm(document)
}
