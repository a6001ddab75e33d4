//! The distance penalty (27) of the warning subspace.

/// The length r of the penalty for a shape that is not a ball (m), the radius of the paper's obstacles.
pub const LENGTH_OTHER_M: f64 = 0.1;

/// Penalty (27) and its derivative with respect to the distance (1/m).
///
/// `Phi = [1 - s^6]^3` for `s = (d + r)/(d_s + r) < 1`, else 0, with the surface distance `d`, the clearance `d_s` and
/// the length `r` (design section 4): for a ball, body radius 0 and clearance 0, s is the distance to the centroid over
/// the radius, the paper's argument. Below `s = 0`, which the paper cannot reach, (27) would fall again because the
/// sixth power is even; there `Phi = 1 + s^2` goes on rising, with a continuous derivative. NaN in, NaN out.
pub fn penalty(distance_m: f64, clearance_m: f64, length_m: f64) -> (f64, f64) {
    let scale = 1.0 / (clearance_m + length_m);
    let s = (distance_m + length_m) * scale;
    if s >= 1.0 {
        (0.0, 0.0)
    } else if s < 0.0 {
        (1.0 + s * s, 2.0 * s * scale)
    } else {
        let s5 = s.powi(5);
        let base = 1.0 - s5 * s;
        (base * base * base, -18.0 * s5 * base * base * scale)
    }
}
