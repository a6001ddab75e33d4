//! `sinew`: command line.
fn main() {}
