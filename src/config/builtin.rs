//! The files of `config/` inside the binary, so that an installed program works without a checkout.

use super::arm::ArmConfig;

/// `config/arm.toml`.
pub(super) const ARM_TOML: &str = include_str!("../../config/arm.toml");

impl ArmConfig {
    /// The arm of the paper's examples (design section 12): `config/arm.toml`, built in.
    ///
    /// # Panics
    /// Never in a program that passed its tests: the file is part of the binary.
    #[expect(clippy::expect_used, reason = "the text is a constant of the program, read by a test")]
    pub fn paper() -> Self {
        Self::parse("config/arm.toml (built in)", ARM_TOML).expect("the built-in arm is valid")
    }
}
