//! One strand of the body's centre line, an element's cubic or a straight connector, and the closest point of a
//! stretch of it to a convex obstacle.
//!
//! The signed distance to a convex set is convex in space but not along a curve that bends around the obstacle, so a
//! bracketing search alone can stop in the wrong place. Every sample, though, carries a cut: with the outward normal
//! `n_a` at `c(a)`, `f(xi) >= f(a) + n_a . (c(xi) - c(a))`. Two cuts bound a stretch from below; a stretch whose bound
//! is not below the best value found is done, any other is split. That makes the minimum global to [`GAP_M`], and
//! the root search on the slope makes its parameter exact.

use nalgebra::Vector3;

/// A stretch is done when nothing in it can be lower than the best by more than this (m).
pub(super) const GAP_M: f64 = 1e-10;

/// Most samples spent on one stretch. Reached only where the curve runs parallel to the surface and around it, for then
/// all its points are equally close.
pub(super) const SAMPLES_MAX: usize = 96;

/// A bracket narrower than this (of the whole strand) is a point.
const WIDTH_MIN: f64 = 1e-12;

/// A slope below this share of the curve's speed is a zero of the slope.
const SLOPE_ZERO: f64 = 1e-13;

/// `c(xi) = c0 + c1 xi + c2 xi^2 + c3 xi^3`, xi in [0, 1], for fixed node positions and tangents.
#[derive(Debug, Clone, Copy)]
pub(super) struct Curve {
    coefficients: [Vector3<f64>; 4],
    /// Bezier control points: the curve lies in their hull.
    pub(super) control: [Vector3<f64>; 4],
    /// Largest |c''|.
    pub(super) bend: f64,
}

impl Curve {
    pub(super) fn empty() -> Self {
        Self { coefficients: [Vector3::zeros(); 4], control: [Vector3::zeros(); 4], bend: 0.0 }
    }

    /// Cubic Hermite curve from `a` with derivative `da` to `b` with derivative `db`.
    pub(super) fn hermite(a: Vector3<f64>, da: Vector3<f64>, b: Vector3<f64>, db: Vector3<f64>) -> Self {
        let c2 = (b - a) * 3.0 - da * 2.0 - db;
        let c3 = (a - b) * 2.0 + da + db;
        let bend = (c2 * 2.0).norm().max((c2 * 2.0 + c3 * 6.0).norm());
        Self { coefficients: [a, da, c2, c3], control: [a, a + da / 3.0, b - db / 3.0, b], bend }
    }

    /// Straight from `a` along `step`.
    pub(super) fn straight(a: Vector3<f64>, step: Vector3<f64>) -> Self {
        let zero = Vector3::zeros();
        Self {
            coefficients: [a, step, zero, zero],
            control: [a, a + step / 3.0, a + step * (2.0 / 3.0), a + step],
            bend: 0.0,
        }
    }

    pub(super) fn at(&self, xi: f64) -> Vector3<f64> {
        let [c0, c1, c2, c3] = &self.coefficients;
        c0 + (c1 + (c2 + c3 * xi) * xi) * xi
    }

    fn derivative(&self, xi: f64) -> Vector3<f64> {
        let [_, c1, c2, c3] = &self.coefficients;
        c1 + (c2 * 2.0 + c3 * (3.0 * xi)) * xi
    }

    fn second_derivative(&self, xi: f64) -> Vector3<f64> {
        let [_, _, c2, c3] = &self.coefficients;
        c2 * 2.0 + c3 * (6.0 * xi)
    }

    /// Distance and slope at `xi`, `distance` giving signed distance and outward normal at a point.
    pub(super) fn sample(&self, xi: f64, distance: &impl Fn(&Vector3<f64>) -> (f64, Vector3<f64>)) -> Sample {
        let position = self.at(xi);
        let (value, normal) = distance(&position);
        let tangent = self.derivative(xi);
        Sample { xi, position, value, normal, slope: normal.dot(&tangent), speed: tangent.norm() }
    }

    /// Lower bound of the distance over the whole strand from one sample's cut.
    pub(super) fn lower_bound(&self, position: &Vector3<f64>, value: f64, normal: &Vector3<f64>) -> f64 {
        let lowest = self.control.iter().map(|b| normal.dot(&(b - position))).fold(f64::INFINITY, f64::min);
        value + lowest
    }

    /// Lower bound over a stretch, and the parameter where it is attained.
    fn stretch_bound(&self, a: &Sample, b: &Sample) -> (f64, f64) {
        let width = b.xi - a.xi;
        let ends = [self.second_derivative(a.xi), self.second_derivative(b.xi)];
        // c'' is linear in xi, so its component towards the obstacle is largest at an end.
        let bend = [&a.normal, &b.normal].iter().flat_map(|n| ends.iter().map(|e| -n.dot(e))).fold(0.0, f64::max);
        let sag = 0.5 * bend * width * width;
        // The cut of a lies below f at b, that of b below f at a, and their difference is linear in xi.
        let below_a = (a.value - (b.value - b.slope * width - sag)).max(0.0);
        let below_b = (b.value - (a.value + a.slope * width - sag)).max(0.0);
        let share = if below_a + below_b > 0.0 { below_a / (below_a + below_b) } else { 0.5 };
        let x = share * width;
        ((a.value + a.slope * x - 0.5 * bend * x * x).min(a.value).min(b.value), a.xi + x)
    }

