//! From the configuration to what the wires need: buses, master, motor bank, and the load that the traffic will be.

use super::error::DaemonError;
use crate::config::{BusConfig, BusKind, BusLayout, Config, DriveConfig, Protection, SafeHold};
use crate::control::STAY_LOOKAHEADS;
use crate::model::Arm;
use sinew_hal::bus_config::{self, BusSpec};
use sinew_hal::can::CanBus;
use sinew_hal::canopen::NodeId;
use sinew_hal::cia402::objects::TORQUE_SLOPE;
use sinew_hal::cia402::{DriveSetup, Identity, Layout, MasterConfig, ObjectWrite, Order};
use sinew_hal::load::BitRates;
use sinew_hal::motor_bank::{ChannelError, MotorBank, MotorChannel, Sense};

/// Traffic of one bus as the configuration makes it.
#[derive(Debug, Clone, PartialEq)]
pub struct BusLoad {
    /// Name of the bus.
    pub name: String,
    /// Share of the bus, with worst-case stuffing.
    pub share: f64,
    /// Share that is permitted.
    pub limit: f64,
    /// Shortest period at which the limit holds (s); infinite if not even that helps.
    pub period_s_min: f64,
}

/// Refuses what the configuration's own checks cannot know, before anything is opened; the load of every bus.
///
/// # Errors
/// A bus above its load limit, a drive that cannot pull its cable, settings that the drives' protocol does not have.
pub fn check(config: &Config) -> Result<Vec<BusLoad>, DaemonError> {
    motor_bank(config)?;
    let master = master_config(config)?;
    master.check(config.drives.buses.len())?;
    let loads = bus_loads(config);
    match loads.iter().find(|load| load.share > load.limit) {
        Some(load) => Err(DaemonError::BusLoad { load: load.clone(), period_s: config.timing.period_s }),
        None => Ok(loads),
    }
}

/// The cyclic traffic and the heartbeats of every bus, as its layout makes them.
pub fn bus_loads(config: &Config) -> Vec<BusLoad> {
    let drives = &config.drives;
    drives
        .buses
        .iter()
        .enumerate()
        .map(|(index, bus)| {
            let rates = BitRates { nominal: bus.bitrate_bps, data: bus.data_bitrate_bps };
            let load = layout(bus.layout).load(rates, drives_on(config, index), drives.heartbeat_s);
            BusLoad {
                name: bus.name.clone(),
                share: load.share(1.0 / config.timing.period_s),
                limit: bus.load_limit,
                period_s_min: 1.0 / load.ceiling_hz(bus.load_limit),
            }
        })
        .collect()
}

fn layout(layout: BusLayout) -> Layout {
    match layout {
        BusLayout::Classic => Layout::Classic,
        BusLayout::Packed => Layout::Packed,
    }
}

/// The motor bank.
///
/// # Errors
/// A drive that cannot give the arm's largest tension.
pub fn motor_bank(config: &Config) -> Result<MotorBank, DaemonError> {
    Ok(motor_channels(config)?)
}

/// The drives' channels. Encoders count from the straight arm: at 0 counts every cable has its length there.
///
/// # Errors
/// A drive that cannot give the arm's largest tension.
pub fn motor_channels(config: &Config) -> Result<MotorBank, ChannelError> {
    let arm = Arm::new(&config.arm);
    let mut lengths = vec![0.0; arm.cable_count()];
    arm.cable_lengths_into(&arm.straight(), &mut lengths);
    let channel = |((drive, length), tension_n_max): ((&DriveConfig, f64), f64)| {
        let channel = MotorChannel {
            drum_radius_m: drive.drum_radius_m,
            gear_ratio: drive.gear_ratio,
            sense: if drive.sign < 0 { Sense::Reverse } else { Sense::Forward },
            rated_torque_nm: drive.rated_torque_nm,
            counts_per_turn: f64::from(drive.counts_per_turn),
            // The lower end of the box is the planner's business; cables are slack while the drives come up.
            tension_n_min: 0.0,
            tension_n_max,
            home_counts: 0,
            home_length_m: length,
            // From all of it pulled in to as much again paid out.
            travel_m: length,
        };
        (channel, torque_permille_max(drive))
    };
    MotorBank::new(config.drives.drives.iter().zip(lengths).zip(config.arm.tension_maxima_n()).map(channel).collect())
}

