//! The numbers that a loop carries from one tick to the next, for who linearises it.

/// What such a number is.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Kept {
    /// Coordinates q of an arm (7N; m, 1).
    Coordinates,
    /// Their rates (m/s, 1/s).
    Rates,
    /// Their accelerations (m/s^2, 1/s^2).
    Accelerations,
    /// Tensions (N), one per cable.
    Tensions,
    /// Bending moments (N m), two per segment.
    Moments,
    /// Bend angles (rad), two per segment.
    Angles,
    /// Mean curvatures (1/m), two per segment.
    Curvatures,
    /// Numbers without a unit.
    Shares,
}
