//! Statistics of a run, tick by tick.

use super::summary::{
    Approach, Count, Loop, Newton, ObstacleSummary, Percentiles, Saturation, Summary, Swarm, Tensions, Times, TipError,
};
use crate::config::BodyModel;
use crate::planner::{Branch, Goal, Report};
use hdrhistogram::Histogram;
use std::collections::BTreeMap;

/// One tick of a run as the statistics see it.
#[derive(Debug, Clone, Copy)]
pub struct Tick<'a> {
    /// Time at the end of the step (s).
    pub time_s: f64,
    /// Tensions (N).
    pub tensions: &'a [f64],
    /// Surface distance per obstacle along the whole arm (m).
    pub along_arm: &'a [f64],
    /// Surface distance per obstacle at the paper's points (m).
    pub at_points: &'a [f64],
    /// Tip position error (m) and quaternion error, target of this time.
    pub tip_error: Option<([f64; 3], [f64; 4])>,
    /// Largest curvature error (1/m).
    pub curvature_error: Option<f64>,
    /// Branch, Newton iterations and whether they converged; none while the loop holds or starts.
    pub step: Option<(Branch, usize, bool)>,
    /// Particles that the step's swarm evaluated; 0 where none searched or it is not known.
    pub swarm_evaluations: usize,
    /// Planning time (us).
    pub plan_us: Option<f64>,
    /// Whole cycle (us).
    pub cycle_us: Option<f64>,
    /// Lateness of the wake-up (us).
    pub wakeup_us: Option<f64>,
}

/// Collects [`Tick`]s into a [`Summary`].
#[derive(Debug)]
pub struct Collector {
    names: Vec<String>,
    cables: Vec<String>,
    tension_maxima: Vec<f64>,
    ticks: u64,
    not_converged: u64,
    /// Steps whose distances were relaxed, and that left pairs out.
    short: Option<(u64, u64)>,
    iterations: [(u64, u64, u64); 2],
    along: Vec<Track>,
    points: Vec<Track>,
    tension: (f64, f64),
    saturated: BTreeMap<String, Saturation>,
    tip: Option<(TipError, f64)>,
    quaternion: Option<f64>,
    curvature: Option<f64>,
    times: [Histogram<u64>; 4],
    /// Particles evaluated, and planning time of the steps that searched (us).
    swarm: (u64, f64),
    /// Ticks left out, and ticks that overran.
    missed: Option<[u64; 2]>,
    faults: Vec<String>,
}

/// Depth from which a time counts as inside (m): an arm planned to touch lies within rounding of the surface.
pub(super) const INSIDE_M: f64 = 1e-6;

#[derive(Debug, Clone)]
struct Track {
    minimum: f64,
    at: f64,
    inside: Vec<[f64; 2]>,
    open: bool,
}

impl Track {
    fn new() -> Self {
        Self { minimum: f64::INFINITY, at: f64::NAN, inside: Vec::new(), open: false }
    }

    fn add(&mut self, t: f64, d: f64) {
        if d < self.minimum {
            (self.minimum, self.at) = (d, t);
        }
        let inside = d < -INSIDE_M;
        if inside {
            if self.open {
                if let Some(last) = self.inside.last_mut() {
                    last[1] = t;
                }
            } else {
                self.inside.push([t, t]);
            }
        }
        self.open = inside;
    }
}

impl Collector {
    /// For a run with these obstacles; `cables_per_segment` gives the cables' names `"segment,cable"`,
    /// `tension_maxima` their largest tensions (N).
    pub fn new(obstacles: &[String], cables_per_segment: &[usize], tension_maxima: &[f64]) -> Self {
        let cables = cables_per_segment
            .iter()
            .enumerate()
            .flat_map(|(s, n)| (1..=*n).map(move |c| format!("{},{c}", s + 1)))
            .collect();
        Self {
            names: obstacles.to_vec(),
            cables,
            tension_maxima: tension_maxima.to_vec(),
            ticks: 0,
            not_converged: 0,
            short: None,
            iterations: [(0, 0, 0); 2],
            along: vec![Track::new(); obstacles.len()],
            points: vec![Track::new(); obstacles.len()],
            tension: (f64::INFINITY, f64::NEG_INFINITY),
            saturated: BTreeMap::new(),
            tip: None,
            quaternion: None,
            curvature: None,
            // Three digits; they grow as needed, so no bound has to be guessed.
            times: std::array::from_fn(|_| Histogram::new(3).unwrap_or_else(|_| unreachable!("3 digits are valid"))),
            swarm: (0, 0.0),
            missed: None,
            faults: Vec::new(),
        }
    }