    /// Closest sample of the stretch between `a` and `b`, exact unless it lies above `limit`; the flag is false where
    /// the samples ran out first. Does not allocate while `stack` has room for [`SAMPLES_MAX`] stretches.
    pub(super) fn closest(
        &self,
        a: Sample,
        b: Sample,
        limit: f64,
        stack: &mut Vec<(Sample, Sample)>,
        distance: &impl Fn(&Vector3<f64>) -> (f64, Vector3<f64>),
    ) -> (Sample, bool) {
        let mut best = if b.value < a.value { b } else { a };
        let mut samples = 0;
        stack.clear();
        stack.push((a, b));
        while let Some((a, b)) = stack.pop() {
            let (bound, at) = self.stretch_bound(&a, &b);
            let open = |bound: f64, best: f64| bound < (best - GAP_M).min(limit);
            // NaN closes every stretch.
            if !open(bound, best.value) {
                continue;
            }
            if samples >= SAMPLES_MAX {
                return (best, false);
            }
            let width = b.xi - a.xi;
            if a.is_falling() && b.is_rising() {
                let (low, high) = self.stationary(a, b, &mut samples, distance);
                for end in [low, high] {
                    if end.value.is_nan() {
                        return (end, true);
                    }
                    if end.value < best.value {
                        best = end;
                    }
                }
                stack.push((a, low));
                stack.push((high, b));
            } else {
                samples += 1;
                let middle = self.sample(at.clamp(a.xi + 0.1 * width, b.xi - 0.1 * width), distance);
                if middle.value.is_nan() {
                    return (middle, true);
                }
                if middle.value < best.value {
                    best = middle;
                }
                stack.push((a, middle));
                stack.push((middle, b));
            }
        }
        (best, true)
    }

    /// Lowest point between a falling and a rising sample, as the two ends of what remains of the stretch (equal at a
    /// zero of the slope).
    ///
    /// Secant steps find the zero of a smooth slope; where they are slow, the crossing of the cuts finds a kink, a small
    /// step beyond it brings the other end along, and halving bounds the work whatever the function.
    fn stationary(
        &self,
        mut a: Sample,
        mut b: Sample,
        samples: &mut usize,
        distance: &impl Fn(&Vector3<f64>) -> (f64, Vector3<f64>),
    ) -> (Sample, Sample) {
        let mut step = Step::Secant;
        let mut last = a.xi;
        while *samples < SAMPLES_MAX {
            let width = b.xi - a.xi;
            let (bound, crossing) = self.stretch_bound(&a, &b);
            if width < WIDTH_MIN || bound >= a.value.min(b.value) - 1e-3 * GAP_M {
                break;
            }
            let wish = match step {
                Step::Secant => a.xi + width * (-a.slope / (b.slope - a.slope)),
                Step::Crossing => crossing,
                // The crossing misses a kink by second order in the width.
                Step::Beyond if last <= a.xi => a.xi + 0.25 * width * width,
                Step::Beyond => b.xi - 0.25 * width * width,
                Step::Halve => a.xi + 0.5 * width,
            };
            // Inside by a little, so that a step always counts.
            let margin = 0.25 * WIDTH_MIN;
            *samples += 1;
            let middle = self.sample(wish.clamp(a.xi + margin, b.xi - margin), distance);
            last = middle.xi;
            if middle.is_falling() {
                a = middle;
            } else if middle.is_rising() {
                b = middle;
            } else {
                return (middle, middle);
            }
            step = if b.xi - a.xi <= 0.5 * width { Step::Secant } else { step.next() };
        }
        (a, b)
    }
}

/// How the next sample between a falling and a rising one is chosen.
#[derive(Debug, Clone, Copy)]
enum Step {
    Secant,
    Crossing,
    Beyond,
    Halve,
}

impl Step {
    fn next(self) -> Self {
        match self {
            Self::Secant => Self::Crossing,
            Self::Crossing => Self::Beyond,
            Self::Beyond => Self::Halve,
            Self::Halve => Self::Secant,
        }
    }
}

/// The distance at one parameter.
#[derive(Debug, Clone, Copy)]
pub(super) struct Sample {
    pub(super) xi: f64,
    pub(super) position: Vector3<f64>,
    pub(super) value: f64,
    pub(super) normal: Vector3<f64>,
    slope: f64,
    speed: f64,
}

impl Sample {
    fn is_falling(&self) -> bool {
        self.slope < -SLOPE_ZERO * self.speed
    }

    fn is_rising(&self) -> bool {
        self.slope > SLOPE_ZERO * self.speed
    }
}