/// What the drive is said to permit (per mille of its rated torque).
fn torque_permille_max(drive: &DriveConfig) -> u16 {
    (1000.0 * drive.torque_nm_max / drive.rated_torque_nm).round().clamp(0.0, 65535.0) as u16
}

/// What the drive is told to permit: no more than the arm's largest tension needs, whatever a frame on the bus says.
fn torque_permille_limit(drive: &DriveConfig, tension_n_max: f64) -> u16 {
    let permille = (1000.0 * drive.torque_nm(tension_n_max) / drive.rated_torque_nm * (1.0 + 1e-12)).floor();
    torque_permille_max(drive).min(permille.clamp(0.0, 65535.0) as u16)
}

/// The master's settings.
///
/// # Errors
/// A node id out of range, or none left for the master.
pub fn master_config(config: &Config) -> Result<MasterConfig, DaemonError> {
    let drives = &config.drives;
    let sync_timeout_us = microseconds(drives.sync_timeout_s);
    let may_lack = |protection| drives.accept_without.contains(&protection);
    let mut setups = Vec::with_capacity(drives.drives.len());
    for (drive, tension_n_max) in drives.drives.iter().zip(config.arm.tension_maxima_n()) {
        let node = NodeId::new(drive.node_id).map_err(|_| DaemonError::NodeId { found: drive.node_id })?;
        let permille_per_n = 1000.0 * drive.torque_nm(1.0) / drive.rated_torque_nm;
        let safe = f64::from(drive.sign) * (drives.safe_tension_n * permille_per_n).round();
        let safe = safe.clamp(f64::from(i16::MIN), f64::from(i16::MAX)) as i16;
        // From the largest torque to zero in the time given.
        let limit = torque_permille_limit(drive, tension_n_max);
        let slope = f64::from(limit) / drives.safe_ramp_s.max(1e-3);
        let mut setup = DriveSetup::new(drive.bus, node);
        setup.rated_torque_mnm = Some((1000.0 * drive.rated_torque_nm).round() as u32);
        setup.torque_permille_max = limit;
        setup.identity = Identity { vendor: drive.vendor_id, product: drive.product_code, ..Identity::default() };
        let slope = ObjectWrite {
            index: TORQUE_SLOPE,
            sub: 0,
            data: (slope.round() as u32).to_le_bytes().to_vec(),
            optional: may_lack(Protection::TorqueSlope),
        };
        // Objects of a vendor mean something else on another's drive.
        let keeps = drive.safe_hold == SafeHold::Hold;
        let guard = drive.is_simulated().then(|| ObjectWrite::sinew_guard(sync_timeout_us, safe, keeps));
        setup.abort_connection = drive.safe_hold.abort_connection(drive.is_simulated());
        if drive.is_simulated() && drive.safe_hold.stays() {
            let slowly = (f64::from(limit) / config.timing.release_s).round().max(1.0) as u32;
            setup.release = ObjectWrite::sinew_release(0, slowly).to_vec();
        }
        setup.safe_torque_follows = drive.safe_hold == SafeHold::Rest;
        setup.writes = guard.into_iter().flatten().chain([slope]).collect();
        setups.push(setup);
    }
    let free = |id: &u8| drives.drives.iter().all(|drive| drive.node_id != *id);
    let own = drives.master_node_id.or_else(|| (1..=127).rev().find(free));
    let own = own.and_then(|id| NodeId::new(id).ok()).ok_or(DaemonError::NoNodeLeft)?;
    let mut master = MasterConfig::new(setups, own, microseconds(config.timing.period_s));
    // From the largest torque to none, and a little more.
    master.release_ms = (1e3 * config.timing.release_s).round() as u32 + 100;
    master.mean_time_us = microseconds(STAY_LOOKAHEADS * config.planner.lookahead_s);
    master.layouts = drives.buses.iter().map(|bus| layout(bus.layout)).collect();
    // Torques come with every SYNC, and may be missing as long as it. Rounded up: the event timer counts milliseconds.
    master.read_back_us = microseconds(config.drives.read_back_s);
    master.rpdo_timeout_ms = sync_timeout_us.div_ceil(1000).min(u32::from(u16::MAX)) as u16;
    master.rpdo_timeout_optional = may_lack(Protection::RpdoTimeout);
    master.heartbeat_ms = milliseconds(drives.heartbeat_s);
    master.heartbeat_timeout_ms = milliseconds(drives.heartbeat_timeout_s);
    master.drive_heartbeat_ms = milliseconds(drives.heartbeat_s);
    master.drive_heartbeat_timeout_ms = milliseconds(drives.heartbeat_timeout_s);
    master.sdo_timeout_ms = milliseconds(drives.sdo_timeout_s).into();
    master.boot_timeout_ms = (1e3 * drives.boot_timeout_s).round() as u32;
    // From the tip to the base, so that no distal cable pulls on a segment that has gone slack.
    master.order_of_disabling = Order::OneByOneReversed;
    Ok(master)
}

