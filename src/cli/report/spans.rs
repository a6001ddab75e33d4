//! Spans of time in which something was so: modes, limits, silent sources.

use serde::Serialize;
use std::collections::BTreeMap;

/// Most spans of one kind; beyond, those that are near each other are told as one.
const MOST: usize = 500;

/// A span.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub(super) struct Span {
    /// Begin (s).
    pub(super) from_s: f64,
    /// End (s).
    pub(super) to_s: f64,
    /// How often it began within; above 1 where spans were joined.
    pub(super) times: u64,
}

/// The spans of one kind.
#[derive(Debug, Clone, Default)]
pub(super) struct Spans {
    spans: Vec<Span>,
    /// Whether the last one goes on.
    open: bool,
    /// Gap up to which spans are joined (s).
    gap_s: f64,
    /// All of them together (s).
    total_s: f64,
    /// How often it began.
    times: u64,
}

impl Spans {
    /// It is so at a time, which counts up to the next one.
    fn on(&mut self, time_s: f64, period_s: f64) {
        self.total_s += period_s;
        let to_s = time_s + period_s;
        if let Some(last) = self.spans.last_mut() {
            let again = !self.open;
            if !again || time_s - last.to_s <= self.gap_s {
                last.to_s = to_s;
                last.times += u64::from(again);
                self.times += u64::from(again);
                self.open = true;
                return;
            }
        }
        self.open = true;
        self.times += 1;
        self.spans.push(Span { from_s: time_s, to_s, times: 1 });
        if self.spans.len() > MOST {
            self.join();
        }
    }

    /// Joins spans until half of them are left.
    fn join(&mut self) {
        while self.spans.len() > MOST / 2 {
            let mut gaps: Vec<f64> = self.spans.windows(2).map(|pair| pair[1].from_s - pair[0].to_s).collect();
            gaps.sort_by(f64::total_cmp);
            self.gap_s = gaps[gaps.len() / 2].max(2.0 * self.gap_s);
            let mut joined: Vec<Span> = Vec::with_capacity(MOST);
            for span in self.spans.drain(..) {
                match joined.last_mut().filter(|last| span.from_s - last.to_s <= self.gap_s) {
                    Some(last) => (last.to_s, last.times) = (span.to_s, last.times + span.times),
                    None => joined.push(span),
                }
            }
            self.spans = joined;
        }
    }
}

/// A kind of spans, as the page has it.
#[derive(Debug, Serialize)]
pub(super) struct Row {
    /// What was so.
    pub(super) name: String,
    /// How the page colours it.
    pub(super) kind: &'static str,
    /// How often it began.
    pub(super) times: u64,
    /// All of it together (s).
    pub(super) total_s: f64,
    /// The spans, in order.
    pub(super) spans: Vec<Span>,
}

/// Spans of many kinds, side by side.
#[derive(Debug, Clone, Default)]
pub(super) struct Rows {
    rows: BTreeMap<(&'static str, String), Spans>,
}

impl Rows {
    /// What is so at a time: every kind that is named, and no other.
    pub(super) fn at(&mut self, time_s: f64, period_s: f64, now: &[(&'static str, String)]) {
        for (key, spans) in &mut self.rows {
            if !now.contains(key) {
                spans.open = false;
            }
        }
        for key in now {
            match self.rows.get_mut(key) {
                Some(spans) => spans.on(time_s, period_s),
                None => self.rows.entry(key.clone()).or_default().on(time_s, period_s),
            }
        }
    }

    pub(super) fn finish(self) -> Vec<Row> {
        let row = |((kind, name), spans): ((&'static str, String), Spans)| Row {
            name,
            kind,
            times: spans.times,
            total_s: spans.total_s,
            spans: spans.spans,
        };
        self.rows.into_iter().map(row).collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn row(rows: &Rows) -> Row {
        rows.clone().finish().remove(0)
    }

    #[test]
    fn a_span_lasts_as_long_as_it_is_so() {
        let mut rows = Rows::default();
        let now = [("limit", "blocked".to_owned())];
        for tick in 0..100 {
            let so = (20..30).contains(&tick) || tick >= 90;
            rows.at(f64::from(tick) * 0.1, 0.1, if so { &now } else { &[] });
        }
        let row = row(&rows);
        assert_eq!((row.times, row.spans.len()), (2, 2));
        assert!((row.spans[0].from_s - 2.0).abs() < 1e-9 && (row.spans[0].to_s - 3.0).abs() < 1e-9);
        assert!((row.spans[1].to_s - 10.0).abs() < 1e-9 && (row.total_s - 2.0).abs() < 1e-9);
    }

    #[test]
    fn what_flickers_is_joined_and_counted() {
        let mut rows = Rows::default();
        let now = [("limit", "rate".to_owned())];
        for tick in 0..100_000 {
            rows.at(f64::from(tick) * 0.01, 0.01, if tick % 2 == 0 { &now } else { &[] });
        }
        let row = row(&rows);
        assert!(row.spans.len() <= MOST, "{}", row.spans.len());
        assert_eq!((row.times, row.spans.iter().map(|s| s.times).sum::<u64>()), (50_000, 50_000));
        assert!((row.total_s - 500.0).abs() < 1e-6);
    }
}
