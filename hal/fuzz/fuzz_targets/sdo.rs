//! SDO: arbitrary responses to a client with a transfer under way, arbitrary requests to a server.
#![no_main]

use sinew_hal::canopen::AbortCode;
use sinew_hal::canopen::sdo_client::{Outcome, SdoClient};
use sinew_hal::canopen::sdo_server::{ObjectAccess, SdoServer};

/// One object that takes and gives everything, and others that are not there.
#[derive(Default)]
struct Objects(Vec<u8>);

impl ObjectAccess for Objects {
    fn read(&mut self, index: u16, _: u8) -> Result<Vec<u8>, AbortCode> {
        if index & 1 == 0 { Ok(self.0.clone()) } else { Err(AbortCode::NO_OBJECT) }
    }
    fn write(&mut self, index: u16, _: u8, data: &[u8]) -> Result<(), AbortCode> {
        if index & 1 == 1 {
            return Err(AbortCode::NO_OBJECT);
        }
        self.0 = data.to_vec();
        Ok(())
    }
    fn check_write(&mut self, index: u16, _: u8) -> Result<(), AbortCode> {
        if index & 1 == 0 { Ok(()) } else { Err(AbortCode::NO_OBJECT) }
    }
    fn length(&self, _: u16, sub: u8) -> Option<usize> {
        (sub > 0).then_some(usize::from(sub))
    }
}

libfuzzer_sys::fuzz_target!(|bytes: &[u8]| {
    let (mut server, mut objects) = (SdoServer::new(), Objects::default());
    let mut client = SdoClient::new(1_000_000);
    // Frames of up to nine bytes, each behind its length and a wish for a new transfer.
    let mut rest = bytes;
    let mut now_ns = 0;
    while let [head, tail @ ..] = rest {
        let (frame, next) = tail.split_at(usize::from(head & 0x0f).min(9).min(tail.len()));
        match head >> 4 {
            0 => drop(client.upload(0x1018, 1, now_ns)),
            1 => drop(client.download(0x2001, 0, frame, now_ns)),
            2 => now_ns += 700_000,
            _ => {}
        }
        let _ = server.on_request(frame, &mut objects);
        let (outcome, _) = client.on_response(frame, now_ns);
        assert!(outcome == Outcome::Pending || !client.is_busy());
        let _ = client.poll(now_ns);
        rest = next;
    }
});