fn microseconds(seconds: f64) -> u32 {
    (1e6 * seconds).round() as u32
}

fn milliseconds(seconds: f64) -> u16 {
    (1e3 * seconds).round().clamp(1.0, 65535.0) as u16
}

/// Opens every bus.
///
/// # Errors
/// The first that does not open, with its reason; an interface whose transmit queue is shorter than a cycle does not.
pub fn open_buses(config: &Config) -> Result<Vec<Box<dyn CanBus>>, DaemonError> {
    let open = |(index, bus): (usize, &BusConfig)| {
        bus_config::open(&bus_spec(config, index)).map_err(|source| DaemonError::Bus { name: bus.name.clone(), source })
    };
    config.drives.buses.iter().enumerate().map(open).collect()
}

fn bus_spec(config: &Config, index: usize) -> BusSpec {
    let bus = &config.drives.buses[index];
    let kind = match bus.kind {
        BusKind::Virtual => bus_config::BusKind::Virtual,
        BusKind::Socketcan => bus_config::BusKind::Socketcan,
    };
    let mut spec = BusSpec::new(kind, bus.interface.clone());
    spec.fd = bus.fd;
    // A cycle of a full bus, or what the master has to say to so many drives at once. What is left of a cycle when the
    // next one begins is dropped by whoever sends them.
    spec.queue_length = 256;
    spec.burst = layout(bus.layout).burst(drives_on(config, index));
    spec
}

