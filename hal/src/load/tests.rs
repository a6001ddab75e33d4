//! The formulas against frames that are really built, bit by bit, with their checksums.

use proptest::prelude::*;

use super::*;

const MBIT: BitRates = BitRates { nominal: 1_000_000, data: 1_000_000 };

/// Bits of the sequence after stuffing; `at_end`: also after the last bit.
fn stuff(bits: &[bool], at_end: bool) -> Vec<bool> {
    let mut out: Vec<bool> = Vec::new();
    let mut run = 0;
    for (i, &bit) in bits.iter().enumerate() {
        run = if out.last() == Some(&bit) { run + 1 } else { 1 };
        out.push(bit);
        if run == 5 && (at_end || i + 1 < bits.len()) {
            out.push(!bit);
            run = 1;
        }
    }
    out
}

fn push(bits: &mut Vec<bool>, value: u64, n: u32) {
    bits.extend((0..n).rev().map(|i| value >> i & 1 == 1));
}

fn crc15_step(crc: u16, bit: bool) -> u16 {
    let top = crc >> 14 & 1 == 1;
    let crc = crc << 1 & 0x7fff;
    if top != bit { crc ^ 0x4599 } else { crc }
}

/// Header of a classic frame up to its length code.
fn classic_header(extended: bool, id: u32, remote: bool, code: u64) -> Vec<bool> {
    let mut bits = vec![false];
    if extended {
        push(&mut bits, u64::from(id >> 18), 11);
        push(&mut bits, 0b11, 2);
        push(&mut bits, u64::from(id), 18);
        push(&mut bits, u64::from(remote) << 2, 3);
    } else {
        push(&mut bits, u64::from(id), 11);
        push(&mut bits, u64::from(remote) << 2, 3);
    }
    push(&mut bits, code, 4);
    bits
}

/// Length on the wire of a classic frame, counted.
fn classic_actual(extended: bool, id: u32, remote: bool, data: &[u8]) -> u32 {
    let mut bits = classic_header(extended, id, remote, data.len() as u64);
    if !remote {
        data.iter().for_each(|&b| push(&mut bits, u64::from(b), 8));
    }
    let crc = bits.iter().fold(0, |crc, &bit| crc15_step(crc, bit));
    push(&mut bits, u64::from(crc), 15);
    // CRC delimiter, acknowledge, its delimiter, end of frame, intermission.
    stuff(&bits, true).len() as u32 + 1 + 1 + 1 + 7 + 3
}

/// Stuff bits of the worst classic frame there is, its checksum being what it must be: a walk over all states of
/// checksum and stuffing rule.
fn classic_exact(extended: bool, len: u64) -> u32 {
    // [crc][last bit][run - 1] -> most stuff bits so far, or -1.
    let at = |crc: u16, last: bool, run: usize| (usize::from(crc) * 2 + usize::from(last)) * 5 + run - 1;
    let step = |last: bool, run: usize, bit: bool| -> (bool, usize, i32) {
        let run = if bit == last { run + 1 } else { 1 };
        // A run of five takes its stuff bit at once: classic stuffing includes the last bit.
        if run == 5 { (!bit, 1, 1) } else { (bit, run, 0) }
    };
    let mut free = vec![true; classic_header(extended, 0, false, len).len()];
    let template = classic_header(extended, 0, false, len);
    for (i, f) in free.iter_mut().enumerate() {
        *f = (1..=11).contains(&i) || (extended && (14..32).contains(&i));
    }
    let payload = 8 * len as usize;
    let mut best = vec![-1_i32; 0x8000 * 10];
    let mut next = best.clone();
    // The start of frame: a single dominant bit.
    best[at(crc15_step(0, false), false, 1)] = 0;
    for i in 1..template.len() + payload {
        next.fill(-1);
        for crc in 0..0x8000_u16 {
            for last in [false, true] {
                for run in 1..=4 {
                    let so_far = best[at(crc, last, run)];
                    if so_far < 0 {
                        continue;
                    }
                    for bit in [false, true] {
                        if i < template.len() && !free[i] && template[i] != bit {
                            continue;
                        }
                        let (l, r, s) = step(last, run, bit);
                        let slot = &mut next[at(crc15_step(crc, bit), l, r)];
                        *slot = (*slot).max(so_far + s);
                    }
                }
            }
        }
        std::mem::swap(&mut best, &mut next);
    }
    let mut most = 0;
    for crc in 0..0x8000_u16 {
        for last in [false, true] {
            for run in 1..=4 {
                let mut total = best[at(crc, last, run)];
                if total < 0 {
                    continue;
                }
                let (mut l, mut r) = (last, run);
                for i in (0..15).rev() {
                    let (l2, r2, s) = step(l, r, crc >> i & 1 == 1);
                    (l, r, total) = (l2, r2, total + s);
                }
                most = most.max(total);
            }
        }
    }
    let stuffed = template.len() as u32 + payload as u32 + 15;
    stuffed + most as u32 + 13
}

