//! Encoders: silent, jumping, sticking; and readings that may be used.

use crate::config::GuardConfig;
use crate::control::CableMask;
use crate::control::fault::{Fault, FaultList};
use sinew_hal::clock::seconds_to_ns;

/// The newest cable lengths, as they came.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct EncoderReadings<'a> {
    /// Cable lengths (m), one per cable.
    pub lengths_m: &'a [f64],
    /// Which of them were measured.
    pub valid: CableMask,
    /// When (ns).
    pub capture_ns: u64,
}

/// What is known of one encoder.
#[derive(Debug, Clone, Copy)]
struct Track {
    /// Last reading (m); `None` before the first one.
    last_m: Option<f64>,
    /// Its time (ns).
    heard_ns: u64,
    /// Since when the reading is exactly the same (ns).
    same_since_ns: u64,
    /// Time after `heard_ns` in which the loop itself did not run and no encoder could be asked (ns).
    paused_ns: u64,
    /// The same after `same_since_ns` (ns).
    same_paused_ns: u64,
    /// Least and largest length of the model's cable since the reading changed (m).
    model_m: (f64, f64),
    /// Length of the model's cable when the last reading came (m); `None` without a model.
    model_at_reading_m: Option<f64>,
}

const BLANK: Track = Track {
    last_m: None,
    heard_ns: 0,
    same_since_ns: 0,
    paused_ns: 0,
    same_paused_ns: 0,
    model_m: (0.0, 0.0),
    model_at_reading_m: None,
};

/// How far the model's cable moved since the track's last reading (m); 0 without a model.
fn moved(model_m: Option<f64>, track: &Track) -> f64 {
    model_m.zip(track.model_at_reading_m).map_or(0.0, |(now, then)| now - then)
}

/// What of the readings is watched.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Watch {
    /// Nothing: they are only taken over.
    Nothing,
    /// Silence and jumps. The model has not settled, and that it moves says nothing of the arm.
    Settling,
    /// Silence, jumps, and readings that stay the same while the model moves.
    All,
}

/// Judges readings and bridges gaps.
#[derive(Debug, Clone)]
pub struct EncoderGuard {
    jump_m: f64,
    stuck_ns: u64,
    stuck_motion_m: f64,
    silent_ns: u64,
    period_ns: u64,
    checked_ns: Option<u64>,
    tracks: Vec<Track>,
    lengths_m: Vec<f64>,
    bridged: CableMask,
}

impl EncoderGuard {
    /// For so many cables, checked every `period_s`. Allocates.
    pub fn new(config: &GuardConfig, cables: usize, period_s: f64) -> Self {
        Self {
            jump_m: config.encoder_jump_m,
            stuck_ns: seconds_to_ns(config.encoder_stuck_s),
            stuck_motion_m: config.encoder_stuck_motion_m,
            silent_ns: seconds_to_ns(config.encoder_silent_s),
            period_ns: seconds_to_ns(period_s),
            checked_ns: None,
            tracks: vec![BLANK; cables],
            lengths_m: vec![f64::NAN; cables],
            bridged: CableMask::default(),
        }
    }

    /// Lengths (m) that may be used after [`Self::check`]: readings, or for a missing one the last reading moved on with
    /// the model's cable. NaN where nothing was ever heard.
    pub fn lengths_m(&self) -> &[f64] {
        &self.lengths_m
    }

    /// Cables whose length is bridged.
    pub const fn bridged(&self) -> CableMask {
        self.bridged
    }

    /// The first cable that was not heard within the limit at `now_ns`, with the age of its reading (s). Time in which
    /// the loop itself was late does not count: an encoder that was not asked cannot answer.
    pub fn silent(&self, now_ns: u64) -> Option<(u16, f64)> {
        self.tracks.iter().enumerate().find_map(|(cable, track)| {
            let age_ns = now_ns.saturating_sub(track.heard_ns).saturating_sub(track.paused_ns);
            let age_s = if track.last_m.is_some() { age_ns as f64 * 1e-9 } else { f64::INFINITY };
            (track.last_m.is_none() || age_ns > self.silent_ns).then_some((cable as u16, age_s))
        })
    }