    /// Adds a tick.
    pub fn add(&mut self, tick: &Tick<'_>) {
        self.ticks += 1;
        for (tracks, distances) in [(&mut self.along, tick.along_arm), (&mut self.points, tick.at_points)] {
            for (track, d) in tracks.iter_mut().zip(distances) {
                track.add(tick.time_s, *d);
            }
        }
        for ((name, u), most) in self.cables.iter().zip(tick.tensions).zip(&self.tension_maxima) {
            self.tension = (self.tension.0.min(*u), self.tension.1.max(*u));
            if *u >= most * (1.0 - 5e-9) {
                let entry = self
                    .saturated
                    .entry(name.clone())
                    .or_insert(Saturation { first_s: round_time(tick.time_s), ticks: 0 });
                entry.ticks += 1;
            }
        }
        if let Some((error, quaternion)) = tick.tip_error {
            let norm = error.iter().map(|e| e * e).sum::<f64>().sqrt();
            let (tip, sum) = self.tip.get_or_insert((
                TipError { min: [f64::INFINITY; 3], max: [f64::NEG_INFINITY; 3], norm_max: 0.0, norm_mean: 0.0 },
                0.0,
            ));
            for c in 0..3 {
                tip.min[c] = tip.min[c].min(error[c]);
                tip.max[c] = tip.max[c].max(error[c]);
            }
            tip.norm_max = tip.norm_max.max(norm);
            *sum += norm;
            let worst = quaternion.iter().fold(0.0f64, |a, e| a.max(e.abs()));
            self.quaternion = Some(self.quaternion.unwrap_or(0.0).max(worst));
        }
        if tick.curvature_error.is_some() {
            self.curvature = tick.curvature_error;
        }
        if let Some((branch, iterations, converged)) = tick.step {
            let which = usize::from(branch == Branch::Warning);
            let (steps, sum, most) = &mut self.iterations[which];
            *steps += 1;
            *sum += iterations as u64;
            *most = (*most).max(iterations as u64);
            self.not_converged += u64::from(!converged);
            if let Some(us) = tick.plan_us {
                record(&mut self.times[which], us);
            }
        }
        if tick.swarm_evaluations > 0 {
            self.swarm.0 += tick.swarm_evaluations as u64;
            self.swarm.1 += tick.plan_us.unwrap_or(0.0);
        }
        if let Some(us) = tick.cycle_us {
            record(&mut self.times[2], us);
        }
        if let Some(us) = tick.wakeup_us {
            record(&mut self.times[3], us);
        }
    }

    /// Adds what a step's report says of its distances.
    pub fn add_report(&mut self, report: &Report) {
        let (relaxed, truncated) = self.short.get_or_insert((0, 0));
        *relaxed += u64::from(report.relaxed);
        *truncated += u64::from(report.truncated);
    }

    /// Deadlines missed so far, by ticks left out and by ticks whose torques left after their period; marks the run as a
    /// closed loop.
    pub fn set_missed(&mut self, left_out: u64, overran: u64) {
        self.missed = Some([left_out, overran]);
    }

    /// Adds a fault in words.
    pub fn add_fault(&mut self, fault: String) {
        self.faults.push(fault);
    }

    /// True if the arm was inside an obstacle by more than `tolerance` (m), judged on a model of its body.
    pub fn contact(&self, body: BodyModel, tolerance: f64) -> bool {
        let tracks = match body {
            BodyModel::Points => &self.points,
            BodyModel::Arm => &self.along,
        };
        tracks.iter().any(|t| t.minimum < -tolerance)
    }

