//! An open-loop run as a recording, with the schemas of all of sinew.

use sinew::config::Task;
use sinew::daemon::{plan_into, warning_branch};
use sinew::ipc::payload::{MAX_CABLES, MAX_TRACKED, Obstacle, ObstacleDistance, Obstacles, State, Target, TargetMode};
use sinew::planner::Goal;
use sinew::recording::{About, Recording, RecordingError, Viewer};
use sinew::report::tip_error;
use sinew::scenario::{Run, Step};
use sinew_hal::clock::seconds_to_ns;
use std::fs::File;
use std::io::BufWriter;
use std::path::Path;

/// Pictures for viewers a second; a plan has ten steps in one.
const PICTURES_1PS: u32 = 30;

/// Writes each step's planned state, its target and its obstacles.
pub(crate) struct PlanRecording {
    file: Recording<BufWriter<File>>,
    state: Box<State>,
    obstacles: Box<Obstacles>,
    lengths: Vec<f64>,
}

impl PlanRecording {
    pub(crate) fn create(path: &Path, run: &Run) -> Result<Self, RecordingError> {
        let scenario = run.course().scenario();
        let mut viewer = Viewer::new(&scenario.arm, PICTURES_1PS);
        for (k, obstacle) in scenario.obstacles.iter().enumerate() {
            viewer = viewer.map(|viewer| viewer.naming(0, obstacle_id(k), &obstacle.id));
        }
        let about = About::new(&scenario.arm.name)
            .with("scenario", &scenario.name)
            .with("seed", run.seed())
            .with("warning", format!("{:?}", run.planner().config().warning))
            .set(scenario)
            .shown(viewer);
        Ok(Self {
            file: Recording::create(path, &about)?,
            state: Box::default(),
            obstacles: Box::default(),
            lengths: vec![0.0; scenario.arm.cable_count()],
        })
    }

    pub(crate) fn write(&mut self, run: &Run, step: &Step) -> Result<(), RecordingError> {
        let time_ns = seconds_to_ns(step.time_s);
        self.fill_state(run, step);
        self.file.state(time_ns, &self.state)?;
        self.file.target(time_ns, &target(run, step.time_s))?;
        self.fill_obstacles(run, step.time_s);
        self.obstacles.header.sequence = run.steps();
        self.obstacles.header.capture_ns = time_ns;
        self.file.obstacles(time_ns, &self.obstacles)
    }

    pub(crate) fn finish(self) -> Result<(), RecordingError> {
        self.file.finish().map(|_| ())
    }

    fn fill_state(&mut self, run: &Run, step: &Step) {
        let arm = &run.planner().arm;
        let (q, qd) = (&run.state().q, &run.state().qd);
        let s = &mut *self.state;
        s.header.tick = run.steps();
        s.header.sequence = run.steps();
        s.header.capture_ns = seconds_to_ns(step.time_s);
        s.time_s = step.time_s;
        plan_into(Some(&step.report), warning_branch(run.planner().config().warning), s);
        s.timing.plan_ns = step.plan_ns;
        let cables = arm.cable_count().min(MAX_CABLES);
        s.cable_count = cables as u32;
        s.segment_count = arm.segment_count() as u32;
        s.tension_command_n[..cables].copy_from_slice(&run.tensions()[..cables]);
        arm.cable_lengths_into(q, &mut self.lengths);
        s.cable_length_m[..cables].copy_from_slice(&self.lengths[..cables]);
        s.tip_position_m = step.tip.position.into();
        s.tip_quaternion = step.tip.quaternion.into();
        s.tip_velocity_mps = step.tip.velocity.into();
        s.tip_angular_velocity_radps = step.tip.angular_velocity.into();
        let (mut k, mut kd) = (vec![0.0; 2 * arm.segment_count()], vec![0.0; 2 * arm.segment_count()]);
        arm.curvatures_into(q, qd, &mut k, &mut kd);
        s.curvature_1pm[..k.len()].copy_from_slice(&k);
        let goal = run.course().goal(step.time_s);
        if let Some((position, quaternion)) = tip_error(&goal, &step.tip) {
            (s.tip_error_m, s.quaternion_error) = (norm(&position), norm(&quaternion));
        }
        match goal {
            Goal::Tip { position, quaternion, .. } => {
                s.target_mode = TargetMode::Tip.wire();
                s.target_position_m = position.into();
                s.target_quaternion = quaternion.into();
            }
            Goal::Shape { curvatures, .. } => {
                s.target_mode = TargetMode::Shape.wire();
                s.target_curvature_1pm[..curvatures.len()].copy_from_slice(curvatures);
                s.curvature_error_1pm = k.iter().zip(curvatures).fold(0.0, |a, (k, d)| f64::max(a, (k - d).abs()));
            }
        }
        s.set_nodes(arm.node_count(), |i| arm.pose(q, i + 1).0.into(), |i| arm.pose(q, i + 1).1.into());
        let (along_arm, _) = run.distances();
        s.distance_count = along_arm.len().min(MAX_TRACKED) as u32;
        for (k, d) in along_arm.iter().take(MAX_TRACKED).enumerate() {
            s.distances[k] =
                ObstacleDistance { source_id: 0, obstacle_id: obstacle_id(k), surface_distance_m: *d, growth_m: 0.0 };
        }
    }

    fn fill_obstacles(&mut self, run: &Run, t: f64) {
        let set = &mut *self.obstacles;
        (set.count, set.vertex_count) = (0, 0);
        for (k, o) in run.course().scenario().obstacles.iter().enumerate() {
            let mut placed = Obstacle::ball(obstacle_id(k), o.motion.position_at(t), 0.0);
            placed.quaternion = o.quaternion;
            placed.velocity_mps = o.motion.velocity_at(t);
            // A scenario has no more obstacles than the planner has room for, which is this set's room.
            let _fits = set.push_shape(placed, &o.shape);
        }
    }
}

/// Obstacles of a scenario count from 1, as their clients number them.
const fn obstacle_id(place: usize) -> u32 {
    place as u32 + 1
}

fn norm(values: &[f64]) -> f64 {
    values.iter().map(|value| value * value).sum::<f64>().sqrt()
}

fn target(run: &Run, t: f64) -> Target {
    let mut target = Target::default();
    target.header.sequence = run.steps();
    target.header.capture_ns = seconds_to_ns(t);
    target.valid_from_ns = target.header.capture_ns;
    match &run.course().scenario().task {
        Task::Tip { path, .. } => {
            (target.position_m, target.quaternion) = path.pose_at(t);
            target.velocity_mps = path.velocity_at(t);
        }
        task @ Task::Shape { curvatures_1pm, .. } => {
            target.weight = task.shape_weight_at(t).unwrap_or(0.0);
            target.mode = TargetMode::Shape.wire();
            target.segment_count = (curvatures_1pm.len() / 2) as u32;
            target.curvature_1pm[..curvatures_1pm.len()].copy_from_slice(curvatures_1pm);
        }
    }
    target
}
