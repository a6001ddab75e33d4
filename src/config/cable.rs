//! What a cable is called: its segment and its number in it, both from 1, the base's first. Tables, `[[drives.override]]`,
//! logs, `sinew status` and `--fault` all have this name; arrays count cables over the whole arm from 0.

use std::fmt;
use std::str::FromStr;

/// Name of a cable, `2,1`.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct CableName {
    /// Segment, from 1.
    pub segment: usize,
    /// Cable of the segment, from 1.
    pub number: usize,
}

impl fmt::Display for CableName {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{},{}", self.segment, self.number)
    }
}

impl FromStr for CableName {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let name = text.split_once(',').and_then(|(segment, number)| {
            let from_1 = |text: &str| text.trim().parse().ok().filter(|n| *n >= 1);
            Some(Self { segment: from_1(segment)?, number: from_1(number)? })
        });
        name.ok_or_else(|| format!("`{text}`: expected SEGMENT,CABLE, both from 1, e.g. 2,1"))
    }
}

/// The names of an arm's cables.
#[derive(Debug, Clone, PartialEq, Eq, Default)]
pub struct CableNames(Vec<usize>);

impl CableNames {
    /// Of an arm with so many cables a segment, base to tip.
    pub fn new(cables_per_segment: impl IntoIterator<Item = usize>) -> Self {
        Self(cables_per_segment.into_iter().collect())
    }

    /// Number of cables.
    pub fn count(&self) -> usize {
        self.0.iter().sum()
    }

    /// The name of a place in arrays; `None` beyond the last cable.
    pub fn of(&self, index: usize) -> Option<CableName> {
        let mut first = 0;
        for (segment, count) in self.0.iter().enumerate() {
            if index < first + count {
                return Some(CableName { segment: segment + 1, number: index - first + 1 });
            }
            first += count;
        }
        None
    }

    /// The place of a name in arrays; `None` where the arm has no such cable.
    pub fn find(&self, name: CableName) -> Option<usize> {
        let count = *self.0.get(name.segment.checked_sub(1)?)?;
        let first: usize = self.0[..name.segment - 1].iter().sum();
        (1..=count).contains(&name.number).then(|| first + name.number - 1)
    }

    /// "cable 2,1"; where the names do not tell, its place in arrays.
    pub fn words(&self, index: usize) -> String {
        self.of(index).map_or_else(|| format!("the cable at place {index}"), |name| format!("cable {name}"))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_cable_has_a_name_that_leads_back_to_it() {
        let names = CableNames::new([3, 6, 2]);
        let all: Vec<String> = (0..11).map(|index| names.of(index).unwrap().to_string()).collect();
        assert_eq!((all[0].as_str(), all[3].as_str(), all[10].as_str()), ("1,1", "2,1", "3,2"));
        for (index, text) in all.iter().enumerate() {
            assert_eq!(names.find(text.parse().unwrap()), Some(index), "{text}");
        }
        assert_eq!((names.of(11), names.words(4)), (None, "cable 2,2".to_owned()));
        for absent in ["1,4", "4,1"] {
            assert_eq!(names.find(absent.parse().unwrap()), None, "{absent}");
        }
        for bad in ["", "7", "0,1", "1,0", "1,", "a,1", "1,1,1", "-1,1"] {
            assert!(bad.parse::<CableName>().unwrap_err().contains("SEGMENT,CABLE"), "{bad}");
        }
    }
}
