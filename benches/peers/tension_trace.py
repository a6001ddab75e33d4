"""The tension trace of the plants, the same formula as in `plant.rs`, and its samples in time."""

import numpy as np

DURATION_S = 5.0
SAMPLE_S = 0.1


def angles(arm):
    return np.array([np.arctan2(c["hole"][2], c["hole"][1]) for c in arm["cables"]])


def segments(arm):
    return np.array([c["segment"] for c in arm["cables"]])


def tensions(arm, t):
    """Tensions (N) at the times `t`: times x cables."""
    t = np.atleast_1d(np.asarray(t, dtype=float))[:, None]
    pace = 2.0 * np.pi * (0.25 + 0.15 * segments(arm)[None, :])
    x = np.minimum(t, 1.0)
    return x * x * (3.0 - 2.0 * x) * (25.0 + 22.0 * np.sin(pace * t + angles(arm)[None, :]))
