//! The EDS file (CiA 306) of the simulated drive, made from its dictionary; `sim_plant/eds/sinew_drive.eds` is this text,
//! and a test compares the two entry by entry as a reader of the file would.

use super::objects::{MAPPED_MAX, Nameplate, PDOS, PRODUCT, REVISION, dictionary};
use sinew_hal::canopen::dictionary::{Description, Kind, ObjectDictionary, Value};
use std::fmt::Write;

/// Objects that CiA 301 makes mandatory.
const MANDATORY: [u16; 3] = [0x1000, 0x1001, 0x1018];

/// Text of the EDS file.
pub fn eds() -> String {
    // Node id 0: what depends on the node id stands there as a formula.
    let d = dictionary(0, Nameplate::default());
    let mut t = String::new();
    header(&mut t);
    let indices: Vec<u16> = d.objects().map(|(i, _)| i).collect();
    let optional: Vec<_> =
        indices.iter().copied().filter(|i| !MANDATORY.contains(i) && !(0x2000..0x6000).contains(i)).collect();
    let own: Vec<_> = indices.iter().copied().filter(|i| (0x2000..0x6000).contains(i)).collect();
    for (name, list) in
        [("MandatoryObjects", MANDATORY.to_vec()), ("OptionalObjects", optional), ("ManufacturerObjects", own)]
    {
        let _ = writeln!(t, "[{name}]\nSupportedObjects={}", list.len());
        for (n, index) in list.iter().enumerate() {
            let _ = writeln!(t, "{}=0x{index:04X}", n + 1);
        }
        t.push('\n');
        for index in list {
            object(&mut t, &d, index);
        }
    }
    t
}

fn header(t: &mut String) {
    let _ = write!(
        t,
        "[FileInfo]\nFileName=sinew_drive.eds\nFileVersion=1\nFileRevision=1\nEDSVersion=4.0\n\
         Description=Simulated cable drive of sinew, CiA 402 cyclic synchronous torque\nCreationTime=12:00PM\n\
         CreationDate=01-01-2026\nCreatedBy=sinew\nModificationTime=12:00PM\nModificationDate=01-01-2026\n\
         ModifiedBy=sinew\n\n\
         [DeviceInfo]\nVendorName=sinew\nVendorNumber=0\nProductName=sinew simulated cable drive\n\
         ProductNumber=0x{PRODUCT:08X}\nRevisionNumber=0x{REVISION:08X}\nOrderCode=none\nBaudRate_10=0\nBaudRate_20=0\n\
         BaudRate_50=0\nBaudRate_125=1\nBaudRate_250=1\nBaudRate_500=1\nBaudRate_800=1\nBaudRate_1000=1\n\
         SimpleBootUpMaster=0\nSimpleBootUpSlave=1\nGranularity=8\nDynamicChannelsSupported=0\nGroupMessaging=0\n\
         NrOfRXPDO={PDOS}\nNrOfTXPDO={PDOS}\nLSS_Supported=0\n\n\
         [DummyUsage]\nDummy0001=0\nDummy0002=1\nDummy0003=1\nDummy0004=1\nDummy0005=1\nDummy0006=1\nDummy0007=1\n\n\
         [Comments]\nLines=2\nLine1=Safe torque 2000:02 is applied after a loss of heartbeat, SYNC or RPDO, also in the state fault.\n\
         Line2=Each PDO maps up to {MAPPED_MAX} objects of whole bytes.\n\n"
    );
}

fn object(t: &mut String, d: &ObjectDictionary, index: u16) {
    let subs: Vec<&Description> = d.descriptions().filter(|e| e.index == index).collect();
    let Some((_, head)) = d.objects().find(|(i, _)| *i == index) else { return };
    if head.kind == Kind::Variable {
        let _ = writeln!(t, "[{index:04X}]");
        subs.iter().for_each(|e| value(t, e));
        return;
    }
    let kind = if head.kind == Kind::Array { 8 } else { 9 };
    let _ =
        writeln!(t, "[{index:04X}]\nParameterName={}\nObjectType=0x{kind:X}\nSubNumber={}\n", head.name, subs.len());
    for e in subs {
        let _ = writeln!(t, "[{index:04X}sub{:X}]", e.sub);
        value(t, e);
    }
}

