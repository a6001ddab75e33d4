//! A cable's pull against what the arm does: the moment that the observer finds beside the tensions that were sent.
//!
//! With `m` that moment (two numbers a segment), a cable that pulls `1 + x` times what it is told adds `x u_c` at its own lever:
//! as `u_c` changes, `m` must change with it, in that direction. Everything else that makes `m` has another form, and how
//! large it may be is known: a wrong stiffness `a K theta` and a wrong damping `b K theta'` along the bend, a load that is
//! constant. So for each segment the last seconds are explained twice, by these alone and with one cable's `x` beside them,
//! each by least squares with what is likely of `a`, `b` and the load as a prior. A cable is named where its `x` explains far
//! more than chance, is as large as declared beyond its own uncertainty, and the other segments need no such explanation: a
//! load at the tip or a hand on the arm shows in all segments before it, a lying drive in its own.

use super::lengths::segments_of;
use crate::config::ArmConfig;
use crate::estimator::CableSpace;
use crate::model::Arm;

/// Explanations that every segment has: stiffness, damping, load (two).
const COMMON: usize = 4;
/// Samples are taken at this interval (s): what lies between them tells nothing of its own.
const SAMPLE_S: f64 = 0.1;
/// Samples are forgotten with this time constant (s).
const MEMORY_S: f64 = 4.0;
/// What is likely of stiffness (1), damping (s) and load (rad of bend).
const STIFFNESS: f64 = 0.07;
const DAMPING_S: f64 = 1.0;
const LOAD_RAD: f64 = 0.05;
/// What m is uncertain by: a bend (rad), and a share of the pulls' moments (friction, errors of the other tensions), which stays
/// the same for some time (s).
const NOISE_RAD: f64 = 0.01;
const NOISE_SHARE: f64 = 0.06;
const NOISE_S: f64 = 0.5;
/// By how much more a cable must explain, in squares of the uncertainty.
const GAIN_MIN: f64 = 9.0;
/// Share of it that the other segments may leave unexplained.
const ELSEWHERE: f64 = 0.5;
/// Its deviation counts as far as it is certain by so many standard deviations.
const SIGMAS: f64 = 1.0;
/// Time for which a finding must last (s).
const LASTS_S: f64 = 0.3;

/// A cable that does not pull what it is told.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct WrongPull {
    /// Cable (0-based).
    pub cable: u16,
    /// Pull over the one commanded.
    pub factor: f64,
}

/// The check of one arm. [`PullCheck::new`] allocates, nothing else does.
#[derive(Debug, Clone)]
pub struct PullCheck {
    /// Levers (m) of each cable about its own segment's bends.
    lever: Vec<[f64; 2]>,
    segments: Vec<Segment>,
    limit: f64,
    since_s: f64,
    suspect: Option<u16>,
    lasted_s: f64,
    evidence: f64,
}

/// What a segment's last seconds sum up to.
#[derive(Debug, Clone)]
struct Segment {
    first: usize,
    count: usize,
    /// K (N m/rad) and length (m).
    stiffness: f64,
    length_m: f64,
    /// Products of the common explanations with each other, with each cable's, of each cable's with itself.
    common: [[f64; COMMON]; COMMON],
    with: Vec<[f64; COMMON]>,
    own: Vec<f64>,
    /// Products of m with the common explanations, the cables', itself.
    m_common: [f64; COMMON],
    m_cable: Vec<f64>,
    m2: f64,
}

/// What explains a segment best.
#[derive(Debug, Clone, Copy, Default)]
struct Explained {
    /// What the common explanations leave, in squares of the uncertainty.
    left: f64,
    /// What the best cable explains of it.
    gain: f64,
    cable: usize,
    x: f64,
    sigma: f64,
}

