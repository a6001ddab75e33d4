//! Numbers on the wire and their meanings. A number once given is never reused.

/// Declares a `u32` code with its wire number, its conversion and a short text.
macro_rules! wire_enum {
    ($(#[$meta:meta])* $name:ident { $($(#[$vmeta:meta])* $variant:ident = $value:literal, $text:literal;)* }) => {
        $(#[$meta])*
        #[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, PartialOrd, Ord)]
        #[repr(u32)]
        pub enum $name { $($(#[$vmeta])* $variant = $value,)* }

        impl $name {
            /// Every value, in the order of the wire numbers.
            pub const ALL: &'static [$name] = &[$($name::$variant,)*];

            /// The value of a wire number; `None` if it has no meaning in this version.
            pub const fn from_wire(value: u32) -> Option<Self> {
                match value { $($value => Some(Self::$variant),)* _ => None }
            }

            /// The wire number.
            pub const fn wire(self) -> u32 {
                self as u32
            }

            /// A short text for people.
            pub const fn text(self) -> &'static str {
                match self { $(Self::$variant => $text,)* }
            }
        }
    };
}

wire_enum! {
    /// Shape of an obstacle in its own frame.
    ObstacleKind {
        /// `dimensions_m = [radius, 0, 0]`.
        Ball = 1, "ball";
        /// Along the local z axis, `dimensions_m = [half length between the centres, radius, 0]`.
        Capsule = 2, "capsule";
        /// `dimensions_m` = half extents along the local axes.
        Box = 3, "box";
        /// Solid below the plane through the local origin whose outward normal is the local z axis.
        HalfSpace = 4, "half-space";
        /// Convex hull of the vertices `hull_offset..hull_offset + hull_count` of the set, in the local frame.
        Hull = 5, "hull";
    }
}

wire_enum! {
    /// What a target asks for.
    TargetMode {
        /// Tip pose and twist.
        Tip = 1, "tip";
        /// Average curvature of each segment about its local y and z.
        Shape = 2, "shape";
    }
}

wire_enum! {
    /// Who measured the cables.
    EncoderSource {
        /// The drives, over the bus.
        Drives = 1, "drives";
        /// A sensor on another wire.
        External = 2, "external";
        /// A recording that is played back.
        Replay = 3, "replay";
    }
}

wire_enum! {
    /// State of the supervisor.
    SupervisorState {
        /// Drives without torque.
        Disarmed = 0, "disarmed";
        /// Drives enabled, the observer settles, the pose is held.
        Arming = 1, "arming";
        /// The pose is held.
        Holding = 2, "holding";
        /// The target is followed.
        Tracking = 3, "tracking";
        /// On the way to the home pose.
        Homing = 4, "homing";
        /// On the way to rest, then disarmed.
        Stopping = 5, "stopping";
        /// Latched; `fault_code` and `fault_detail` hold the cause, `clear` releases it.
        Faulted = 6, "faulted";
    }
}

wire_enum! {
    /// How the planner ended in a tick.
    PlannerStatus {
        /// It did not run.
        Idle = 0, "idle";
        /// Converged.
        Converged = 1, "converged";
        /// Time or work budget spent; the best answer so far, inside its bounds.
        BudgetSpent = 2, "budget spent";
        /// Distance constraints conflicted and were relaxed.
        Relaxed = 3, "relaxed";
        /// No usable answer; the last tensions were kept.
        Failed = 4, "failed";
    }
}

wire_enum! {
    /// Which branch of the planner gave the answer.
    PlannerBranch {
        /// None.
        None = 0, "none";
        /// Safe subspace: complementarity of the tension box alone.
        Safe = 1, "safe";
        /// Warning subspace, by the swarm.
        Swarm = 2, "swarm";
        /// Warning subspace, by the swarm seeded with the complementarity solution.
        Seeded = 3, "seeded";
        /// Warning subspace, by complementarity with distance rows.
        Complementarity = 4, "complementarity";
        /// Warning subspace, by the standard swarm.
        StandardSwarm = 5, "standard swarm";
    }
}

wire_enum! {
    /// How fresh a source of inputs is.
    SourceHealth {
        /// This place is not used, or nothing was ever accepted.
        Absent = 0, "absent";
        /// Newer than `stale_after`.
        Fresh = 1, "fresh";
        /// Older than `stale_after`: obstacles grow with age.
        Stale = 2, "stale";
        /// Older than `hold_after`: the arm is asked to hold.
        Expired = 3, "expired";
        /// A target that stands still and is held: its age does not matter.
        Held = 4, "held";
        /// It sends, or sent, and nothing of it was ever accepted: the arm is asked to hold.
        Refused = 5, "refused";
    }
}

wire_enum! {
    /// Why an input was not taken over; the place of its counter in `SourceReport::rejected`.
    RejectCause {
        /// The payload's schema version is another.
        Schema = 0, "another schema version";
        /// NaN or infinite.
        NotFinite = 1, "NaN or infinite number";
        /// Captured later than now plus the tolerance.
        Future = 2, "capture time lies in the future";
        /// Captured before the last accepted one of this source.
        Backwards = 3, "capture time older than the last of this source";
        /// The sequence number did not increase.
        Sequence = 4, "repeated or old sequence number";
        /// An obstacle kind or target mode without meaning.
        UnknownKind = 5, "unknown kind";
        /// More entries announced than a set can hold.
        Overfull = 6, "more entries than the capacity";
        /// A dimension is zero, negative or absurd.
        Dimensions = 7, "dimension out of range";
        /// A quaternion is not of unit length.
        Quaternion = 8, "quaternion not of unit length";
        /// A covariance is not positive semidefinite.
        Covariance = 9, "covariance not positive semidefinite";
        /// Hull vertices outside the pool, fewer than four, or flat.
        Hull = 10, "hull without volume or outside the vertex pool";
        /// Two obstacles of one set have the same id.
        DuplicateId = 11, "two obstacles with one id";
        /// Another number of cables or segments than the arm has.
        WrongCount = 12, "wrong number of cables or segments";
        /// No place is left for another source, or another process has the source's id.
        TooManySources = 13, "too many sources, or another process has this id";
        /// The capture time is older than `hold_after` already.
        TooOld = 14, "too old on arrival";
        /// A weight is negative or absurd.
        Weight = 15, "weight out of range";
    }
}

wire_enum! {
    /// What is wrong beside faults and limits, whose alarms have their own codes.
    AlarmCode {
        /// A source of obstacles is silent.
        SourceStale = 500, "the source is silent";
        /// A source of obstacles is too old.
        SourceExpired = 501, "the source is too old";
        /// Sets of a source of obstacles are refused.
        SourceRefused = 502, "sets are refused";
        /// A source of obstacles that must be there is not.
        SourceAbsent = 503, "the source is absent";
        /// The target that is followed is too old.
        TargetExpired = 504, "the target is too old";
        /// A drive is in fault while the arm is disarmed.
        DriveFault = 505, "a drive cannot be used";
        /// Drives lack a protection, which the configuration accepts.
        DrivesLack = 506, "drives lack a protection";
        /// A real-time right was not granted.
        RealTime = 507, "a real-time right was not granted";
        /// The recording ended early.
        Recording = 508, "the recording ended early";
    }
}

wire_enum! {
    /// What an operator asks for.
    RequestKind {
        /// Enable the drives and hold the pose.
        Arm = 1, "arm";
        /// Take the torque off the drives, in order.
        Disarm = 2, "disarm";
        /// Hold the present pose.
        Hold = 3, "hold";
        /// Follow the target.
        Track = 4, "track";
        /// Release a latched fault whose cause is gone.
        Clear = 5, "clear";
        /// Come to rest, then disarm.
        Stop = 6, "stop";
        /// Go to the home pose.
        Home = 7, "home";
        /// Take over `Request::target` as if it came by the `target` service.
        SetTarget = 8, "set target";
        /// Only report the state.
        Status = 9, "status";
        /// Press the operator's emergency stop: the arm stops, and may not be armed until it is released.
        EmergencyStop = 10, "emergency-stop";
        /// Release it; the fault that it raised stays until it is cleared.
        EmergencyRelease = 11, "emergency-release";
        /// Scale the speed of the reference by `Request::speed_scale`, until another request or the arm is disarmed.
        Speed = 12, "speed";
    }
}

wire_enum! {
    /// Whether a request was accepted.
    Verdict {
        /// It is carried out.
        Accepted = 0, "accepted";
        /// It is not; the reason says why.
        Refused = 1, "refused";
    }
}

wire_enum! {
    /// Why a request was refused.
    RefusalReason {
        /// It was accepted.
        None = 0, "accepted";
        /// The request's kind has no meaning in this version.
        UnknownRequest = 1, "unknown request";
        /// The request's schema version is another.
        Schema = 2, "the request's schema version is not the daemon's";
        /// Not possible in the present supervisor state.
        WrongState = 3, "not possible in the present state";
        /// A fault is latched; clear it first.
        Faulted = 4, "a fault is latched: clear it first";
        /// The fault's cause persists.
        CausePersists = 5, "the cause of the fault persists";
        /// The drives are not ready.
        DrivesNotReady = 6, "the drives are not ready";
        /// The observer has not settled.
        NotSettled = 7, "the observer has not settled";
        /// There is no target, or it is stale.
        NoTarget = 8, "no fresh target";
        /// The target was refused; `detail` is the `RejectCause`.
        BadTarget = 9, "the target was refused";
        /// Too many requests wait.
        Busy = 10, "too many requests wait for an answer";
        /// The control thread did not answer in time.
        NoAnswer = 11, "the control thread did not answer";
        /// There is no obstacle source, or one is expired.
        ObstaclesExpired = 12, "a declared obstacle source is absent or expired";
        /// The daemon is shutting down.
        ShuttingDown = 13, "the daemon is shutting down";
        /// `Request::speed_scale` is not between 0.01 and 1.
        BadSpeed = 14, "the speed is not between 1 % and 100 %";
    }
}