fn drives_on(config: &Config, bus: usize) -> usize {
    config.drives.drives.iter().filter(|drive| drive.bus == bus).count()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::config::builtin_texts;

    fn config(change: impl Fn(&mut Config)) -> Config {
        config_with("drives.toml", change)
    }

    fn config_with(drives: &str, change: impl Fn(&mut Config)) -> Config {
        let mut config = Config::parse(builtin_texts(drives)).unwrap();
        change(&mut config);
        config
    }

    #[test]
    fn the_shipped_configuration_loads_its_bus_as_the_design_computed() {
        let loads = check(&config(|_| {})).unwrap();
        // 24 axes on one classic bus of 1 Mbit/s take 5.6 ms per cycle, and heartbeats a little more.
        assert!((0.53..0.62).contains(&loads[0].share), "{loads:?}");
        assert!((1.0 / loads[0].period_s_min) < 179.0 * 0.7, "{loads:?}");
    }

    #[test]
    fn a_period_that_the_bus_cannot_carry_is_refused_with_the_one_that_it_can() {
        let error = check(&config(|c| c.timing.period_s = 0.005)).unwrap_err();
        let text = error.to_string();
        for part in ["bus0", "70 %", "period_s"] {
            assert!(text.contains(part), "{part} is not in {text}");
        }
    }

    #[test]
    fn four_fd_buses_carry_a_kilohertz_where_classic_ones_are_refused() {
        let kilohertz = |c: &mut Config| c.timing.period_s = 0.001;
        for drives in ["drives.toml", "drives-4-buses.toml"] {
            let error = check(&config_with(drives, kilohertz)).unwrap_err();
            assert!(matches!(error, DaemonError::BusLoad { .. }), "{error}");
        }
        let loads = check(&config_with("drives-4-fd-buses.toml", kilohertz)).unwrap();
        assert_eq!(loads.len(), 4);
        for load in &loads {
            assert!((0.40..0.55).contains(&load.share), "{load:?}");
            // Above 1.6 kHz before the wire itself is full, as the design computed.
            assert!(load.period_s_min * load.limit < 1.0 / 1600.0, "{load:?}");
        }
        // At 2 Mbit/s in the data phase the same traffic does not fit any more.
        let slow = |c: &mut Config| {
            kilohertz(c);
            c.drives.buses.iter_mut().for_each(|bus| bus.data_bitrate_bps = 2_000_000);
        };
        assert!(matches!(check(&config_with("drives-4-fd-buses.toml", slow)), Err(DaemonError::BusLoad { .. })));
    }

    #[test]
    fn every_bus_is_opened_for_the_frames_of_its_cycle() {
        for (drives, bursts) in
            [("drives.toml", vec![25]), ("drives-4-buses.toml", vec![7; 4]), ("drives-4-fd-buses.toml", vec![2; 4])]
        {
            let config = config_with(drives, |_| {});
            let found: Vec<usize> = (0..config.drives.buses.len()).map(|bus| bus_spec(&config, bus).burst).collect();
            assert_eq!(found, bursts, "{drives}");
        }
    }

    #[test]
    fn the_configurations_limit_of_packed_drives_is_the_frames() {
        assert_eq!(crate::config::PACKED_DRIVES_MAX, Layout::Packed.drives_max());
    }

    #[test]
    fn a_tension_comes_out_as_the_torque_that_drum_and_gear_need() {
        let bank = motor_bank(&config(|_| {})).unwrap();
        let mut torques = [0; 24];
        bank.encode_into(&[100.0; 24], &mut torques).unwrap();
        // 100 N on 15 mm behind a gear of 10: 0.15 N m of 0.35.
        assert_eq!(torques, [429; 24]);
    }

    #[test]
    fn an_encoder_that_would_run_over_within_its_cables_length_is_refused() {
        let error = check(&config(|c| {
            c.drives.drives[7].counts_per_turn = 100_000_000;
            c.drives.drives[7].gear_ratio = 2000.0;
        }))
        .unwrap_err();
        let text = error.to_string();
        for part in ["[drives]", "cable 7", "counts_per_turn = 100000000", "must be 1 to ", "travel 0.65"] {
            assert!(text.contains(part), "{part} is not in {text}");
        }
    }

    #[test]
    fn a_drive_is_told_to_permit_no_more_than_the_arms_largest_tension() {
        // Its own limit is 1000 per mille: 233 N.
        for (most_n, permille) in [(220.0, 942), (105.0, 450), (233.3, 999)] {
            let config = config(|c| c.arm.tension_n_max = most_n);
            let limit = master_config(&config).unwrap().drives[0].torque_permille_max;
            assert_eq!(limit, permille, "{most_n} N");
            assert!(motor_bank(&config).unwrap().channels()[0].decode_tension(limit as i16) <= most_n);
        }
    }

    #[test]
    fn objects_of_a_vendor_are_written_to_its_own_drives_alone_and_after_they_have_shown_who_they_are() {
        let writes = |change: fn(&mut Config)| master_config(&config(change)).unwrap().drives[3].clone();
        let simulated = writes(|_| {});
        assert_eq!((simulated.identity.vendor, simulated.identity.product), (Some(0), Some(0x5349_4e57)));
        assert!(simulated.writes.iter().any(|w| w.index == 0x2000));
        for foreign in [
            writes(|c| c.drives.drives[3].vendor_id = None),
            writes(|c| c.drives.drives[3].vendor_id = Some(0x9a)),
            writes(|c| c.drives.drives[3].product_code = Some(1)),
        ] {
            assert!(foreign.writes.iter().all(|w| !(0x2000..0x6000).contains(&w.index)), "{foreign:?}");
        }
    }

    #[test]
    fn what_a_drive_may_lack_is_said_by_the_configuration() {
        let strict = master_config(&config(|_| {})).unwrap();
        assert!(!strict.rpdo_timeout_optional && strict.drives[0].writes.iter().all(|w| !w.optional));
        let accepts = master_config(&config(|c| c.drives.accept_without = Protection::ALL.to_vec())).unwrap();
        assert!(accepts.rpdo_timeout_optional);
        assert!(accepts.drives[0].writes.iter().any(|w| w.index == TORQUE_SLOPE && w.optional));
    }

    #[test]
    fn the_master_has_a_node_id_that_no_drive_has() {
        let config = config(|c| c.drives.drives[23].node_id = 127);
        let master = master_config(&config).unwrap();
        assert_eq!(master.node.get(), 126);
        assert!(master.check(1).is_ok());
        let config = self::config(|c| c.drives.master_node_id = Some(100));
        assert_eq!(master_config(&config).unwrap().node.get(), 100);
    }
}
