//! The arm as data: geometry, stiffness, damping, masses, cables.

use super::profile::Profile;
use serde::Serialize;
use std::f64::consts::TAU;
use std::ops::Range;

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
    /// What changes along the segment.
    #[serde(skip_serializing_if = "Taper::is_empty")]
    pub taper: Taper,
    /// Where the holes of its cables lie along the arm.
    #[serde(skip_serializing_if = "Route::is_empty")]
    pub route: Route,
    /// Where each cable ends, as a share of the segment's elements, 0 (excluded) to 1; empty: all at its end.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub cable_ends: Vec<f64>,
    /// Segment (0-based) from whose base its cables act; `None`: by [`ArmConfig::routing`].
    #[serde(skip_serializing_if = "Option::is_none")]
    pub cables_from: Option<usize>,
    /// Axial stiffness EA of its cables (N: force over strain); `None`: they do not stretch.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub cable_stiffness_n: Option<f64>,
    /// Length of its cables between the drums and the arm (m), which stretches as well.
    #[serde(skip_serializing_if = "is_zero")]
    pub cable_feed_m: f64,
}

fn is_zero(x: &f64) -> bool {
    *x == 0.0
}

/// Shares of a segment's own numbers along it, place 0 at its base and 1 at its end. Their mean is 1 (that of one over it of
/// the stiffnesses), such that the segment's numbers are those of the uniform segment nearest to it.
#[derive(Debug, Clone, PartialEq, Default, Serialize)]
pub struct Taper {
    /// Of EI.
    pub bending: Profile,
    /// Of GJ.
    pub torsion: Profile,
    /// Of the backbone's mass per length.
    pub backbone_mass: Profile,
    /// Of the backbone's radius.
    pub backbone_radius: Profile,
    /// Of a disk's mass.
    pub disk_mass: Profile,
    /// Of a disk's radius.
    pub disk_radius: Profile,
}

impl Taper {
    /// True for a segment that is the same all along.
    pub fn is_empty(&self) -> bool {
        let Self { bending, torsion, backbone_mass, backbone_radius, disk_mass, disk_radius } = self;
        [bending, torsion, backbone_mass, backbone_radius, disk_mass, disk_radius].iter().all(|p| p.is_empty())
    }
}

/// Way of a segment's cables along the arm; a place is the segment (0-based) plus the share of its length.
#[derive(Debug, Clone, PartialEq, Default, Serialize)]
pub struct Route {
    /// Share of the segment's hole radius.
    pub radius: Profile,
    /// Turn of all holes about the backbone (rad), from local y towards local z.
    pub turn: Profile,
}

impl Route {
    /// True for cables that are parallel to the backbone.
    pub fn is_empty(&self) -> bool {
        self.radius.is_empty() && self.turn.is_empty()
    }
}

/// Mass and inertia lumped at a node.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Lump {
    /// Mass (kg), without a payload.
    pub mass: f64,
    /// Inertia about the backbone, and about an axis across it (kg m^2).
    pub axial: f64,
    /// See `axial`.
    pub transverse: f64,
}

impl SegmentConfig {
    /// Element length (m).
    pub fn element_length_m(&self) -> f64 {
        self.length_m / self.elements as f64
    }

    /// `[GJ, EI]` of an element (N m^2): a moment bends it as it bends the beam there.
    pub fn element_stiffness_nm2(&self, element: usize) -> [f64; 2] {
        let n = self.elements as f64;
        let (a, b) = (element as f64 / n, (element + 1) as f64 / n);
        [
            self.torsional_stiffness_nm2 / self.taper.torsion.mean_inverse(a, b),
            self.bending_stiffness_nm2 / self.taper.bending.mean_inverse(a, b),
        ]
    }

    /// What is lumped at the end of an element; `last` for the arm's last segment.
    pub fn lump(&self, element: usize, last: bool) -> Lump {
        let n = self.elements as f64;
        let (l, place) = (self.element_length_m(), (element + 1) as f64 / n);
        let ends = element + 1 == self.elements;
        let mut disk = self.disk_mass_kg * self.taper.disk_mass.at(place, 1.0);
        if ends && !last {
            disk += self.connector_mass_kg;
        }
        // The backbone's share: half an element on either side, so the last node has only one half.
        let share = self.taper.backbone_mass.mean((element as f64 + 0.5) / n, ((element as f64 + 1.5) / n).min(1.0));
        let backbone = self.backbone_mass_kgpm * share * l * if ends && last { 0.5 } else { 1.0 };
        let r2 = (self.disk_radius_m * self.taper.disk_radius.at(place, 1.0)).powi(2);
        let b2 = (self.backbone_radius_m * self.taper.backbone_radius.at(place, 1.0)).powi(2);
        let h2 = self.disk_thickness_m.powi(2);
        Lump {
            mass: disk + backbone,
            axial: disk * r2 / 2.0 + backbone * b2 / 2.0,
            transverse: disk * (r2 / 4.0 + h2 / 12.0) + backbone * (b2 / 4.0 + l * l / 12.0),
        }
    }

    /// Elements of the segment that a cable runs through.
    pub fn cable_elements(&self, cable: usize) -> usize {
        let all = self.elements as f64;
        self.cable_ends.get(cable).map_or(self.elements, |end| (end * all).round().max(1.0) as usize)
    }

    /// Hole of a cable at a place of the arm ([`Route`]): its coordinates along local y and z (m).
    pub fn hole_m(&self, cable: usize, place: f64) -> [f64; 2] {
        let radius = self.hole_radius_m * self.route.radius.at(place, 1.0);
        let angle = self.hole_angles_rad[cable];
        let angle = if self.route.turn.is_empty() { angle } else { (angle + self.route.turn.at(place, 0.0)) % TAU };
        [radius * angle.cos(), radius * angle.sin()]
    }
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
    /// Radius of the largest disk (m).
    pub fn disk_radius_m(&self) -> f64 {
        let of = |s: &SegmentConfig| {
            let most = s.taper.disk_radius.0.iter().map(|[_, share]| *share).reduce(f64::max);
            s.disk_radius_m * most.unwrap_or(1.0)
        };
        self.segments.iter().map(of).fold(0.0, f64::max)
    }

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
            segment.cable_feed_m *= s;
            segment.cable_stiffness_n = segment.cable_stiffness_n.map(|ea| ea * s.powi(4));
        }
        arm
    }

    /// Largest tension of a segment's cables (N).
    pub fn segment_tension_n_max(&self, segment: &SegmentConfig) -> f64 {
        segment.tension_n_max.unwrap_or(self.tension_n_max)
    }

    /// Segments whose backbone the cables of a segment run along, its own included.
    pub fn cable_segments(&self, segment: usize) -> Range<usize> {
        let from = match self.routing {
            Routing::Local => segment,
            Routing::Through => 0,
        };
        self.segments[segment].cables_from.unwrap_or(from)..segment + 1
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
