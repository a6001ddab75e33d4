//! Whether the arm moves, as far as encoders and estimate tell: armed is only an arm at rest, and disarmed is told only of
//! one.

/// Speed of the tip above which the arm moves, over its length (1/s).
const TIP_1PS: f64 = 0.01;
/// Rate of a cable's length above which it does, over the arm's length (1/s).
const CABLE_1PS: f64 = 0.004;
/// Cables are looked at over this time: an encoder's step within a tick is no motion (ns).
const SPAN_NS: u64 = 200_000_000;
/// It rests when nothing has moved for this long (ns).
const STILL_NS: u64 = 1_000_000_000;

/// Looks at an arm.
#[derive(Debug, Clone)]
pub(super) struct MotionWatch {
    length_m: f64,
    lengths_m: Vec<f64>,
    since_ns: u64,
    moved_ns: Option<u64>,
}

impl MotionWatch {
    /// For an arm of a length (m) and so many cables. Allocates.
    pub(super) fn new(length_m: f64, cables: usize) -> Self {
        Self { length_m, lengths_m: vec![f64::NAN; cables], since_ns: 0, moved_ns: None }
    }

    /// Whether it moves at `now_ns`, or did lately; the tip's speed (m/s) is NaN where it is not known, and so is the length
    /// (m) of a cable that has not been heard.
    pub(super) fn moves(&mut self, now_ns: u64, tip_speed_mps: f64, lengths_m: &[f64]) -> bool {
        let mut moves = tip_speed_mps > TIP_1PS * self.length_m;
        let span_ns = now_ns.saturating_sub(self.since_ns);
        if span_ns >= SPAN_NS {
            let most = CABLE_1PS * self.length_m * 1e-9 * span_ns as f64;
            moves |= self.lengths_m.iter().zip(lengths_m).any(|(before, now)| (now - before).abs() > most);
            self.lengths_m.copy_from_slice(lengths_m);
            self.since_ns = now_ns;
        }
        if moves {
            self.moved_ns = Some(now_ns);
        }
        self.moved_ns.is_some_and(|moved| now_ns.saturating_sub(moved) < STILL_NS)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_tip_a_cable_and_what_moved_lately_move() {
        let mut watch = MotionWatch::new(1.0, 2);
        let at = |s: f64| (1e9 * s) as u64;
        assert!(!watch.moves(at(1.0), f64::NAN, &[f64::NAN; 2]));
        assert!(!watch.moves(at(2.0), f64::NAN, &[0.5, 0.5]), "what was unknown has not moved");
        assert!(!watch.moves(at(2.1), f64::NAN, &[0.51, 0.5]), "too soon to tell");
        assert!(watch.moves(at(2.2), f64::NAN, &[0.51, 0.5]));
        assert!(watch.moves(at(3.0), 0.0, &[0.51, 0.5]), "it did, not a second ago");
        assert!(!watch.moves(at(3.3), 0.009, &[0.51, 0.5]));
        assert!(watch.moves(at(3.4), 0.011, &[0.51, 0.5]));
    }
}
