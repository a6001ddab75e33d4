"""The arm in PyElastica: one Cosserat rod, cables as a forcing of their own, viscous bending as a damper of its own.

Elements of the rod carry directors, its inner nodes carry the bending: so element e is the arm's node e with its disk
in the middle of it, and the rod's nodes lie in the middle of the arm's elements. Element 0 is the clamp. A connector
belongs to the element of its disk, which is therefore longer; the bending stiffness between two elements is that of the
flexible length between their disks. Shear and stretch have the stiffness of the backbone itself (radius, E = EI/I),
times `stretch`: softer ones permit longer steps and are wrong by more.

PyElastica has no viscosity proportional to the curvature rate (its dampers act on velocities). The explicit form would
limit the step far below what the shear waves do, so it is done implicitly at the end of each step: a block-tridiagonal
solve for the angular velocities, compiled by numba like everything else.
"""

import logging
import time as clock

import elastica
import numpy as np
from elastica.dissipation import DamperBase
from elastica.external_forces import NoForces
from numba import njit

import tension_trace as trace

logging.getLogger("elastica").setLevel(logging.ERROR)


@njit(cache=True, fastmath=False)
def _pull(position, directors, forces, torques, start, element, share, hole, tension):
    """Adds the forces of all cables: `start[c]..start[c+1]` are the holes of cable c in order."""
    for c in range(start.size - 1):
        pull = tension[c]
        have = False
        px = py = pz = 0.0
        pe = 0
        pw = 0.0
        for k in range(start[c], start[c + 1]):
            e, w = element[k], share[k]
            q = directors[:, :, e]
            h0, h1 = hole[c, 0], hole[c, 1]
            x = (1.0 - w) * position[0, e] + w * position[0, e + 1] + q[0, 0] * h0 + q[1, 0] * h1
            y = (1.0 - w) * position[1, e] + w * position[1, e + 1] + q[0, 1] * h0 + q[1, 1] * h1
            z = (1.0 - w) * position[2, e] + w * position[2, e + 1] + q[0, 2] * h0 + q[1, 2] * h1
            if have:
                dx, dy, dz = x - px, y - py, z - pz
                f = pull / np.sqrt(dx * dx + dy * dy + dz * dz)
                fx, fy, fz = f * dx, f * dy, f * dz
                _at(directors, forces, torques, pe, pw, h0, h1, fx, fy, fz)
                _at(directors, forces, torques, e, w, h0, h1, -fx, -fy, -fz)
            px, py, pz, pe, pw, have = x, y, z, e, w, True


@njit(cache=True)
def _at(directors, forces, torques, e, w, h0, h1, fx, fy, fz):
    forces[0, e] += (1.0 - w) * fx
    forces[1, e] += (1.0 - w) * fy
    forces[2, e] += (1.0 - w) * fz
    forces[0, e + 1] += w * fx
    forces[1, e + 1] += w * fy
    forces[2, e + 1] += w * fz
    a = directors[0, 0, e] * fx + directors[0, 1, e] * fy + directors[0, 2, e] * fz
    b = directors[1, 0, e] * fx + directors[1, 1, e] * fy + directors[1, 2, e] * fz
    d = directors[2, 0, e] * fx + directors[2, 1, e] * fy + directors[2, 2, e] * fz
    # (h0, h1, 0) x (a, b, d)
    torques[0, e] += h1 * d
    torques[1, e] -= h0 * d
    torques[2, e] += h0 * b - h1 * a


@njit(cache=True)
def _tension(time, pace, angle, out):
    x = min(time, 1.0)
    ease = x * x * (3.0 - 2.0 * x)
    for c in range(out.size):
        out[c] = ease * (25.0 + 22.0 * np.sin(pace[c] * time + angle[c]))


class Cables(NoForces):
    """External forces at the holes."""

    def __init__(self, start, element, share, hole, pace, angle):
        super().__init__()
        self.route = (start, element, share, hole)
        self.pace, self.angle = pace, angle
        self.tension = np.zeros(angle.size)

    def apply_forces(self, system, time=0.0):
        _tension(time, self.pace, self.angle, self.tension)
        _pull(
            system.position_collection,
            system.director_collection,
            system.external_forces,
            system.external_torques,
            *self.route,
            self.tension,
        )

    def apply_torques(self, system, time=0.0):
        pass


