//! How far the tip swings beside the motion that is wanted of it.
//!
//! The estimated tip is laid beside the reference's of as long ago as the reference is ahead of the arm, and what changes slowly
//! (errors of the model and of following) is taken out. Cables hardly see what swings beside the mean curvatures, so neither
//! does the estimate: of such a swing it shows no less than [`SHOWN`]. It goes on, while what a turn of the path excites, and
//! the estimate shows whole, fades within seconds. So what is said is the larger of the peak as it is shown, and of what lasts
//! over that share: more than there is, rather than less. Where the tip is measured, what the estimate lacks is added, and what is
//! shown is all that there is.

use nalgebra::Vector3;

/// Time constant of what counts as slow (s).
const SLOW_S: f64 = 1.0;
/// Time constant with which a swing that has ended is forgotten (s).
const FORGET_S: f64 = 3.0;

/// Time constant of what lasts (s).
const LASTS_S: f64 = 6.0;
/// Least share of a true swing that the estimate shows, by `examples/lies.rs` (`swing`).
const SHOWN: f64 = 0.25;

/// The swing of one arm. [`Swing::new`] allocates, nothing else does.
#[derive(Debug, Clone)]
pub struct Swing {
    started: bool,
    /// The reference's tip of the last ticks (m), the oldest overwritten first.
    references: Vec<Vector3<f64>>,
    next: usize,
    /// The tip beside the reference that it is to be at (m).
    beside: Vector3<f64>,
    /// Two low-pass filters in a row.
    slow: [Vector3<f64>; 2],
    /// The same of what the estimate lacks, while that is measured.
    slow_unseen: Option<[Vector3<f64>; 2]>,
    amplitude_m: f64,
    /// Mean square of what there may be (m^2).
    square_m2: f64,
}

impl Swing {
    /// With a reference that is so many ticks ahead of the arm. Allocates.
    pub fn new(ahead_ticks: usize) -> Self {
        Self {
            started: false,
            references: vec![Vector3::zeros(); ahead_ticks + 1],
            next: 0,
            beside: Vector3::zeros(),
            slow: [Vector3::zeros(); 2],
            slow_unseen: None,
            amplitude_m: 0.0,
            square_m2: 0.0,
        }
    }

    /// Forgets what was.
    pub fn restart(&mut self) {
        (self.started, self.amplitude_m, self.square_m2) = (false, 0.0, 0.0);
        (self.beside, self.slow_unseen) = (Vector3::zeros(), None);
    }

    /// The tip beside the reference's of as long ago as that is ahead of the arm (m, base frame).
    pub const fn beside(&self) -> Vector3<f64> {
        self.beside
    }

    /// One tick of `h` seconds with the estimated tip, what it lacks where that is measured, and the reference's tip (m); returns
    /// the swing as it is shown and as it may be, peak to peak (m).
    pub fn follow(
        &mut self,
        h: f64,
        tip: &Vector3<f64>,
        unseen: Option<&Vector3<f64>>,
        reference: &Vector3<f64>,
    ) -> (f64, f64) {
        if !self.started {
            self.started = true;
            self.references.fill(*reference);
            self.slow = [tip - reference, Vector3::zeros()];
        }
        self.references[self.next] = *reference;
        self.next = (self.next + 1) % self.references.len();
        self.beside = tip - self.references[self.next];
        let mut fast = fast_part(h, self.beside, &mut self.slow);
        // A sensor that comes or goes is no swing.
        self.slow_unseen = unseen.map(|unseen| {
            let mut slow = self.slow_unseen.unwrap_or([*unseen, Vector3::zeros()]);
            fast += fast_part(h, *unseen, &mut slow);
            slow
        });
        self.amplitude_m = (self.amplitude_m * (1.0 - h / (FORGET_S + h))).max(fast.norm());
        let shown = if unseen.is_some() { 1.0 } else { SHOWN };
        self.square_m2 += h / (LASTS_S + h) * (fast.norm_squared() / (shown * shown) - self.square_m2);
        let (peak_m, lasting_m) = (2.0 * self.amplitude_m, (8.0 * self.square_m2).sqrt());
        (peak_m, peak_m.max(lasting_m))
    }
}

/// What is left of a signal without its slow part.
fn fast_part(h: f64, signal: Vector3<f64>, slow: &mut [Vector3<f64>; 2]) -> Vector3<f64> {
    slow.iter_mut().fold(signal, |fast, slow| {
        *slow += h / (SLOW_S + h) * (fast - *slow);
        fast - *slow
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    const H: f64 = 0.01;

    /// Largest swing said from 5 s on of a tip that follows a reference 0.2 s late and swings beside it.
    fn said(path: impl Fn(f64) -> f64, beside: impl Fn(f64) -> f64) -> f64 {
        let mut swing = Swing::new(20);
        let at = |x: f64| Vector3::new(x, 0.0, 0.0);
        (0..3000)
            .map(|k| {
                let t = f64::from(k) * H;
                let (m, most) = swing.follow(H, &at(path((t - 0.2).max(0.0)) + beside(t)), None, &at(path(t)));
                assert!(most >= m);
                if t > 5.0 { m } else { 0.0 }
            })
            .fold(0.0, f64::max)
    }

    #[test]
    fn a_tip_that_follows_its_reference_does_not_swing_however_late() {
        let corner = |t: f64| if t < 10.0 { 0.05 * t } else { 1.0 - 0.05 * t };
        assert!(said(corner, |_| 0.0) < 1e-4);
        assert!(said(corner, |_| 0.02) < 1e-4, "nor one that is off");
    }

    #[test]
    fn what_a_sensor_sees_beside_the_estimate_is_said_as_it_is_and_its_coming_and_going_is_no_swing() {
        let wave = |t: f64| 0.01 * (std::f64::consts::TAU * 0.33 * t).sin();
        let mut most = [0.0f64; 2];
        let mut swing = Swing::new(20);
        for k in 0..12000 {
            let t = f64::from(k) * H;
            // It is off by 30 mm, comes at 5 s, swings from 10 to 30 s, and goes at 115 s.
            let unseen = (5.0..115.0)
                .contains(&t)
                .then(|| Vector3::new(0.03 + if (10.0..30.0).contains(&t) { wave(t - 10.0) } else { 0.0 }, 0.0, 0.0));
            let (_, said) = swing.follow(H, &Vector3::zeros(), unseen.as_ref(), &Vector3::zeros());
            let part = usize::from((15.0..30.0).contains(&t));
            if part == 1 || !(10.0..110.0).contains(&t) {
                most[part] = most[part].max(said);
            }
        }
        assert!(most[0] < 5e-4 && (0.015..0.0225).contains(&most[1]), "{most:?}");
    }

    #[test]
    fn a_tip_that_swings_does_so_at_rest_and_on_its_way() {
        for path in [|_| 0.0, |t: f64| 0.05 * t] {
            for frequency in [0.33, 0.6, 2.0] {
                let m = said(path, |t| 0.01 * (std::f64::consts::TAU * frequency * t).sin());
                assert!((0.015..0.0215).contains(&m), "{frequency} Hz: {m}");
            }
        }
    }
}
