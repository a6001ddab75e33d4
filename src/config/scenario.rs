//! A scenario: an arm's task, its weights and its obstacles over time.

use super::arm::ArmConfig;
use super::planner::PlannerConfig;
use serde::Serialize;

/// Desired pose of the tip over time.
#[derive(Debug, Clone, PartialEq, Serialize)]
#[serde(tag = "kind", content = "value", rename_all = "snake_case")]
pub enum TipPath {
    /// The paper's curve (38)-(39): `x = rho cos th, y = rho sin th, z`, `rho = scale cos 2 th`, with th(t) of (39)
    /// stretched from 100 s to `duration_s`.
    Lemniscate {
        /// 0.6 m in the paper.
        scale_m: f64,
        /// -2.4 m in the paper.
        height_m: f64,
        /// 100 s in the paper.
        duration_s: f64,
        /// Tip quaternion `[w x y z]` throughout, (40).
        quaternion: [f64; 4],
    },
    /// Poses at given times; straight lines between positions, slerp between quaternions; the last one is held.
    Waypoints(Vec<Waypoint>),
}

/// One pose of a path.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct Waypoint {
    /// Time (s).
    pub time_s: f64,
    /// Position (m), base frame.
    pub position_m: [f64; 3],
    /// Unit quaternion `[w x y z]`, body to base.
    pub quaternion: [f64; 4],
}

/// What the arm is asked to do, with its output weights Q.
#[derive(Debug, Clone, PartialEq, Serialize)]
#[serde(tag = "mode", rename_all = "snake_case")]
pub enum Task {
    /// (41)-(42): tip pose; weights of the tip's coordinates (7), their rates (7) and all other nodes' rates.
    Tip {
        /// Desired pose over time.
        path: TipPath,
        /// Weight on the tip's position and quaternion (5e12 in the paper).
        weight_pose: f64,
        /// Weight on their rates (5e10).
        weight_rate: f64,
        /// Weight on the other nodes' rates (1e8).
        weight_damping: f64,
    },
    /// (44)-(46): average curvatures of the segments about local y and z.
    Shape {
        /// Desired curvatures (1/m), (y, z) segment by segment.
        curvatures_1pm: Vec<f64>,
        /// Weight on curvatures and rates at the end of the scenario (1e10).
        weight_end: f64,
        /// Weight = `weight_end - weight_slope (t - end_s)^2` until `end_s`, then `weight_end` (9.99e5).
        weight_slope: f64,
        /// Time at which the weight is at its end value (s).
        end_s: f64,
    },
}

/// Shape of an obstacle in its own frame.
#[derive(Debug, Clone, PartialEq, Serialize)]
#[serde(tag = "shape", rename_all = "snake_case")]
pub enum ShapeConfig {
    /// Ball.
    Ball {
        /// Radius (m).
        radius_m: f64,
    },
    /// Capsule along the local z axis.
    Capsule {
        /// Half of the length between the two centres (m).
        half_length_m: f64,
        /// Radius (m).
        radius_m: f64,
    },
    /// Box.
    Box {
        /// Half extents along the local axes (m).
        half_extents_m: [f64; 3],
    },
    /// Half-space below the plane through the local origin whose outward normal is the local z axis.
    HalfSpace,
    /// Convex hull of points in the local frame (m).
    Hull {
        /// At least four points, not all in one plane.
        points_m: Vec<[f64; 3]>,
    },
}

/// Motion of an obstacle's frame.
#[derive(Debug, Clone, PartialEq, Serialize)]
#[serde(tag = "motion", content = "value", rename_all = "snake_case")]
pub enum Motion {
    /// `position + velocity t`.
    Linear {
        /// Position at t = 0 (m).
        position_m: [f64; 3],
        /// Velocity (m/s).
        velocity_mps: [f64; 3],
    },
    /// Circle in the base frame's x-y plane: `centre + radius [cos a, sin a, 0]`,
    /// `a = phase + rate t + acceleration t^2`.
    ///
    /// The paper's second obstacle (43) has `a = w t` with `w = pi t / 6000 + 7 pi / 600`:
    /// rate 7 pi / 600, acceleration pi / 6000.
    Circle {
        /// Centre (m).
        centre_m: [f64; 3],
        /// Radius (m).
        radius_m: f64,
        /// Angle at t = 0 (rad).
        phase_rad: f64,
        /// Rate (rad/s).
        rate_radps: f64,
        /// Coefficient of t^2 (rad/s^2).
        acceleration_radps2: f64,
    },
    /// Positions at given times, straight lines between; the last one is held.
    Waypoints(Vec<(f64, [f64; 3])>),
}

/// One obstacle of a scenario.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct ObstacleConfig {
    /// Name in reports.
    pub id: String,
    /// Shape.
    pub shape: ShapeConfig,
    /// Motion of its origin.
    pub motion: Motion,
    /// Constant orientation `[w x y z]`, obstacle to base.
    pub quaternion: [f64; 4],
}

/// How the arm stands at t = 0.
#[derive(Debug, Clone, PartialEq, Serialize)]
#[serde(tag = "kind", content = "value", rename_all = "snake_case")]
pub enum Start {
    /// Straight and without tension.
    Straight,
    /// Static equilibrium under given tensions (N).
    Tensions(Vec<f64>),
    /// Static equilibrium with the tip at the task's first pose and the least sum of squared tensions,
    /// reached from the arm bent with these curvatures (1/m; (y, z) segment by segment), which choose the branch.
    TipPose {
        /// Curvatures of the guess (1/m).
        guess_curvatures_1pm: Vec<f64>,
    },
}

/// A scenario file.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct ScenarioConfig {
    /// Name.
    pub name: String,
    /// The arm: the file's that the scenario names, or the built-in one.
    pub arm: ArmConfig,
    /// Length (s).
    pub duration_s: f64,
    /// Seed of every random choice.
    pub seed: u64,
    /// Weight R on the tensions (one number: R = r I); `None` for a ten-thousandth of the least of W.
    pub weight_tension: Option<f64>,
    /// Diagonal of W per segment, for all its cables; `None` for a share of what the arm answers with.
    pub weight_tension_change: Option<Vec<f64>>,
    /// Task.
    pub task: Task,
    /// Start.
    pub start: Start,
    /// Obstacles.
    pub obstacles: Vec<ObstacleConfig>,
    /// Planner settings of the open-loop run.
    pub planner: PlannerConfig,
    /// Values compared at the end of a run, as reported by the paper and by the reference implementation.
    pub figures: Vec<PublishedFigure>,
    /// Runs of a sweep: each overrides some settings (figure 4: penalty factors; figure 16: swarm sizes).
    pub sweep: Vec<SweepRun>,
}

/// One published figure beside which a run's own is shown.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct PublishedFigure {
    /// What it is, in words.
    pub quantity: String,
    /// The paper's.
    pub paper: String,
    /// The reference implementation's.
    pub reference: String,
    /// Path of our value in the JSON summary, e.g. `obstacles.0.points.surface_distance_min_m`.
    pub field: String,
}

/// Most points of a hull, in files and from clients: at most 508 triangles in a query.
pub const HULL_POINTS_MAX: usize = 256;

/// One run of a sweep.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct SweepRun {
    /// Label in the table.
    pub label: String,
    /// Penalty factor nu.
    pub penalty: Option<f64>,
    /// Particles (normal plus uniform).
    pub particles: Option<usize>,
    /// Branch.
    pub warning: Option<WarningBranchChoice>,
    /// Window of the scenario that is swept (s); outside it the seeded branch plans.
    pub window_s: Option<[f64; 2]>,
}

pub use super::planner::WarningBranch as WarningBranchChoice;