@njit(cache=True)
def _dampen(directors, omega, inertia, viscosity, dt, diagonal, upper, right):
    """Implicit Euler on `J w' = -dW/dw`, `W = sum (w_e+1 - w_e)^T R^T C R (w_e+1 - w_e) / 2` in the base frame."""
    n = omega.shape[1]
    for e in range(1, n):
        q = directors[:, :, e]
        for i in range(3):
            s = 0.0
            for k in range(3):
                s += q[k, i] * inertia[k, e] * omega[k, e]
            right[e, i] = s
            for j in range(3):
                v = 0.0
                for k in range(3):
                    v += q[k, i] * inertia[k, e] * q[k, j]
                diagonal[e, i, j] = v
    for e in range(n - 1):
        # Mean of the two frames: an angle's square off, in the damping alone.
        for i in range(3):
            for j in range(3):
                v = 0.0
                for k in range(3):
                    mi = 0.5 * (directors[k, i, e] + directors[k, i, e + 1])
                    mj = 0.5 * (directors[k, j, e] + directors[k, j, e + 1])
                    v += mi * viscosity[k, e] * mj
                v *= dt
                diagonal[e + 1, i, j] += v
                if e > 0:
                    diagonal[e, i, j] += v
                upper[e, i, j] = -v
    # Element 0 is the clamp: it stays. Block elimination from 1 on.
    for e in range(1, n):
        d = diagonal[e]
        inv = _inverse(d)
        if e + 1 < n:
            for i in range(3):
                for j in range(3):
                    f = 0.0
                    for k in range(3):
                        f += upper[e, k, i] * inv[k, j]
                    # f = (upper^T inv)_ij
                    right[e + 1, i] -= f * right[e, j]
                    for k in range(3):
                        diagonal[e + 1, i, k] -= f * upper[e, j, k]
        for i in range(3):
            for j in range(3):
                diagonal[e, i, j] = inv[i, j]
    for e in range(n - 1, 0, -1):
        a = right[e, 0], right[e, 1], right[e, 2]
        if e + 1 < n:
            a = (
                a[0] - upper[e, 0, 0] * right[e + 1, 0] - upper[e, 0, 1] * right[e + 1, 1] - upper[e, 0, 2] * right[e + 1, 2],
                a[1] - upper[e, 1, 0] * right[e + 1, 0] - upper[e, 1, 1] * right[e + 1, 1] - upper[e, 1, 2] * right[e + 1, 2],
                a[2] - upper[e, 2, 0] * right[e + 1, 0] - upper[e, 2, 1] * right[e + 1, 1] - upper[e, 2, 2] * right[e + 1, 2],
            )
        for i in range(3):
            right[e, i] = diagonal[e, i, 0] * a[0] + diagonal[e, i, 1] * a[1] + diagonal[e, i, 2] * a[2]
        for k in range(3):
            omega[k, e] = directors[k, 0, e] * right[e, 0] + directors[k, 1, e] * right[e, 1] + directors[k, 2, e] * right[e, 2]


@njit(cache=True)
def _inverse(m):
    out = np.empty((3, 3))
    c00 = m[1, 1] * m[2, 2] - m[1, 2] * m[2, 1]
    c01 = m[1, 2] * m[2, 0] - m[1, 0] * m[2, 2]
    c02 = m[1, 0] * m[2, 1] - m[1, 1] * m[2, 0]
    f = 1.0 / (m[0, 0] * c00 + m[0, 1] * c01 + m[0, 2] * c02)
    out[0, 0] = f * c00
    out[1, 0] = f * c01
    out[2, 0] = f * c02
    out[0, 1] = f * (m[0, 2] * m[2, 1] - m[0, 1] * m[2, 2])
    out[1, 1] = f * (m[0, 0] * m[2, 2] - m[0, 2] * m[2, 0])
    out[2, 1] = f * (m[0, 1] * m[2, 0] - m[0, 0] * m[2, 1])
    out[0, 2] = f * (m[0, 1] * m[1, 2] - m[0, 2] * m[1, 1])
    out[1, 2] = f * (m[0, 2] * m[1, 0] - m[0, 0] * m[1, 2])
    out[2, 2] = f * (m[0, 0] * m[1, 1] - m[0, 1] * m[1, 0])
    return out


class ViscousBending(DamperBase):
    """Moment `viscosity (w_e+1 - w_e)` between neighbours, implicit over the step."""

    def __init__(self, viscosity, inertia, time_step, **kwargs):
        super().__init__(**kwargs)
        n = inertia.shape[1]
        self.viscosity, self.inertia, self.time_step = viscosity, inertia, time_step
        self.scratch = np.zeros((n, 3, 3)), np.zeros((n, 3, 3)), np.zeros((n, 3))

    def dampen_rates(self, system, time):
        _dampen(
            system.director_collection, system.omega_collection, self.inertia, self.viscosity, self.time_step, *self.scratch
        )


