//! Cables in SI units: tension (N) to torque on the wire, counts to cable length (m), each drive within its limits.
//!
//! Enters: tensions and counts. Leaves: torques (per mille of rated torque, as object 6071 has them) and lengths. It
//! must never let a number that is not finite through, and never allocates after it is made.
//!
//! A cable runs over a drum of radius r behind a gear of ratio g (motor turns per drum turn):
//! `torque = sign * tension * r / g`, `per mille = 1000 * torque / rated`, rounded to the nearest whole number whose tension
//! is within the channel's limits, so that no rounding leaves them. So the
//! tension on the wire comes in steps of `rated * g / (1000 r)` ([`MotorChannel::tension_quantum_n`]); at 5 N m, gear 1
//! and 0.02 m that is 0.25 N, and the rounding error is at most half of it, next to a limit all of it. Length comes in steps of
//! `2 pi r / (g * counts per turn)`. Positive torque pulls where `sign` is `Forward`; the length is of the cable
//! *paid out*, so that pulling makes it smaller.

use std::f64::consts::TAU;
use thiserror::Error;

/// Counts of a 32-bit encoder from home to where they run over.
const COUNTS_EITHER_WAY: f64 = 2_147_483_647.0;

/// Which turn of the motor pulls.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum Sense {
    /// Positive torque and rising counts pull the cable in.
    #[default]
    Forward,
    /// Negative torque and falling counts pull the cable in.
    Reverse,
}

impl Sense {
    const fn sign(self) -> f64 {
        match self {
            Self::Forward => 1.0,
            Self::Reverse => -1.0,
        }
    }
}

/// One cable's drive train.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct MotorChannel {
    /// Drum radius to the cable's centre (m).
    pub drum_radius_m: f64,
    /// Motor turns per drum turn.
    pub gear_ratio: f64,
    /// Which turn pulls.
    pub sense: Sense,
    /// Rated torque of the motor (N m), object 6076.
    pub rated_torque_nm: f64,
    /// Encoder counts per motor turn.
    pub counts_per_turn: f64,
    /// Least tension that is commanded (N), 0 or a pretension.
    pub tension_n_min: f64,
    /// Largest tension that is commanded (N).
    pub tension_n_max: f64,
    /// Counts at which the cable has its homing length.
    pub home_counts: i32,
    /// Length at those counts (m).
    pub home_length_m: f64,
    /// Most by which the cable's length may ever differ from that (m), either way: what the encoder's 32 bits must count.
    pub travel_m: f64,
}

/// A channel that cannot work.
#[derive(Debug, Clone, Copy, PartialEq, Error)]
pub enum ChannelError {
    /// A value out of its range.
    #[error("cable {cable}: {key} = {value}, must be {range}")]
    Value {
        /// Index of the cable.
        cable: usize,
        /// Field.
        key: &'static str,
        /// Value given.
        value: f64,
        /// What it must be.
        range: &'static str,
    },
    /// The cable may travel further than the encoder's 32 bits count.
    #[error(
        "cable {cable}: counts_per_turn = {counts_per_turn}, must be 1 to {counts_per_turn_max:.0}: 32 bits of an encoder count \
         {reach_m:.4} m of cable either way (gear_ratio, drum_radius_m), and it may travel {travel_m:.4} m"
    )]
    Reach {
        /// Index of the cable.
        cable: usize,
        /// Encoder counts per motor turn.
        counts_per_turn: f64,
        /// Most with which the encoder reaches.
        counts_per_turn_max: f64,
        /// Length that the encoder counts from home, either way (m).
        reach_m: f64,
        /// Length that the cable may travel (m).
        travel_m: f64,
    },
    /// The largest tension needs more torque than the wire or the drive has.
    #[error("cable {cable}: {tension_n} N need {permille} per mille of rated torque, the limit is {limit_permille}")]
    Torque {
        /// Index of the cable.
        cable: usize,
        /// Largest tension (N).
        tension_n: f64,
        /// Torque that it needs (per mille).
        permille: f64,
        /// Largest torque of the drive (per mille).
        limit_permille: u16,
    },
}