/// Length of an FD frame counted: (nominal, data) as if the switch were on.
fn fd_actual(extended: bool, id: u32, esi: bool, data: &[u8]) -> Bits {
    let mut bits = vec![false];
    if extended {
        push(&mut bits, u64::from(id >> 18), 11);
        push(&mut bits, 0b11, 2);
        push(&mut bits, u64::from(id), 18);
        push(&mut bits, 0, 1);
    } else {
        push(&mut bits, u64::from(id), 11);
        push(&mut bits, 0, 2);
    }
    push(&mut bits, 0b101, 3);
    let nominal = bits.len();
    push(&mut bits, u64::from(esi), 1);
    let code = match data.len() {
        n @ 0..=8 => n,
        n => 9 + FD_LENGTHS.iter().position(|&l| l == n).unwrap(),
    };
    push(&mut bits, code as u64, 4);
    data.iter().for_each(|&b| push(&mut bits, u64::from(b), 8));
    // No stuff bit falls between the phases: before the switch (recessive) comes a dominant bit, so its run is one.
    let arbitration = stuff(&bits[..nominal], true).len();
    let all = stuff(&bits, false).len();
    let (checksum, fixed) = if data.len() <= 16 { (4 + 17, 6) } else { (4 + 21, 7) };
    Bits { nominal: arbitration as u32 + 13, data: (all - arbitration) as u32 + checksum + fixed }
}

#[test]
fn classic_lengths_are_the_published_ones() {
    // Davis et al. 2007: 55 + 10 n and 80 + 10 n.
    for n in 0..=8 {
        assert_eq!(Shape::classic(n).bits(MBIT).nominal, 55 + 10 * n as u32);
        let extended = Shape { extended: true, ..Shape::classic(n) };
        assert_eq!(extended.bits(MBIT).nominal, 80 + 10 * n as u32);
    }
    let remote = Shape { extended: false, kind: Kind::Remote, len: 8 };
    assert_eq!(remote.bits(MBIT), Shape::classic(0).bits(MBIT));
}

#[test]
fn the_worst_real_classic_frame_is_just_below_the_bound() {
    let worst = [(false, 0), (false, 1), (false, 4), (false, 8), (true, 0), (true, 8)].map(|(extended, n)| {
        let bound = Shape { extended, ..Shape::classic(n as usize) }.bits(MBIT).nominal;
        (extended, n, bound - classic_exact(extended, n))
    });
    assert_eq!(worst, WORST);
}

/// (extended, bytes, bits by which the longest frame that exists stays below the bound).
const WORST: [(bool, u64, u32); 6] =
    [(false, 0, 2), (false, 1, 3), (false, 4, 2), (false, 8, 2), (true, 0, 2), (true, 8, 2)];

#[test]
fn the_walk_over_all_frames_finds_what_sending_them_all_finds() {
    let longest = |n: usize, payloads: u32| {
        (0..0x800_u32)
            .flat_map(|id| (0..payloads).map(move |p| classic_actual(false, id, false, &p.to_le_bytes()[..n])))
            .max()
            .unwrap()
    };
    assert_eq!(classic_exact(false, 0), longest(0, 1));
    assert_eq!(classic_exact(false, 1), longest(1, 256));
}

#[test]
fn twenty_four_drives_take_what_the_design_says() {
    // Per drive and cycle: RPDO1 (controlword, torque: 4 bytes) and TPDO1 (statusword, position, torque: 8 bytes);
    // per bus and cycle one SYNC without payload.
    let bus = |drives: f64| {
        Load::new(MBIT)
            .with(Shape::classic(4), Rate::PerCycle(drives))
            .with(Shape::classic(8), Rate::PerCycle(drives))
            .with(Shape::classic(0), Rate::PerCycle(1.0))
    };
    assert!((bus(24.0).cycle_s() - 5.575e-3).abs() < 1e-12);
    assert!((bus(6.0).cycle_s() - 1.435e-3).abs() < 1e-12);
    assert_eq!(bus(24.0).ceiling_hz(1.0).round(), 179.0);
    assert_eq!(bus(6.0).ceiling_hz(1.0).round(), 697.0);
    // Heartbeats of the drives and of the master at 1 Hz change neither.
    let beating = |drives: f64| bus(drives).with(Shape::classic(1), Rate::PerSecond(drives + 1.0));
    assert_eq!(beating(24.0).ceiling_hz(1.0).round(), 179.0);
    assert_eq!(beating(6.0).ceiling_hz(1.0).round(), 697.0);
    assert!((beating(24.0).share(100.0) - (0.5575 + 25.0 * 65e-6)).abs() < 1e-12);
}