class System(elastica.BaseSystemCollection, elastica.Constraints, elastica.Forcing, elastica.Damping):
    """A rod with constraints, forces and dampers."""


class Plant:
    def __init__(self, arm, stretch=1.0):
        self.arm, self.stretch = arm, stretch

    def build(self, step_s):
        arm = self.arm
        flexible = np.array([e["length"] for e in arm["elements"]])
        connector = np.array([e["connector"] for e in arm["elements"]])
        n = flexible.size  # bodies behind the clamp
        before = np.concatenate(([flexible[0] / 2], flexible / 2))
        after = np.concatenate((flexible / 2 + connector, [flexible[-1] / 2]))
        lengths = before + after
        w, x, y, z = arm["base_quaternion"]
        rotation = np.array(
            [
                [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
                [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
                [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
            ]
        )
        tangent, normal = rotation[:, 0].copy(), rotation[:, 1].copy()
        along = np.concatenate(([0.0], np.cumsum(lengths))) - before[0]
        radius = arm["backbone_radius"]
        second_moment = np.pi * radius**4 / 4
        bending = arm["elements"][0]["stiffness"][1]
        youngs = bending / second_moment * self.stretch
        system = System()
        rod = elastica.CosseratRod.straight_rod(
            n + 1,
            start=tangent * along[0],
            direction=tangent,
            normal=normal,
            base_length=lengths.sum(),
            base_radius=radius,
            density=1000.0,
            youngs_modulus=youngs,
            shear_modulus=youngs / 2.6,
            position=np.outer(tangent, along),
        )
        inertia = np.zeros((3, n + 1))
        mass = np.zeros(n + 2)
        for e in range(1, n + 1):
            node = arm["nodes"][e - 1]
            share = before[e] / lengths[e]
            mass[e] += (1.0 - share) * node["mass"]
            mass[e + 1] += share * node["mass"]
            jx, jy, jz = node["inertia"]
            inertia[:, e] = jy, jz, jx  # d1 = y, d2 = z, d3 = x
        inertia[:, 0] = inertia[:, 1]  # clamped
        mass[0] = mass[1]
        rod.mass[:] = mass
        for k in range(3):
            rod.mass_second_moment_of_inertia[k, k, :] = inertia[k]
            rod.inv_mass_second_moment_of_inertia[k, k, :] = 1.0 / inertia[k]
        viscosity = np.zeros((3, n))
        for i, element in enumerate(arm["elements"]):
            torsion, by, bz = element["stiffness"]
            for k, stiffness in enumerate((by, bz, torsion)):
                rod.bend_matrix[k, k, i] = stiffness * rod.rest_voronoi_lengths[i] / element["length"]
                viscosity[k, i] = stiffness / element["length"] * element["damping"]
        system.append(rod)
        system.constrain(rod).using(
            elastica.FixedConstraint, constrained_position_idx=(0, 1), constrained_director_idx=(0,)
        )
        start, element, share, hole = [0], [], [], []
        for cable in arm["cables"]:
            first, end = cable["elements"]
            element.append(first)
            share.append((before[first] + connector[first]) / lengths[first])
            for node in range(first + 1, end + 1):
                element.append(node)
                share.append(before[node] / lengths[node])
            start.append(len(element))
            hole.append(cable["hole"][1:])
        pace = 2.0 * np.pi * (0.25 + 0.15 * trace.segments(arm))
        system.add_forcing_to(rod).using(
            Cables, np.array(start), np.array(element), np.array(share), np.array(hole), pace, trace.angles(arm)
        )
        system.dampen(rod).using(ViscousBending, viscosity=viscosity, inertia=inertia, time_step=step_s)
        system.finalize()
        return system, rod, before[-1] / lengths[-1]

    def run(self, step_s, duration_s=trace.DURATION_S, sample_s=trace.SAMPLE_S, stepper="PositionVerlet"):
        """Tip at the samples, processor time of the steps alone (s). The first call in a process compiles: warm up first."""
        system, rod, share = self.build(step_s)
        step = getattr(elastica, stepper)().step
        each = round(sample_s / step_s)
        steps = round(duration_s / step_s)
        tip = []
        time, dt = np.float64(0.0), np.float64(step_s)
        begin = clock.thread_time()
        for _ in range(steps // each):
            for _ in range(each):
                time = step(system, time, dt)
            a, b = rod.position_collection[:, -2], rod.position_collection[:, -1]
            tip.append((1.0 - share) * a + share * b)
            if not np.isfinite(tip[-1]).all():
                return None, clock.thread_time() - begin, steps
        return np.array(tip), clock.thread_time() - begin, steps
