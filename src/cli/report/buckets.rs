//! Series that stay small however long a recording is: the least and the largest value of each bucket of time, so that no
//! peak is lost. Buckets double their width when there are too many.

use serde::Serialize;
use serde::ser::{SerializeSeq, Serializer};

/// Most buckets; at least half of them are in use once the width has doubled.
const BUCKETS: usize = 6000;
/// Digits that are kept of a number.
const DIGITS: i32 = 5;

/// Width of all buckets of a report, and where the first begins.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub(super) struct Grid {
    /// Time of the first bucket's beginning (s).
    pub(super) from_s: f64,
    /// Width of a bucket (s).
    pub(super) width_s: f64,
    /// How often the first width was doubled.
    #[serde(skip)]
    doubled: u32,
}

impl Grid {
    pub(super) fn new(from_s: f64, width_s: f64) -> Self {
        Self { from_s, width_s, doubled: 0 }
    }

    /// The bucket of a time, after the width was doubled until there is room for it. Times before the first count to it.
    pub(super) fn place(&mut self, time_s: f64) -> usize {
        loop {
            // A time that is a multiple of the width must not fall short of it by rounding.
            let place = ((time_s - self.from_s) / self.width_s + 1e-6).floor().max(0.0);
            if place < BUCKETS as f64 {
                return place as usize;
            }
            self.width_s *= 2.0;
            self.doubled += 1;
        }
    }
}

/// Least and largest value of each bucket; NaN where there was none.
#[derive(Debug, Clone, Default)]
pub(super) struct Series {
    low: Vec<f32>,
    high: Vec<f32>,
    doubled: u32,
}

impl Series {
    /// Adds a value at a place of a grid; one that is no number is left out.
    pub(super) fn add(&mut self, grid: &Grid, place: usize, value: f64) {
        if !value.is_finite() {
            return;
        }
        while self.doubled < grid.doubled {
            self.doubled += 1;
            self.low = pairs(&self.low, f32::min);
            self.high = pairs(&self.high, f32::max);
        }
        if self.low.len() <= place {
            self.low.resize(place + 1, f32::NAN);
            self.high.resize(place + 1, f32::NAN);
        }
        let value = value as f32;
        self.low[place] = self.low[place].min(value);
        self.high[place] = self.high[place].max(value);
    }

    /// True if nothing was added.
    pub(super) fn is_empty(&self) -> bool {
        self.low.is_empty()
    }

    /// The series on the grid as it is now.
    pub(super) fn finish(mut self, grid: &Grid) -> Bounds {
        while self.doubled < grid.doubled {
            self.doubled += 1;
            self.low = pairs(&self.low, f32::min);
            self.high = pairs(&self.high, f32::max);
        }
        Bounds { low: Short(self.low), high: Short(self.high) }
    }
}

/// Neighbours in one; `f32::min` and `max` pass over what is no number.
fn pairs(values: &[f32], join: fn(f32, f32) -> f32) -> Vec<f32> {
    values.chunks(2).map(|pair| pair.iter().copied().fold(f32::NAN, join)).collect()
}

/// A series as the page has it.
#[derive(Debug, Serialize)]
pub(super) struct Bounds {
    low: Short,
    high: Short,
}

/// Numbers with few digits; null where there is none.
#[derive(Debug)]
struct Short(Vec<f32>);

impl Serialize for Short {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        let mut list = serializer.serialize_seq(Some(self.0.len()))?;
        for value in &self.0 {
            match rounded(f64::from(*value)) {
                whole if whole.fract() == 0.0 && whole.abs() < 1e6 => list.serialize_element(&(whole as i64))?,
                value => list.serialize_element(&value.is_finite().then_some(value))?,
            }
        }
        list.end()
    }
}

fn rounded(value: f64) -> f64 {
    if value == 0.0 || !value.is_finite() {
        return value;
    }
    let digits = DIGITS - 1 - value.abs().log10().floor() as i32;
    // Divided by a power of ten where it has one: a product would leave digits behind.
    match digits {
        0.. => (value * 10f64.powi(digits)).round() / 10f64.powi(digits),
        _ => (value / 10f64.powi(-digits)).round() * 10f64.powi(-digits),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn no_peak_is_lost_however_long_it_takes() {
        let mut grid = Grid::new(0.0, 0.001);
        let (mut series, mut late) = (Series::default(), Series::default());
        let ticks = 1_000_000;
        for tick in 0..ticks {
            let place = grid.place(f64::from(tick) * 0.001);
            let value = match tick {
                123_456 => 7.0,
                654_321 => -7.0,
                _ => f64::from(tick % 100) * 0.01,
            };
            series.add(&grid, place, value);
            if tick == 900_000 {
                late.add(&grid, place, 3.0);
            }
        }
        let bounds = series.finish(&grid);
        let (low, high) = (&bounds.low.0, &bounds.high.0);
        assert!(low.len() <= BUCKETS && low.len() >= BUCKETS / 2, "{}", low.len());
        assert_eq!(high[(123.456 / grid.width_s) as usize], 7.0);
        assert_eq!(low[(654.321 / grid.width_s) as usize], -7.0);
        assert_eq!(high.iter().filter(|v| **v > 1.0).count(), 1);
        let late = late.finish(&grid);
        let at = late.high.0.iter().position(|v| *v == 3.0).unwrap();
        assert_eq!((at, late.high.0.len()), ((900.0 / grid.width_s) as usize, at + 1));
        assert!(late.low.0[..at].iter().all(|v| v.is_nan()));
    }

    #[test]
    fn numbers_are_written_shortly_and_what_is_none_as_null() {
        let text = serde_json::to_string(&Short(vec![0.012_345_678, f32::NAN, 25.0, -123_456.7, 0.0])).unwrap();
        assert_eq!(text, "[0.012346,null,25,-123460,0]");
    }
}
