//! Payloads: emergency objects, NMT commands, heartbeats, PDO mappings and what they split, TPDOs.
#![no_main]

use sinew_hal::can::{Frame, Id};
use sinew_hal::canopen::{Emergency, Mapped, Mapping, Message, NmtCommand, NmtState};
use sinew_hal::cia402::objects::decode_tpdo1;
use sinew_hal::cia402::state::State;

libfuzzer_sys::fuzz_target!(|bytes: &[u8]| {
    let [i0, i1, entries, data @ ..] = bytes else { return };
    if let Ok(frame) = Frame::classic(Id::Standard(u16::from_le_bytes([*i0, *i1])), &data[..data.len().min(8)]) {
        let _ = Message::of(&frame);
    }
    if let Some(e) = Emergency::decode(data) {
        assert!(!e.words().is_empty());
    }
    if let Some((command, node)) = NmtCommand::decode(data) {
        assert_eq!(command.encode(node).data(), data);
    }
    let _ = NmtState::decode(data);
    if let Some((word, ..)) = decode_tpdo1(data) {
        let _ = State::from_statusword(word);
    }
    // The first words are a mapping, the rest is a payload for it.
    let (head, payload) = data.split_at((4 * usize::from(entries % 9)).min(data.len()));
    let mapped: Vec<Mapped> =
        head.chunks_exact(4).map(|w| Mapped::decode(u32::from_le_bytes([w[0], w[1], w[2], w[3]]))).collect();
    if let Ok(mapping) = Mapping::new(&mapped, 64)
        && let Some(parts) = mapping.split(payload)
    {
        let total: usize = parts.map(|(_, bytes)| bytes.len()).sum();
        assert_eq!(total, mapping.len());
    }
});