impl PullCheck {
    /// For an arm and a limit (share of the commanded pull). Allocates.
    pub fn new(arm: &Arm, config: &ArmConfig, limit: f64) -> Self {
        let space = CableSpace::new(arm);
        let mut lever = vec![[0.0; 2]; arm.cable_count()];
        let segments = segments_of(&space, arm)
            .into_iter()
            .zip(&config.segments)
            .enumerate()
            .map(|(s, ((first, count), segment))| {
                for c in first..first + count {
                    lever[c] = [space.lever(c)[2 * s], space.lever(c)[2 * s + 1]];
                }
                Segment {
                    first,
                    count,
                    stiffness: segment.bending_stiffness_nm2 / segment.length_m,
                    length_m: segment.length_m,
                    common: [[0.0; COMMON]; COMMON],
                    with: vec![[0.0; COMMON]; count],
                    own: vec![0.0; count],
                    m_common: [0.0; COMMON],
                    m_cable: vec![0.0; count],
                    m2: 0.0,
                }
            })
            .collect();
        Self { lever, segments, limit, since_s: 0.0, suspect: None, lasted_s: 0.0, evidence: 0.0 }
    }

    /// Forgets what was seen.
    pub fn restart(&mut self) {
        self.segments.iter_mut().for_each(Segment::forget);
        (self.since_s, self.suspect, self.lasted_s, self.evidence) = (0.0, None, 0.0, 0.0);
    }

    /// What speaks for a wrong pull, 1 where it is named: what a study looks at.
    pub const fn evidence(&self) -> f64 {
        self.evidence
    }

    /// One tick of `h` seconds: tensions `sent_n` (N), moments beside them `beside_nm` (N m), mean curvatures (1/m) and their
    /// rates, two a segment. Does not allocate.
    pub fn check(
        &mut self,
        h: f64,
        sent_n: &[f64],
        beside_nm: impl Fn(usize) -> f64,
        curvatures: &[f64],
        rates: &[f64],
    ) -> Option<WrongPull> {
        self.since_s += h;
        if self.since_s < SAMPLE_S {
            return None;
        }
        let keep = (-self.since_s / MEMORY_S).exp();
        let elapsed_s = std::mem::take(&mut self.since_s);
        let mut best = Explained::default();
        let mut left = 0.0;
        for (s, segment) in self.segments.iter_mut().enumerate() {
            let at = |values: &[f64]| [values[2 * s] * segment.length_m, values[2 * s + 1] * segment.length_m];
            let (bend, rate) = (at(curvatures), at(rates));
            let m = [beside_nm(2 * s), beside_nm(2 * s + 1)];
            segment.take(keep, &m, &bend, &rate, sent_n, &self.lever);
            let explained = segment.explain();
            left += explained.left;
            if explained.gain > best.gain {
                best = explained;
            }
        }
        let elsewhere =
            left - self.segments.get(segment_of(&self.segments, best.cable)).map_or(0.0, |s| s.explain().left);
        // A factor of 2 and one of a half are as wrong; that much of it is certain.
        let factor = 1.0 + best.x;
        let near = if best.x > 0.0 { factor - SIGMAS * best.sigma } else { (factor + SIGMAS * best.sigma).max(1e-3) };
        let size = if best.x > 0.0 { near - 1.0 } else { 1.0 / near - 1.0 };
        let elsewhere = elsewhere / (ELSEWHERE * best.gain).max(f64::MIN_POSITIVE);
        self.evidence = (size / self.limit).min(best.gain / GAIN_MIN).min(1.0 / elsewhere).max(0.0);
        let cable = (self.evidence > 1.0).then_some(best.cable as u16);
        self.lasted_s = if cable.is_some() && cable == self.suspect { self.lasted_s + elapsed_s } else { 0.0 };
        self.suspect = cable;
        cable.filter(|_| self.lasted_s >= LASTS_S).map(|cable| WrongPull { cable, factor })
    }
}

fn segment_of(segments: &[Segment], cable: usize) -> usize {
    segments.iter().position(|s| (s.first..s.first + s.count).contains(&cable)).unwrap_or(0)
}

impl Segment {
    fn forget(&mut self) {
        self.common = [[0.0; COMMON]; COMMON];
        self.m_common = [0.0; COMMON];
        self.with.fill([0.0; COMMON]);
        self.own.fill(0.0);
        self.m_cable.fill(0.0);
        self.m2 = 0.0;
    }