/// A tension that must not be sent.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Error)]
pub enum EncodeError {
    /// NaN or infinite.
    #[error("tension of cable {cable} is not finite")]
    NotFinite {
        /// Index of the cable.
        cable: usize,
    },
    /// Another number of tensions than cables.
    #[error("{found} values for {expected} cables")]
    Count {
        /// Cables.
        expected: usize,
        /// Values.
        found: usize,
    },
}

impl MotorChannel {
    /// Per mille of rated torque for one newton, unsigned.
    fn permille_per_n(&self) -> f64 {
        1000.0 * self.drum_radius_m / (self.gear_ratio * self.rated_torque_nm)
    }

    /// Whole per mille of rated torque within the limits of the tension; the upper one is the torque that the drive itself is
    /// to permit. Where the limits have no whole number between them, the lower one is the upper one.
    fn permille_limits(&self) -> (f64, f64) {
        // A limit that is a whole number is permitted, however it was computed.
        let exact = |tension_n: f64| tension_n * self.permille_per_n();
        let high = (exact(self.tension_n_max) * (1.0 + 1e-12)).floor();
        ((exact(self.tension_n_min) * (1.0 - 1e-12)).ceil().min(high), high)
    }

    /// Torque of the largest tension (per mille of rated torque), rounded down: what a drive must not exceed for whatever it
    /// is told.
    pub fn torque_permille_max(&self) -> u16 {
        #[allow(clippy::cast_possible_truncation, clippy::cast_sign_loss)] // clamped
        let permille = self.permille_limits().1.clamp(0.0, f64::from(u16::MAX)) as u16;
        permille
    }

    /// Length paid out per count, unsigned (m).
    pub fn length_quantum_m(&self) -> f64 {
        TAU * self.drum_radius_m / (self.gear_ratio * self.counts_per_turn)
    }

    /// Step of the tension on the wire (N).
    pub fn tension_quantum_n(&self) -> f64 {
        1.0 / self.permille_per_n()
    }

    /// Torque (per mille of rated torque) for a tension (N), which is cut to the channel's limits; `None` if it is not
    /// finite. The second value tells whether it was cut.
    pub fn encode_tension(&self, tension_n: f64) -> Option<(i16, bool)> {
        if !tension_n.is_finite() {
            return None;
        }
        let cut = tension_n.clamp(self.tension_n_min, self.tension_n_max);
        let (low, high) = self.permille_limits();
        let permille = self.sense.sign() * (cut * self.permille_per_n()).round().min(high).max(low);
        #[allow(clippy::cast_possible_truncation)] // clamped to i16
        let permille = permille.clamp(f64::from(i16::MIN), f64::from(i16::MAX)) as i16;
        Some((permille, cut != tension_n))
    }

    /// Tension (N) of a torque (per mille of rated torque); negative when the motor pushes.
    pub fn decode_tension(&self, torque_permille: i16) -> f64 {
        self.sense.sign() * f64::from(torque_permille) / self.permille_per_n()
    }

    /// Length paid out (m) at the encoder's counts. The difference to the homing counts wraps as the encoder's 32 bits
    /// do, so a counter that runs over is no jump.
    pub fn decode_length(&self, counts: i32) -> f64 {
        let turned = f64::from(counts.wrapping_sub(self.home_counts));
        self.home_length_m - self.sense.sign() * turned * self.length_quantum_m()
    }

    /// Counts nearest to a length paid out (m); `None` if it is not finite or out of the encoder's range.
    pub fn encode_length(&self, length_m: f64) -> Option<i32> {
        let turned = (self.sense.sign() * (self.home_length_m - length_m) / self.length_quantum_m()).round();
        let fits = turned.is_finite() && turned >= f64::from(i32::MIN) && turned <= f64::from(i32::MAX);
        #[allow(clippy::cast_possible_truncation)] // just tested
        fits.then(|| self.home_counts.wrapping_add(turned as i32))
    }

