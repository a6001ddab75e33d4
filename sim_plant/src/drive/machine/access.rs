//! What an SDO may read and write: the dictionary with the drive's meaning behind it.

use super::super::objects::{CONSUMERS, HISTORY};
use super::super::pdo;
use sinew_hal::canopen::sdo_server::ObjectAccess;
use sinew_hal::canopen::{AbortCode, ObjectDictionary};
use sinew_hal::cia402::objects as o;

/// The dictionary with the drive's meaning behind it, as the SDO server needs it.
pub(super) struct Objects<'a> {
    pub(super) dictionary: &'a mut ObjectDictionary,
    /// The object that a write has changed.
    pub(super) written: Option<(u16, u8)>,
}

impl ObjectAccess for Objects<'_> {
    fn read(&mut self, index: u16, sub: u8) -> Result<Vec<u8>, AbortCode> {
        if index == o::ERROR_FIELD && i64::from(sub) > self.dictionary.int(index, 0) && sub <= HISTORY {
            return Err(AbortCode::NO_DATA);
        }
        self.dictionary.read(index, sub)
    }

    fn write(&mut self, index: u16, sub: u8, data: &[u8]) -> Result<(), AbortCode> {
        if self.dictionary.description(index, sub).is_some_and(|d| d.data_type.size().is_some()) {
            let value = self.dictionary.check_int(index, sub, data)?;
            pdo::check(self.dictionary, index, sub, value)?;
            match index {
                o::MODE if value != 0 && value != i64::from(o::MODE_CST) => return Err(AbortCode::VALUE_RANGE),
                o::QUICK_STOP_OPTION if !matches!(value, 0 | 2 | 6) => return Err(AbortCode::VALUE_RANGE),
                o::PDO_FORMAT => pdo::check_format(self.dictionary, value)?,
                o::HEARTBEAT_CONSUMER => self.check_consumer(sub, value)?,
                _ => {}
            }
        }
        self.dictionary.write(index, sub, data)?;
        self.written = Some((index, sub));
        Ok(())
    }

    fn check_write(&mut self, index: u16, sub: u8) -> Result<(), AbortCode> {
        self.dictionary.check_write(index, sub)
    }

    fn length(&self, index: u16, sub: u8) -> Option<usize> {
        self.dictionary.description(index, sub)?.data_type.size()
    }
}

impl Objects<'_> {
    fn check_consumer(&self, sub: u8, value: i64) -> Result<(), AbortCode> {
        let (node, time) = (value >> 16 & 0xff, value & 0xffff);
        if value >> 24 != 0 || node > 127 {
            return Err(AbortCode::PARAMETER);
        }
        let twice = (1..=CONSUMERS).filter(|&s| s != sub).any(|s| {
            let other = self.dictionary.int(o::HEARTBEAT_CONSUMER, s);
            other & 0xffff != 0 && other >> 16 & 0xff == node
        });
        if time != 0 && node != 0 && twice { Err(AbortCode::PARAMETER) } else { Ok(()) }
    }
}
