//! `sim_plant`: the arm and its drives in place of the hardware.
fn main() {}