    fn check(&self, cable: usize, limit_permille: u16) -> Result<(), ChannelError> {
        let positive = [
            ("drum_radius_m", self.drum_radius_m),
            ("gear_ratio", self.gear_ratio),
            ("rated_torque_nm", self.rated_torque_nm),
            ("counts_per_turn", self.counts_per_turn),
        ];
        for (key, value) in positive {
            if !(value.is_finite() && value > 0.0) {
                return Err(ChannelError::Value { cable, key, value, range: "finite and above 0" });
            }
        }
        let value = self.tension_n_min;
        if !(value.is_finite() && value >= 0.0) {
            return Err(ChannelError::Value { cable, key: "tension_n_min", value, range: "finite and at least 0" });
        }
        let value = self.tension_n_max;
        if !(value.is_finite() && value > self.tension_n_min) {
            return Err(ChannelError::Value {
                cable,
                key: "tension_n_max",
                value,
                range: "finite and above the least",
            });
        }
        let value = self.home_length_m;
        if !value.is_finite() {
            return Err(ChannelError::Value { cable, key: "home_length_m", value, range: "finite" });
        }
        let travel_m = self.travel_m;
        if !(travel_m.is_finite() && travel_m >= 0.0) {
            let range = "finite and at least 0";
            return Err(ChannelError::Value { cable, key: "travel_m", value: travel_m, range });
        }
        // Beyond it `decode_length` would take a run-over counter for a motion the other way.
        let reach_m = COUNTS_EITHER_WAY * self.length_quantum_m();
        if reach_m < travel_m {
            let counts_per_turn = self.counts_per_turn;
            let counts_per_turn_max = (counts_per_turn * reach_m / travel_m).floor();
            return Err(ChannelError::Reach { cable, counts_per_turn, counts_per_turn_max, reach_m, travel_m });
        }
        let permille = self.tension_n_max * self.permille_per_n();
        if permille.round() > f64::from(limit_permille.min(i16::MAX.unsigned_abs())) {
            return Err(ChannelError::Torque { cable, tension_n: self.tension_n_max, permille, limit_permille });
        }
        Ok(())
    }
}

/// All cables, in the order of the master's drives.
#[derive(Debug, Clone, PartialEq)]
pub struct MotorBank {
    channels: Vec<MotorChannel>,
}

impl MotorBank {
    /// Checks every channel against its drive's largest torque (per mille, object 6072).
    ///
    /// # Errors
    /// [`ChannelError`] of the first channel that cannot work.
    pub fn new(channels: Vec<(MotorChannel, u16)>) -> Result<Self, ChannelError> {
        for (cable, (channel, limit)) in channels.iter().enumerate() {
            channel.check(cable, *limit)?;
        }
        Ok(Self { channels: channels.into_iter().map(|(c, _)| c).collect() })
    }

    /// The channels.
    pub fn channels(&self) -> &[MotorChannel] {
        &self.channels
    }

    /// Homing: the cable now has this length (m) at these counts. An index without a cable is ignored.
    pub fn set_home(&mut self, cable: usize, counts: i32, length_m: f64) {
        if let Some(c) = self.channels.get_mut(cable)
            && length_m.is_finite()
        {
            c.home_counts = counts;
            c.home_length_m = length_m;
        }
    }

    /// Tensions (N) into torques (per mille of rated torque); returns how many were cut to their limits. On an error
    /// nothing in `torques_permille` is touched. Does not allocate.
    ///
    /// # Errors
    /// [`EncodeError`].
    pub fn encode_into(&self, tensions_n: &[f64], torques_permille: &mut [i16]) -> Result<usize, EncodeError> {
        self.count(tensions_n.len())?;
        self.count(torques_permille.len())?;
        if let Some(cable) = tensions_n.iter().position(|t| !t.is_finite()) {
            return Err(EncodeError::NotFinite { cable });
        }
        let mut cut = 0;
        for (cable, (channel, &tension)) in self.channels.iter().zip(tensions_n).enumerate() {
            let (torque, limited) = channel.encode_tension(tension).ok_or(EncodeError::NotFinite { cable })?;
            torques_permille[cable] = torque;
            cut += usize::from(limited);
        }
        Ok(cut)
    }

