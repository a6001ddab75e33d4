//! What a scenario asks for at a time: the goal, and where its obstacles are.

use crate::collision::{Obstacle, ObstacleError, ObstacleSet, SetFull, Shape, ShapeError, pose};
use crate::config::{ArmConfig, ScenarioConfig, Start, Task};
use crate::integrator::{StaticsError, Stepper, consistent_start, equilibrium};
use crate::model::{Arm, State};
use crate::planner::{Goal, StartError, sensitivity, tip_start};
use nalgebra::{Vector3, Vector4};

/// Why a scenario cannot be set up.
#[derive(Debug, thiserror::Error)]
pub enum CourseError {
    /// An obstacle's shape.
    #[error("obstacle {id}: {source}")]
    Shape {
        /// Its name.
        id: String,
        /// What is wrong.
        source: ShapeError,
    },
    /// An obstacle's pose.
    #[error("obstacle {id}: {source}")]
    Pose {
        /// Its name.
        id: String,
        /// What is wrong.
        source: ObstacleError,
    },
    /// Too many obstacles.
    #[error("more obstacles than the planner has room for ({0})")]
    TooMany(usize),
    /// No start.
    #[error("start: {0}")]
    Start(#[from] StartError),
    /// No equilibrium at the start.
    #[error("start: {0}")]
    Statics(#[from] StaticsError),
    /// The start's accelerations could not be computed.
    #[error("start: {0}")]
    Step(#[from] crate::integrator::StepError),
    /// The arm's equations are singular.
    #[error("a node of the arm has no mass")]
    Massless,
}

/// Where a scenario gives no weights on tensions: W over the diagonal of `S^T Q S` in open loop, and R over the least of W.
const CHANGE_SHARE: f64 = 3e-4;
const TENSION_SHARE: f64 = 1e-4;

/// Goals and obstacles of a scenario over time.
#[derive(Debug)]
pub struct Course {
    scenario: ScenarioConfig,
}

impl Course {
    /// Of a checked scenario.
    pub fn new(scenario: &ScenarioConfig) -> Self {
        Self { scenario: scenario.clone() }
    }

    /// The scenario.
    pub fn scenario(&self) -> &ScenarioConfig {
        &self.scenario
    }

    /// R = r I and the diagonal of W per segment (1/N^2): the scenario's, or shares of what its straight arm answers its
    /// cables with under the weights at the end. Allocates.
    ///
    /// # Errors
    /// A node of the arm has no mass.
    pub fn tension_weights(&self) -> Result<(f64, Vec<f64>), CourseError> {
        let scenario = &self.scenario;
        let change = match &scenario.weight_tension_change {
            Some(change) => change.clone(),
            None => {
                let arm = Arm::new(&scenario.arm);
                let goal = self.goal(scenario.duration_s);
                let answers = sensitivity(&arm, &scenario.planner, scenario.arm.rho_inf, &goal)
                    .map_err(|_| CourseError::Massless)?;
                answers.into_iter().map(|a| CHANGE_SHARE * a).collect()
            }
        };
        let least = change.iter().copied().fold(f64::INFINITY, f64::min);
        Ok((scenario.weight_tension.unwrap_or(TENSION_SHARE * least), change))
    }

    /// Desired outputs and weights at time `t` (s).
    pub fn goal(&self, t: f64) -> Goal<'_> {
        match &self.scenario.task {
            Task::Tip { path, weight_pose, weight_rate, weight_damping } => {
                let (position, quaternion) = path.pose_at(t);
                Goal::Tip {
                    position: Vector3::from(position),
                    quaternion: Vector4::from(quaternion),
                    pose: *weight_pose,
                    rate: *weight_rate,
                    damping: *weight_damping,
                }
            }
            task @ Task::Shape { curvatures_1pm, .. } => {
                Goal::Shape { curvatures: curvatures_1pm, weight: task.shape_weight_at(t).unwrap_or(0.0), rate: 1.0 }
            }
        }
    }

    /// Obstacles at time 0. Allocates.
    ///
    /// # Errors
    /// A shape or pose that cannot be, or too many.
    pub fn obstacles(&self) -> Result<ObstacleSet, CourseError> {
        let mut set = ObstacleSet::new();
        for (k, o) in self.scenario.obstacles.iter().enumerate() {
            let shape = Shape::new(&o.shape).map_err(|source| CourseError::Shape { id: o.id.clone(), source })?;
            let at = |source| CourseError::Pose { id: o.id.clone(), source };
            let placed = pose(o.motion.position_at(0.0), o.quaternion).map_err(at)?;
            let obstacle = Obstacle::new(k as u64, shape, &placed).map_err(at)?;
            set.insert(obstacle).map_err(|SetFull(_)| CourseError::TooMany(k))?;
        }
        Ok(set)
    }

    /// Moves the obstacles of [`Course::obstacles`] to time `t`. Does not allocate.
    pub fn place(&self, set: &mut ObstacleSet, t: f64) {
        for (k, o) in self.scenario.obstacles.iter().enumerate() {
            if let Ok(placed) = pose(o.motion.position_at(t), o.quaternion) {
                // Both calls were checked for this obstacle at time 0; positions of a checked motion stay finite.
                let _ = set.set_pose(k, &placed);
            }
        }
    }

    /// State and tensions at t = 0, with consistent accelerations and multipliers. Allocates.
    ///
    /// # Errors
    /// No equilibrium was found.
    pub fn start(&self, arm_config: &ArmConfig) -> Result<(State, Vec<f64>), CourseError> {
        let arm = Arm::new(arm_config);
        let nc = arm.cable_count();
        let low = vec![arm_config.tension_n_min; nc];
        let high = arm_config.tension_maxima_n();
        let mut stepper = Stepper::new(&arm);
        let mut state = State::at_rest(arm.straight());
        let u = match &self.scenario.start {
            Start::Straight => {
                equilibrium(&arm, &mut stepper, &low, &mut state)?;
                low
            }
            Start::Tensions(u) => {
                equilibrium(&arm, &mut stepper, u, &mut state)?;
                u.clone()
            }
            Start::TipPose { guess_curvatures_1pm } => {
                state = State::at_rest(arm.bent(guess_curvatures_1pm));
                let Goal::Tip { position, quaternion, .. } = self.goal(0.0) else {
                    unreachable!("the reader refuses a tip pose as the start of a shape task")
                };
                tip_start(&arm, position, quaternion, &low, &high, &mut state)?
            }
        };
        consistent_start(&arm, &mut stepper, &u, &mut state)?;
        Ok((state, u))
    }
}