fn value(t: &mut String, e: &Description) {
    let default = match &e.default {
        Value::Int(v) => v.to_string(),
        Value::NodeIdPlus(n) => format!("$NODEID+0x{n:X}"),
        Value::Text(s) => s.clone(),
    };
    let _ = write!(
        t,
        "ParameterName={}\nObjectType=0x7\nDataType=0x{:04X}\nAccessType={}\nDefaultValue={default}\nPDOMapping={}\n",
        e.name,
        e.data_type.code(),
        e.access.word(),
        u8::from(e.mappable),
    );
    if let Some((low, high)) = e.limits {
        let _ = write!(t, "LowLimit={low}\nHighLimit={high}\n");
    }
    t.push('\n');
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::collections::BTreeMap;

    type Sections = BTreeMap<String, BTreeMap<String, String>>;

    fn parse(text: &str) -> Sections {
        let mut sections = Sections::new();
        let mut current = String::new();
        for line in text.lines().map(str::trim).filter(|l| !l.is_empty() && !l.starts_with(';')) {
            if let Some(name) = line.strip_prefix('[').and_then(|l| l.strip_suffix(']')) {
                current = name.to_ascii_lowercase();
                assert!(sections.insert(current.clone(), BTreeMap::new()).is_none(), "section {name} twice");
            } else {
                let (key, value) = line.split_once('=').expect("key=value");
                sections.get_mut(&current).unwrap().insert(key.to_ascii_lowercase(), value.to_owned());
            }
        }
        sections
    }

    fn number(text: &str, node: i64) -> i64 {
        let (text, base) = text.strip_prefix("$NODEID+").map_or((text, 0), |t| (t, node));
        base + text.strip_prefix("0x").map_or_else(|| text.parse().unwrap(), |h| i64::from_str_radix(h, 16).unwrap())
    }

    const PATH: &str = concat!(env!("CARGO_MANIFEST_DIR"), "/eds/sinew_drive.eds");

    #[test]
    fn the_file_in_the_repository_is_what_the_code_says() {
        if std::env::var_os("SINEW_WRITE_FILES").is_some() {
            std::fs::write(PATH, eds()).unwrap();
        }
        assert_eq!(std::fs::read_to_string(PATH).unwrap(), eds(), "regenerate with SINEW_WRITE_FILES=1");
    }

    #[test]
    fn every_entry_of_the_file_is_in_the_dictionary_and_the_other_way_round() {
        const NODE: u8 = 42;
        let file = parse(&std::fs::read_to_string(PATH).unwrap());
        let live = dictionary(NODE, Nameplate::default());
        let mut seen = 0;
        for (name, section) in &file {
            let (index, sub) = match name.split_once("sub") {
                Some((i, s)) => (u16::from_str_radix(i, 16), u8::from_str_radix(s, 16).unwrap()),
                None => (u16::from_str_radix(name, 16), 0),
            };
            let Ok(index) = index else { continue };
            if name.len() < 4 || section["objecttype"] != "0x7" {
                continue;
            }
            seen += 1;
            let d = live.description(index, sub).unwrap_or_else(|| panic!("{name} is not in the dictionary"));
            assert_eq!(section["parametername"], d.name);
            assert_eq!(number(&section["datatype"], 0), i64::from(d.data_type.code()), "{name}");
            assert_eq!(section["accesstype"], d.access.word(), "{name}");
            assert_eq!(section["pdomapping"] == "1", d.mappable, "{name}");
            let value = live.read(index, sub).unwrap();
            match d.data_type.size() {
                Some(_) => {
                    assert_eq!(
                        d.data_type.decode(&value),
                        Some(number(&section["defaultvalue"], NODE.into())),
                        "{name}"
                    );
                }
                None => assert_eq!(value, section["defaultvalue"].as_bytes(), "{name}"),
            }
        }
        assert_eq!(seen, live.descriptions().count());
        let listed: i64 = ["mandatoryobjects", "optionalobjects", "manufacturerobjects"]
            .iter()
            .map(|s| number(&file[*s]["supportedobjects"], 0))
            .sum();
        assert_eq!(usize::try_from(listed).unwrap(), live.objects().count());
    }
}
