//! The arm as data: geometry, stiffness, damping, masses, cables.

use serde::Serialize;

/// How the chord constraint of an element follows its tangents (design: Simpson's rule is the default).
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum ChordRule {
    /// `r_{i+1} - rs_i - (l/6)(t_i + 4 t_m + t_{i+1})`, mid tangent from the normalised `p_i + p_{i+1}`.
    Simpson,
    /// `r_{i+1} - rs_i - (l/2)(t_i + t_{i+1})`.
    Trapezoid,
}

/// How an element's curvature follows from the relative quaternion of its two nodes.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum StrainRule {
    /// `2 vec(p_i* p_{i+1}) / l`.
    VectorPart,
    /// Rotation vector `log(p_i* p_{i+1}) / l`.
    Logarithm,
}

/// Where a segment's cables begin to act.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum Routing {
    /// From the segment's own base disk; before it they run in sheaths.
    Local,
    /// Through holes in every disk from the robot's base on.
    Through,
}

/// One segment: a chain of `elements` beam elements, a disk at the end of each.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct SegmentConfig {
    /// Backbone length (m), without the connector.
    pub length_m: f64,
    /// Number of elements, and of disks.
    pub elements: usize,
    /// Bending stiffness EI (N m^2).
    pub bending_stiffness_nm2: f64,
    /// Torsional stiffness GJ (N m^2).
    pub torsional_stiffness_nm2: f64,
    /// Stiffness-proportional damping beta (s).
    pub damping_stiffness_s: f64,
    /// Mass of one disk (kg).
    pub disk_mass_kg: f64,
    /// Radius of a disk (m): its inertia, and the body's default radius.
    pub disk_radius_m: f64,
    /// Thickness of a disk (m).
    pub disk_thickness_m: f64,
    /// Backbone mass per length (kg/m).
    pub backbone_mass_kgpm: f64,
    /// Backbone radius (m).
    pub backbone_radius_m: f64,
    /// Rigid connector behind this segment's end disk (m); 0 at the last segment.
    pub connector_length_m: f64,
    /// Mass added at the end disk by the connector (kg).
    pub connector_mass_kg: f64,
    /// Radius of the circle of holes (m).
    pub hole_radius_m: f64,
    /// Angle of each cable's hole from local y towards local z (rad); its length is the number of cables.
    pub hole_angles_rad: Vec<f64>,
    /// Largest tension of the segment's cables (N), at most the arm's; `None` for the arm's.
    pub tension_n_max: Option<f64>,
}

/// Load at the tip.
#[derive(Debug, Clone, Copy, PartialEq, Default, Serialize)]
pub struct PayloadConfig {
    /// Point mass at the last node (kg).
    pub mass_kg: f64,
}

/// A whole arm: checked, SI units, base frame.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct ArmConfig {
    /// Name, also of its shared-memory services.
    pub name: String,
    /// Position of the clamped base node in the base frame (m).
    pub base_position_m: [f64; 3],
    /// Unit quaternion `[w x y z]`, base node's body frame to the base frame.
    pub base_quaternion: [f64; 4],
    /// Gravity (m/s^2), base frame.
    pub gravity_mps2: [f64; 3],
    /// Mass-proportional damping (1/s).
    pub damping_mass_1ps: f64,
    /// Chord constraint.
    pub chord: ChordRule,
    /// Curvature measure.
    pub strain: StrainRule,
    /// Cable routing.
    pub routing: Routing,
    /// Spectral radius of the generalised-alpha integrator, 0..=1.
    pub rho_inf: f64,
    /// Least tension of every cable (N).
    pub tension_n_min: f64,
    /// Largest tension of every cable (N).
    pub tension_n_max: f64,
    /// Largest change of a tension per second (N/s).
    pub tension_rate_npsmax: f64,
    /// Segments from base to tip, 1 to 16.
    pub segments: Vec<SegmentConfig>,
    /// Load at the tip.
    pub payload: PayloadConfig,
}

impl ArmConfig {
    /// Number of nodes N (the clamped base not counted).
    pub fn node_count(&self) -> usize {
        self.segments.iter().map(|s| s.elements).sum()
    }

    /// Length from the base to the tip (m): segments, and connectors between them.
    pub fn length_m(&self) -> f64 {
        let last = self.segments.len().saturating_sub(1);
        let segment = |(i, s): (usize, &SegmentConfig)| s.length_m + if i < last { s.connector_length_m } else { 0.0 };
        self.segments.iter().enumerate().map(segment).sum()
    }

    /// The similar arm of `s` times the length, with the same pace: times, rates and accelerations over the length are this
    /// arm's, tensions `s^4` times as large.
    pub fn scaled(&self, s: f64) -> Self {
        let mut arm = self.clone();
        arm.base_position_m.iter_mut().chain(&mut arm.gravity_mps2).for_each(|x| *x *= s);
        for n in [&mut arm.tension_n_min, &mut arm.tension_n_max, &mut arm.tension_rate_npsmax] {
            *n *= s.powi(4);
        }
        arm.payload.mass_kg *= s.powi(3);
        for segment in &mut arm.segments {
            for m in [
                &mut segment.length_m,
                &mut segment.disk_radius_m,
                &mut segment.disk_thickness_m,
                &mut segment.backbone_radius_m,
                &mut segment.connector_length_m,
                &mut segment.hole_radius_m,
            ] {
                *m *= s;
            }
            segment.backbone_mass_kgpm *= s.powi(2);
            segment.disk_mass_kg *= s.powi(3);
            segment.connector_mass_kg *= s.powi(3);
            segment.bending_stiffness_nm2 *= s.powi(6);
            segment.torsional_stiffness_nm2 *= s.powi(6);
            segment.tension_n_max = segment.tension_n_max.map(|n| n * s.powi(4));
        }
        arm
    }

    /// Largest tension of a segment's cables (N).
    pub fn segment_tension_n_max(&self, segment: &SegmentConfig) -> f64 {
        segment.tension_n_max.unwrap_or(self.tension_n_max)
    }

    /// Largest tension of each cable (N), segment by segment.
    pub fn tension_maxima_n(&self) -> Vec<f64> {
        let segment = |s: &SegmentConfig| std::iter::repeat_n(self.segment_tension_n_max(s), s.hole_angles_rad.len());
        self.segments.iter().flat_map(segment).collect()
    }

    /// What its cables are called.
    pub fn cable_names(&self) -> super::CableNames {
        super::CableNames::new(self.segments.iter().map(|segment| segment.hole_angles_rad.len()))
    }

    /// Number of cables.
    pub fn cable_count(&self) -> usize {
        self.segments.iter().map(|s| s.hole_angles_rad.len()).sum()
    }
}