    /// Counts into lengths paid out (m). Does not allocate.
    ///
    /// # Errors
    /// [`EncodeError::Count`].
    pub fn decode_lengths_into(&self, counts: &[i32], lengths_m: &mut [f64]) -> Result<(), EncodeError> {
        self.count(counts.len())?;
        self.count(lengths_m.len())?;
        for ((channel, &c), out) in self.channels.iter().zip(counts).zip(lengths_m) {
            *out = channel.decode_length(c);
        }
        Ok(())
    }

    fn count(&self, found: usize) -> Result<(), EncodeError> {
        let expected = self.channels.len();
        if found == expected { Ok(()) } else { Err(EncodeError::Count { expected, found }) }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn channel() -> impl Strategy<Value = MotorChannel> {
        (0.005f64..0.05, 1.0f64..20.0, any::<bool>(), 0.5f64..20.0, 1000.0f64..1e6, any::<i32>(), -1.0f64..3.0)
            .prop_map(
                |(drum_radius_m, gear_ratio, reverse, rated_torque_nm, counts_per_turn, home_counts, home_length_m)| {
                    MotorChannel {
                        drum_radius_m,
                        gear_ratio,
                        sense: if reverse { Sense::Reverse } else { Sense::Forward },
                        rated_torque_nm,
                        counts_per_turn,
                        tension_n_min: 0.0,
                        tension_n_max: 0.9 * gear_ratio * rated_torque_nm / drum_radius_m,
                        home_counts,
                        home_length_m,
                        travel_m: 0.65,
                    }
                },
            )
    }

    proptest! {
        #[test]
        fn tension_comes_back_within_half_a_step_and_never_outside_the_limits(
            c in channel(),
            share in 0.0f64..=1.0,
            least in 0.0f64..0.5,
        ) {
            let c = MotorChannel { tension_n_min: least * c.tension_n_max, ..c };
            let tension = c.tension_n_min + share * (c.tension_n_max - c.tension_n_min);
            let (torque, cut) = c.encode_tension(tension).unwrap();
            prop_assert!(!cut);
            let (back, step) = (c.decode_tension(torque), c.tension_quantum_n());
            let inner = (tension - c.tension_n_min).min(c.tension_n_max - tension) > 0.5 * step;
            let most = if inner { 0.5 } else { 1.0 } * step * (1.0 + 1e-9);
            prop_assert!((back - tension).abs() <= most);
            prop_assert!(back <= c.tension_n_max * (1.0 + 1e-9));
            prop_assert!(back >= c.tension_n_min * (1.0 - 1e-9) || c.tension_n_max - c.tension_n_min < step);
            prop_assert!(torque.unsigned_abs() <= c.torque_permille_max());
            // Pulling has the sense's sign.
            prop_assert!(f64::from(torque) * c.sense.sign() >= 0.0);
        }

        #[test]
        fn any_number_is_cut_to_the_limits_or_refused(c in channel(), tension: f64) {
            match c.encode_tension(tension) {
                None => prop_assert!(!tension.is_finite()),
                Some((torque, cut)) => {
                    prop_assert!(tension.is_finite());
                    prop_assert_eq!(cut, tension < c.tension_n_min || tension > c.tension_n_max);
                    prop_assert!(torque.unsigned_abs() <= 900);
                }
            }
        }

        #[test]
        fn counts_come_back_exactly(c in channel(), turned in -2_000_000i32..2_000_000) {
            let counts = c.home_counts.wrapping_add(turned);
            prop_assert_eq!(c.encode_length(c.decode_length(counts)), Some(counts));
        }

        #[test]
        fn pulling_shortens(c in channel(), turned in 1i32..1_000_000) {
            let pulled = c.home_counts.wrapping_add(if c.sense == Sense::Forward { turned } else { -turned });
            prop_assert!(c.decode_length(pulled) < c.home_length_m);
        }
    }

    fn one() -> MotorChannel {
        MotorChannel {
            drum_radius_m: 0.02,
            gear_ratio: 1.0,
            sense: Sense::Reverse,
            rated_torque_nm: 5.0,
            counts_per_turn: 65_536.0,
            tension_n_min: 5.0,
            tension_n_max: 220.0,
            home_counts: 10,
            home_length_m: 0.65,
            travel_m: 0.65,
        }
    }

    #[test]
    fn a_tension_by_hand() {
        let c = one();
        assert_eq!(c.encode_tension(220.0), Some((-880, false))); // 4.4 N m of 5
        assert_eq!(c.encode_tension(0.0), Some((-20, true)));
        assert!((c.tension_quantum_n() - 0.25).abs() < 1e-12);
        assert!((c.decode_length(10 + 65_536) - (0.65 + TAU * 0.02)).abs() < 1e-12);
    }

    #[test]
    fn a_limit_between_two_steps_is_rounded_inwards() {
        // As the shipped drives: 942.86 per mille at 220 N, 0.2333 N a step.
        let c = MotorChannel { drum_radius_m: 0.015, gear_ratio: 10.0, rated_torque_nm: 0.35, ..one() };
        let (torque, _) = c.encode_tension(220.0).unwrap();
        assert_eq!((torque, c.torque_permille_max()), (-942, 942));
        assert!(c.decode_tension(torque) <= 220.0);
        let (torque, _) = c.encode_tension(5.0).unwrap();
        assert!(c.decode_tension(torque) >= 5.0, "{torque}");
    }

    #[test]
    fn one_bad_tension_stops_the_whole_vector() {
        let bank = MotorBank::new(vec![(one(), 1000); 3]).unwrap();
        let mut out = [7; 3];
        assert_eq!(bank.encode_into(&[10.0, f64::NAN, 10.0], &mut out), Err(EncodeError::NotFinite { cable: 1 }));
        assert_eq!(out, [7; 3]);
        assert_eq!(bank.encode_into(&[10.0; 2], &mut out), Err(EncodeError::Count { expected: 3, found: 2 }));
        assert_eq!(bank.encode_into(&[10.0, 500.0, 10.0], &mut out), Ok(1));
        assert_eq!(out, [-40, -880, -40]);
    }

    #[test]
    fn an_encoder_that_runs_over_within_the_cables_travel_is_refused_with_the_counts_that_do_not() {
        // 1e8 counts a turn behind a gear of 1000 on 20 mm: 2^31 counts are 2.7 mm.
        let fine = MotorChannel { gear_ratio: 1000.0, counts_per_turn: 1e8, ..one() };
        let Err(ChannelError::Reach { cable: 1, counts_per_turn_max, reach_m, travel_m, .. }) =
            MotorBank::new(vec![(one(), 1000), (fine, 1000)])
        else {
            panic!("taken")
        };
        assert!((2.6e-3..2.8e-3).contains(&reach_m) && travel_m == 0.65);
        let text = MotorBank::new(vec![(fine, 1000)]).unwrap_err().to_string();
        assert!(text.contains(&format!("counts_per_turn = 100000000, must be 1 to {counts_per_turn_max}:")), "{text}");
        // At the number named, both ends of the travel are read as they are; with one more they are not permitted.
        let most = MotorChannel { counts_per_turn: counts_per_turn_max, home_counts: i32::MAX - 5, ..fine };
        assert!(MotorBank::new(vec![(most, 1000)]).is_ok());
        for length in [0.0, 0.65, 1.3] {
            let counts = most.encode_length(length).unwrap();
            assert!((most.decode_length(counts) - length).abs() <= most.length_quantum_m());
        }
        let more = MotorChannel { counts_per_turn: counts_per_turn_max + 1.0, ..most };
        assert!(MotorBank::new(vec![(more, 1000)]).is_err());
    }

    #[test]
    fn a_tension_beyond_the_drive_is_refused_at_the_door() {
        let e = MotorBank::new(vec![(one(), 800)]).unwrap_err();
        assert!(matches!(e, ChannelError::Torque { cable: 0, limit_permille: 800, .. }), "{e}");
        let bad = MotorChannel { travel_m: f64::NAN, ..one() };
        assert!(MotorBank::new(vec![(bad, 1000)]).is_err());
        let bad = MotorChannel { drum_radius_m: 0.0, ..one() };
        assert!(MotorBank::new(vec![(bad, 1000)]).is_err());
    }
}