    /// Takes a sample in; `keep` is what is kept of those before.
    fn take(&mut self, keep: f64, m: &[f64; 2], bend: &[f64; 2], rate: &[f64; 2], sent_n: &[f64], lever: &[[f64; 2]]) {
        let cables = self.first..self.first + self.count;
        let pulls: f64 = cables.clone().map(|c| sent_n[c] * lever[c][0].hypot(lever[c][1])).sum();
        let noise = NOISE_RAD * self.stiffness + NOISE_SHARE * pulls;
        let weight = SAMPLE_S / NOISE_S / (noise * noise);
        let k = self.stiffness;
        self.m2 *= keep;
        self.m_common.iter_mut().for_each(|v| *v *= keep);
        self.common.iter_mut().flatten().for_each(|v| *v *= keep);
        self.with.iter_mut().flatten().for_each(|v| *v *= keep);
        self.own.iter_mut().chain(&mut self.m_cable).for_each(|v| *v *= keep);
        for row in 0..2 {
            // Each in units of what is likely of it.
            let common = [
                STIFFNESS * k * bend[row],
                DAMPING_S * k * rate[row],
                LOAD_RAD * k * f64::from(u8::from(row == 0)),
                LOAD_RAD * k * f64::from(u8::from(row == 1)),
            ];
            self.m2 += weight * m[row] * m[row];
            for i in 0..COMMON {
                self.m_common[i] += weight * m[row] * common[i];
                for j in 0..COMMON {
                    self.common[i][j] += weight * common[i] * common[j];
                }
            }
            for (n, c) in cables.clone().enumerate() {
                let pull = sent_n[c] * lever[c][row];
                self.own[n] += weight * pull * pull;
                self.m_cable[n] += weight * m[row] * pull;
                for i in 0..COMMON {
                    self.with[n][i] += weight * pull * common[i];
                }
            }
        }
    }

    /// What the common explanations leave, and which cable explains most of that.
    fn explain(&self) -> Explained {
        let mut a = self.common;
        (0..COMMON).for_each(|i| a[i][i] += 1.0);
        let Some(factor) = cholesky(a) else { return Explained::default() };
        let m = forward(&factor, &self.m_common);
        let mut best = Explained { left: (self.m2 - dot(&m, &m)).max(0.0), ..Explained::default() };
        for n in 0..self.count {
            let v = forward(&factor, &self.with[n]);
            // Nothing is presumed of a cable, but that x = 3 is rare.
            let s = self.own[n] + 1.0 / 9.0 - dot(&v, &v);
            let t = self.m_cable[n] - dot(&v, &m);
            let gain = t * t / s;
            if gain > best.gain {
                best = Explained { gain, cable: self.first + n, x: t / s, sigma: (1.0 / s).sqrt(), ..best };
            }
        }
        best
    }
}

fn dot(a: &[f64; COMMON], b: &[f64; COMMON]) -> f64 {
    a.iter().zip(b).map(|(a, b)| a * b).sum()
}

/// Lower factor of a symmetric matrix; `None` where it is not positive.
fn cholesky(mut a: [[f64; COMMON]; COMMON]) -> Option<[[f64; COMMON]; COMMON]> {
    for i in 0..COMMON {
        for j in 0..=i {
            let s: f64 = a[i][j] - (0..j).map(|k| a[i][k] * a[j][k]).sum::<f64>();
            if i == j {
                if s <= 0.0 || !s.is_finite() {
                    return None;
                }
                a[i][i] = s.sqrt();
            } else {
                a[i][j] = s / a[j][j];
            }
        }
    }
    Some(a)
}

/// `L^-1 b`.
fn forward(l: &[[f64; COMMON]; COMMON], b: &[f64; COMMON]) -> [f64; COMMON] {
    let mut x = *b;
    for i in 0..COMMON {
        let s: f64 = (0..i).map(|k| l[i][k] * x[k]).sum();
        x[i] = (x[i] - s) / l[i][i];
    }
    x
}