    /// The summary so far; `fixed_iterations` where convergence is not asked for.
    pub fn summary(
        &self,
        scenario: &str,
        seed: u64,
        period_s: f64,
        lookahead_s: f64,
        fixed_iterations: bool,
    ) -> Summary {
        let count =
            |(steps, sum, max): (u64, u64, u64)| (steps > 0).then(|| Count { mean: sum as f64 / steps as f64, max });
        let approach = |t: &Track| Approach {
            surface_distance_min_m: t.minimum,
            at_s: round_time(t.at),
            inside_s: t.inside.iter().map(|[a, b]| [round_time(*a), round_time(*b)]).collect(),
        };
        Summary {
            scenario: scenario.into(),
            seed,
            period_s,
            lookahead_s,
            ticks: self.ticks,
            not_converged: (!fixed_iterations).then_some(self.not_converged),
            relaxed: self.short.map(|short| short.0),
            truncated: self.short.map(|short| short.1),
            newton: Newton {
                safe: count(self.iterations[0]).filter(|_| !fixed_iterations),
                warning: count(self.iterations[1]).filter(|_| !fixed_iterations),
            },
            obstacles: self
                .names
                .iter()
                .zip(self.along.iter().zip(&self.points))
                .map(|(id, (along, points))| {
                    let a = approach(along);
                    ObstacleSummary {
                        id: id.clone(),
                        surface_distance_min_m: a.surface_distance_min_m,
                        at_s: a.at_s,
                        inside_s: a.inside_s,
                        points: approach(points),
                    }
                })
                .collect(),
            tension_n: Tensions { min: self.tension.0, max: self.tension.1, saturated: self.saturated.clone() },
            tip_error_m: self.tip.map(|(tip, sum)| TipError { norm_mean: sum / self.ticks.max(1) as f64, ..tip }),
            quaternion_error_max: self.quaternion,
            curvature_error_final_1pm: self.curvature,
            time_us: Times {
                safe: percentiles(&self.times[0]),
                warning: percentiles(&self.times[1]),
                cycle: percentiles(&self.times[2]),
            },
            swarm: (self.swarm.0 > 0).then(|| Swarm {
                evaluations: self.swarm.0,
                evaluations_per_s: (self.swarm.1 > 0.0).then(|| 1e6 * self.swarm.0 as f64 / self.swarm.1),
            }),
            loop_: self.missed.map(|[left_out, overran]| Loop {
                missed: left_out + overran,
                left_out,
                overran,
                wakeup_us: percentiles(&self.times[3]),
            }),
            faults: self.faults.clone(),
        }
    }
}

/// Histograms count whole nanoseconds.
fn record(histogram: &mut Histogram<u64>, us: f64) {
    // An auto-resizing histogram takes every value; `saturating_record` would clamp to its present size.
    let _ = histogram.record((us * 1e3).max(1.0) as u64);
}

fn percentiles(histogram: &Histogram<u64>) -> Option<Percentiles> {
    let at = |q: f64| histogram.value_at_quantile(q) as f64 / 1e3;
    (!histogram.is_empty()).then(|| Percentiles { p50: at(0.5), p99: at(0.99), max: histogram.max() as f64 / 1e3 })
}

/// Times are multiples of the period: take away the rounding of their sums.
fn round_time(t: f64) -> f64 {
    (t * 1e6).round() / 1e6
}

/// The tip's errors against a goal: position (m) and quaternion in the tip's hemisphere.
pub fn tip_error(goal: &Goal<'_>, tip: &crate::model::Outputs) -> Option<([f64; 3], [f64; 4])> {
    let Goal::Tip { position, quaternion, .. } = goal else { return None };
    let near = if quaternion.dot(&tip.quaternion) < 0.0 { -quaternion } else { *quaternion };
    Some(((tip.position - position).into(), (tip.quaternion - near).into()))
}