#[test]
fn four_fd_buses_with_packed_commands_carry_more_than_a_kilohertz() {
    // One frame with six controlwords and torques (24 bytes), six answers of 8 bytes, SYNC; 1 and 5 Mbit/s.
    let rates = BitRates { nominal: 1_000_000, data: 5_000_000 };
    let load = Load::new(rates)
        .with(Shape::fd(24), Rate::PerCycle(1.0))
        .with(Shape::fd(8), Rate::PerCycle(6.0))
        .with(Shape::classic(0), Rate::PerCycle(1.0));
    assert!(load.ceiling_hz(1.0) > 1600.0, "{}", load.ceiling_hz(1.0));
}

#[test]
fn a_background_above_the_limit_leaves_no_cycle() {
    let load =
        Load::new(MBIT).with(Shape::classic(8), Rate::PerSecond(1e6)).with(Shape::classic(0), Rate::PerCycle(1.0));
    assert_eq!(load.ceiling_hz(0.7), 0.0);
}

#[test]
fn the_worst_fd_frame_exists() {
    // The content that follows the stuffing rule greedily from the start of frame; for these lengths it attains the
    // bound, so the bound is no larger than a frame that can be sent.
    let rates = BitRates { nominal: 1_000_000, data: 5_000_000 };
    for len in [0, 1, 2, 8, 12, 64] {
        let bound = Shape::fd(len).bits(rates);
        let worst = (0..0x800_u32)
            .flat_map(|id| [false, true].map(|esi| (id, esi)))
            .flat_map(|(id, esi)| (0..32_u32).map(move |phase| (id, esi, phase)))
            .map(|(id, esi, phase)| {
                let data: Vec<u8> = greedy(phase, len);
                fd_actual(false, id, esi, &data)
            })
            .max_by(|a, b| a.time_s(rates).total_cmp(&b.time_s(rates)))
            .unwrap();
        assert_eq!(worst, bound, "{len} bytes");
    }
}

/// Payload with a change every four bits, beginning in one of all phases.
fn greedy(phase: u32, len: usize) -> Vec<u8> {
    let bit = |i: u32| {
        let first = phase & 7;
        let start = phase & 8 != 0;
        if i < first { start } else { ((i - first) / 4 % 2 == 1) == start }
    };
    let mut data: Vec<u8> =
        (0..len as u32).map(|b| (0..8).fold(0, |byte, i| byte << 1 | u8::from(bit(8 * b + i)))).collect();
    if phase & 16 != 0 {
        data.iter_mut().for_each(|b| *b = !*b);
    }
    data
}

/// Bytes that stuffing dislikes as often as random ones.
fn bytes(len: impl Into<prop::collection::SizeRange>) -> impl Strategy<Value = Vec<u8>> {
    let byte =
        prop_oneof![any::<u8>(), Just(0), Just(0xff), Just(0x0f), Just(0xf0), Just(0x1e), Just(0x78), Just(0x87)];
    prop::collection::vec(byte, len)
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(2000))]

    #[test]
    fn no_classic_frame_is_longer_than_the_bound(
        extended: bool, remote: bool, id in prop_oneof![any::<u32>(), Just(0), Just(0x0f0f_0f0f)], data in bytes(0..=8_usize),
    ) {
        let id = id & if extended { 0x1fff_ffff } else { 0x7ff };
        let kind = if remote { Kind::Remote } else { Kind::Classic };
        let bound = Shape { extended, kind, len: data.len() }.bits(MBIT).nominal;
        prop_assert!(classic_actual(extended, id, remote, &data) <= bound);
    }

    #[test]
    fn no_fd_frame_takes_longer_than_the_bound(
        extended: bool, esi: bool, id: u32, code in 0..16_usize, data in bytes(64), data_rate in 1_u32..=8,
    ) {
        let len = if code <= 8 { code } else { FD_LENGTHS[code - 9] };
        let rates = BitRates { nominal: 1_000_000, data: data_rate * 1_000_000 };
        let id = id & if extended { 0x1fff_ffff } else { 0x7ff };
        let actual = fd_actual(extended, id, esi, &data[..len]);
        let bound = Shape { extended, ..Shape::fd(len) }.bits(rates);
        prop_assert!(actual.time_s(rates) <= bound.time_s(rates) + 1e-15);
        let single = Shape { extended, kind: Kind::Fd { bit_rate_switch: false }, len }.bits(rates);
        // Without the switch only one bit of the header differs, which moves the stuffing by one at most.
        prop_assert!(actual.nominal + actual.data <= single.nominal + 1);
        prop_assert_eq!(single.data, 0);
    }
}