    /// Begins anew to compare readings with the model, whose past must not count.
    pub fn restart(&mut self, now_ns: u64) {
        for track in &mut self.tracks {
            (track.same_since_ns, track.same_paused_ns) = (now_ns, 0);
            track.model_m = (f64::INFINITY, f64::NEG_INFINITY);
            track.model_at_reading_m = None;
        }
    }

    /// Takes over readings. `model_m` are the cable lengths of the model (m) while one follows the arm, a period before the
    /// readings: where these moved on by more than a period since the last call, so must it. Of the faults that `watch`
    /// names at most one of each kind is raised per call. Does not allocate.
    ///
    /// Times are those in which the loop ran; an encoder that was not asked neither falls silent nor sticks.
    ///
    /// - silent: the newest reading of a cable is older than `encoder_silent_s`;
    /// - jump: two readings in a row differ by more than `encoder_jump_m`, also from what the model's cable moved
    ///   meanwhile; or one is not a number;
    /// - stuck: a reading stayed exactly the same for `encoder_stuck_s` while the model's cable moved through more than
    ///   `encoder_stuck_motion_m`.
    ///
    /// A reading that jumped is not used in its tick; from the next one on it is what jumps are measured from.
    pub fn check(
        &mut self,
        readings: &EncoderReadings<'_>,
        now_ns: u64,
        model_m: Option<&[f64]>,
        watch: Watch,
        faults: &mut FaultList,
    ) {
        let (mut jump, mut stuck) = (None, None);
        let since_ns = now_ns.saturating_sub(self.checked_ns.unwrap_or(now_ns));
        let paused_ns = since_ns.saturating_sub(self.period_ns);
        self.checked_ns = Some(now_ns);
        self.bridged = CableMask::default();
        for (cable, track) in self.tracks.iter_mut().enumerate() {
            track.paused_ns += paused_ns;
            track.same_paused_ns += paused_ns;
            let model = model_m.map(|lengths| lengths[cable]);
            let reading = readings.lengths_m.get(cable).copied().filter(|_| readings.valid.contains(cable));
            let new = reading.filter(|_| track.last_m.is_none() || readings.capture_ns > track.heard_ns);
            let mut usable = None;
            if let Some(length) = new {
                let step_m = track.last_m.map_or(0.0, |last| length - last);
                // A quick arm moves its cables by more than the bound in a tick, but then the model moves with it.
                let unexplained_m = step_m.abs().min((step_m - moved(model, track)).abs());
                let jumped = !length.is_finite() || unexplained_m > self.jump_m;
                if jumped {
                    jump = jump.or(Some(Fault::EncoderJump { cable: cable as u16, step_m }));
                }
                if length.is_finite() && (!jumped || watch == Watch::Nothing) {
                    usable = Some(length);
                }
                if length.is_finite() {
                    if track.last_m != Some(length) {
                        (track.same_since_ns, track.same_paused_ns) = (now_ns, 0);
                        track.model_m = (f64::INFINITY, f64::NEG_INFINITY);
                    }
                    // What the jump came from carries the estimate over this tick; what it went to is the new reference.
                    if usable.is_none() {
                        self.lengths_m[cable] = track.last_m.unwrap_or(length);
                    }
                    track.last_m = Some(length);
                    track.heard_ns = readings.capture_ns;
                    // What was read at the loop's last SYNC before a pause is new, and as old as the pause.
                    track.paused_ns = paused_ns.min(now_ns.saturating_sub(readings.capture_ns));
                    track.model_at_reading_m = model;
                }
            }
            if watch == Watch::Settling {
                track.model_m = (f64::INFINITY, f64::NEG_INFINITY);
            } else if let Some(model) = model {
                track.model_m = (track.model_m.0.min(model), track.model_m.1.max(model));
                let motion_m = track.model_m.1 - track.model_m.0;
                let same_ns = now_ns.saturating_sub(track.same_since_ns).saturating_sub(track.same_paused_ns);
                if same_ns >= self.stuck_ns && motion_m > self.stuck_motion_m {
                    stuck = stuck.or(Some(Fault::EncoderStuck { cable: cable as u16, motion_m }));
                }
            }
            match usable {
                Some(length) => self.lengths_m[cable] = length,
                None => {
                    self.bridged.insert(cable);
                    if let (None, Some(last)) = (new, track.last_m) {
                        self.lengths_m[cable] = last + moved(model, track);
                    }
                }
            }
        }
        if watch != Watch::Nothing {
            let silent = self.silent(now_ns).map(|(cable, age_s)| Fault::EncoderSilent { cable, age_s });
            [silent, jump, stuck].into_iter().flatten().for_each(|fault| faults.push(fault));
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const MS: u64 = 1_000_000;

    fn guard() -> EncoderGuard {
        let config = GuardConfig {
            tension_rate_npsmax: f64::INFINITY,
            box_tolerance_n: 1e-9,
            encoder_jump_m: 0.01,
            encoder_stuck_s: 0.5,
            encoder_stuck_motion_m: 0.002,
            encoder_silent_s: 0.05,
        };
        EncoderGuard::new(&config, 2, 0.01)
    }

    fn feed(g: &mut EncoderGuard, ms: u64, lengths: [f64; 2], valid: u128, model: Option<[f64; 2]>) -> Vec<Fault> {
        let readings = EncoderReadings { lengths_m: &lengths, valid: CableMask(valid), capture_ns: ms * MS };
        let mut faults = FaultList::default();
        g.check(&readings, ms * MS, model.as_ref().map(|m| &m[..]), Watch::All, &mut faults);
        faults.iter().collect()
    }

    #[test]
    fn sound_readings_pass_unchanged() {
        let mut g = guard();
        for k in 1..200u64 {
            let l = [0.65 + 1e-4 * k as f64, 0.6];
            assert_eq!(feed(&mut g, 10 * k, l, 3, Some(l)), []);
            assert_eq!(g.lengths_m(), l);
            assert_eq!(g.bridged(), CableMask(0));
        }
    }

    #[test]
    fn a_silent_encoder_is_bridged_by_the_model_and_then_a_fault() {
        let mut g = guard();
        assert_eq!(feed(&mut g, 10, [0.65, 0.6], 3, Some([0.650, 0.6])), []);
        for k in 2..=6 {
            let model = [0.650 + 1e-3 * (k - 1) as f64, 0.6];
            assert_eq!(feed(&mut g, 10 * k, [f64::NAN, 0.6], 2, Some(model)), [], "{k}");
            assert!((g.lengths_m()[0] - model[0]).abs() < 1e-15);
            assert_eq!(g.bridged(), CableMask(1));
        }
        let faults = feed(&mut g, 70, [f64::NAN, 0.6], 2, Some([0.65, 0.6]));
        assert!(matches!(faults[..], [Fault::EncoderSilent { cable: 0, .. }]), "{faults:?}");
        assert_eq!(feed(&mut g, 80, [0.65, 0.6], 3, Some([0.65, 0.6])), [], "it may come back");
    }

    #[test]
    fn a_stale_message_is_silence_however_often_it_is_handed_over() {
        let mut g = guard();
        let lengths = [0.65, 0.6];
        let readings = EncoderReadings { lengths_m: &lengths, valid: CableMask(3), capture_ns: 10 * MS };
        for ms in (10..=60).step_by(10) {
            let mut faults = FaultList::default();
            g.check(&readings, ms * MS, None, Watch::All, &mut faults);
            assert!(faults.is_empty(), "{ms} ms");
        }
        let mut faults = FaultList::default();
        g.check(&readings, 61 * MS, None, Watch::All, &mut faults);
        assert!(matches!(faults.iter().next(), Some(Fault::EncoderSilent { cable: 0, .. })));
    }

    #[test]
    fn a_loop_that_slept_does_not_take_its_own_sleep_for_an_encoders_silence() {
        let mut g = guard();
        assert_eq!(feed(&mut g, 10, [0.65, 0.6], 3, None), []);
        // Asleep for 200 ms: the next tick finds the old readings, and the encoders get their time from then on.
        for ms in [210, 220, 230, 240, 250] {
            assert_eq!(feed(&mut g, ms, [f64::NAN, f64::NAN], 0, None), [], "{ms} ms");
        }
        let faults = feed(&mut g, 260, [f64::NAN, f64::NAN], 0, None);
        assert!(matches!(faults[..], [Fault::EncoderSilent { cable: 0, .. }]), "{faults:?}");
    }

    /// A reading of `captured` ms, taken over at `ms`.
    fn feed_old(
        g: &mut EncoderGuard,
        ms: u64,
        captured: u64,
        lengths: [f64; 2],
        model: Option<[f64; 2]>,
    ) -> Vec<Fault> {
        let readings = EncoderReadings { lengths_m: &lengths, valid: CableMask(3), capture_ns: captured * MS };
        let mut faults = FaultList::default();
        g.check(&readings, ms * MS, model.as_ref().map(|m| &m[..]), Watch::All, &mut faults);
        faults.iter().collect()
    }

    #[test]
    fn a_reading_of_the_loops_last_sync_before_its_sleep_is_no_silence_behind_it() {
        let mut g = guard();
        assert_eq!(feed_old(&mut g, 10, 1, [0.65, 0.6], None), []);
        // Asleep from the tick of 10 ms on, whose SYNC was answered at 11 ms; each encoder has its 50 ms behind it, too.
        assert_eq!(feed_old(&mut g, 210, 11, [0.65, 0.6], None), []);
        for ms in [220, 230, 240, 250] {
            assert_eq!(feed_old(&mut g, ms, 11, [0.65, 0.6], None), [], "{ms} ms");
        }
        let faults = feed_old(&mut g, 260, 11, [0.65, 0.6], None);
        assert!(matches!(faults[..], [Fault::EncoderSilent { cable: 0, .. }]), "{faults:?}");
    }

    #[test]
    fn a_reading_that_was_old_before_the_loop_slept_is_no_younger_for_it() {
        let mut g = guard();
        assert_eq!(feed_old(&mut g, 10, 9, [0.65, 0.6], None), []);
        assert_eq!(feed_old(&mut g, 20, 9, [0.65, 0.6], None), []);
        // What comes now was read long ago, while the loop ran.
        g.check(
            &EncoderReadings { lengths_m: &[0.65, 0.6], valid: CableMask(0), capture_ns: 0 },
            80 * MS,
            None,
            Watch::All,
            &mut FaultList::default(),
        );
        let faults = feed_old(&mut g, 90, 12, [0.65, 0.6], None);
        assert!(matches!(faults[..], [Fault::EncoderSilent { cable: 0, .. }]), "{faults:?}");
    }

    #[test]
    fn a_loop_that_slept_does_not_take_its_own_sleep_for_an_encoder_that_sticks() {
        let run = |asleep_ms: u64| {
            let mut g = guard();
            g.restart(0);
            assert_eq!(feed(&mut g, 10, [0.65, 0.6], 3, Some([0.65, 0.6])), []);
            // The same reading once more, for it is that of the last SYNC, and a model that went on meanwhile.
            feed(&mut g, 20 + asleep_ms, [0.65, 0.6], 3, Some([0.653, 0.6]))
        };
        assert_eq!(run(0), []);
        assert_eq!(run(700), []);
        // Awake for as long, it sticks.
        let mut g = guard();
        g.restart(0);
        let faults: Vec<Fault> =
            (1..=72).flat_map(|k| feed(&mut g, 10 * k, [0.65, 0.6], 3, Some([0.653 - 1e-4 * k as f64, 0.6]))).collect();
        assert!(matches!(faults[..], [Fault::EncoderStuck { cable: 0, .. }, ..]), "{faults:?}");
    }

    #[test]
    fn an_encoder_never_heard_is_silent_for_ever() {
        let mut g = guard();
        feed(&mut g, 10, [0.65, 0.0], 1, None);
        assert_eq!(g.silent(10 * MS), Some((1, f64::INFINITY)));
        assert!(g.lengths_m()[1].is_nan());
    }

    #[test]
    fn a_jump_is_a_fault_and_its_reading_is_not_used() {
        let mut g = guard();
        feed(&mut g, 10, [0.65, 0.6], 3, None);
        let faults = feed(&mut g, 20, [0.65, 0.611], 3, None);
        assert!(matches!(faults[..], [Fault::EncoderJump { cable: 1, step_m }] if (step_m - 0.011).abs() < 1e-12));
        assert_eq!(g.lengths_m(), [0.65, 0.6]);
        assert_eq!(feed(&mut g, 30, [0.65, 0.6115], 3, None), [], "jumps are measured from where it went");
        assert_eq!(g.lengths_m(), [0.65, 0.6115]);
    }

    #[test]
    fn a_cable_that_moves_as_quickly_as_its_model_does_not_jump() {
        let mut g = guard();
        for k in 0..20u64 {
            let x = 0.015 * k as f64;
            assert_eq!(feed(&mut g, 10 * k + 10, [0.65 + x, 0.6], 3, Some([0.65 + x, 0.6])), [], "{k}");
        }
        let faults = feed(&mut g, 210, [0.65 + 0.3 + 0.011, 0.6], 3, Some([0.65 + 0.3, 0.6]));
        assert!(matches!(faults[..], [Fault::EncoderJump { cable: 0, .. }]), "{faults:?}");
    }

    #[test]
    fn a_reading_that_is_not_a_number_is_a_fault_and_is_not_used() {
        let mut g = guard();
        feed(&mut g, 10, [0.65, 0.6], 3, None);
        let faults = feed(&mut g, 20, [f64::NAN, 0.6], 3, None);
        assert!(matches!(faults[..], [Fault::EncoderJump { cable: 0, .. }]), "{faults:?}");
        assert_eq!(g.lengths_m(), [0.65, 0.6]);
    }

    #[test]
    fn an_encoder_that_sticks_while_the_model_moves_is_a_fault() {
        let mut g = guard();
        g.restart(0);
        let first = (0..100u64).find_map(|k| {
            let x = 1e-4 * k as f64;
            feed(&mut g, 10 * k + 10, [0.65, 0.6 + x], 3, Some([0.65 + x, 0.6 + x])).first().map(|f| (k, *f))
        });
        let Some((k, Fault::EncoderStuck { cable: 0, motion_m })) = first else { panic!("{first:?}") };
        assert_eq!(k, 50, "after encoder_stuck_s");
        assert!(motion_m > 0.002);
    }

    /// Gravity on an arm softer than its file: at rest, but the estimate begins elsewhere and moves.
    #[test]
    fn a_model_that_settles_is_no_sign_of_an_encoder_that_sticks() {
        let mut g = guard();
        g.restart(0);
        let lengths = [0.65, 0.6];
        let mut step = |ms: u64, model: f64, watch: Watch| {
            let readings = EncoderReadings { lengths_m: &lengths, valid: CableMask(3), capture_ns: ms * MS };
            let mut faults = FaultList::default();
            g.check(&readings, ms * MS, Some(&[model, 0.6]), watch, &mut faults);
            faults.iter().next()
        };
        assert!((1..200).all(|k| step(10 * k, 0.65 + 1e-4 * k as f64, Watch::Settling).is_none()));
        let sticks = (200..400).find_map(|k| step(10 * k, 0.65 + 1e-4 * k as f64, Watch::All).map(|fault| (k, fault)));
        assert!(matches!(sticks, Some((220..240, Fault::EncoderStuck { cable: 0, .. }))), "{sticks:?}");
    }

    #[test]
    fn an_encoder_of_an_arm_at_rest_does_not_stick() {
        let mut g = guard();
        g.restart(0);
        for k in 1..1000 {
            assert_eq!(feed(&mut g, 10 * k, [0.65, 0.6], 3, Some([0.6501, 0.6])), []);
        }
    }

    #[test]
    fn nothing_is_a_fault_while_nobody_watches() {
        let mut g = guard();
        for (ms, lengths, valid) in [(10, [0.6, 0.6], 3), (20, [0.7, 0.5], 3), (900, [0.7, 0.5], 0)] {
            let readings = EncoderReadings { lengths_m: &lengths, valid: CableMask(valid), capture_ns: ms * MS };
            let mut faults = FaultList::default();
            g.check(&readings, ms * MS, None, Watch::Nothing, &mut faults);
            assert!(faults.is_empty());
        }
        assert_eq!(g.lengths_m(), [0.7, 0.5]);
    }
}
