//! A measured tip.

use super::Header;
use iceoryx2::prelude::ZeroCopySend;

/// Position of the tip as a sensor outside of the arm sees it (camera, tracker), at the header's time.
#[derive(Debug, Clone, Copy, PartialEq, Default, ZeroCopySend)]
#[repr(C)]
#[type_name("sinew.Tip.v1")]
pub struct Tip {
    /// Header.
    pub header: Header,
    /// Position (m), base frame.
    pub position_m: [f64; 3],
}
