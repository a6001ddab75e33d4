"""The planning step of the safe subspace written for CasADi: dynamics of one generalised-alpha step, cost, box.

The equations are those of `tests/golden/FORMULAS.md`, written out here once more: nothing of sinew's own evaluation is
used, only the arm's numbers. Unknowns: the correction of the coordinates from the predictor (140), the multipliers in
units of the tangent's size (80), the tensions (24).
"""

import json
import pathlib

import casadi as ca
import numpy as np

ROOT = pathlib.Path(__file__).resolve().parents[2]
SHAPE = np.array([0.806, 0.806, -2.417, 0.0, -1.611, -2.417, -1.611, -2.417])
TENSION_MAX = 220.0


def golden():
    return json.loads((ROOT / "tests/golden/plan_steps.json").read_text())


def tip_target(t):
    """The paper's lemniscate (38)-(39)."""
    if t <= 25:
        theta = np.pi / 100 * t
    elif t <= 50:
        theta = -np.pi / 100 * (t - 25) + 5 * np.pi / 4
    elif t <= 75:
        theta = -np.pi / 100 * (t - 50) + np.pi
    else:
        theta = np.pi / 100 * (t - 75) + 7 * np.pi / 4
    rho = 0.6 * np.cos(2 * theta)
    return np.array([rho * np.cos(theta), rho * np.sin(theta), -2.4])


def left_rate(p):
    """omega_body = 2 L(p) p'."""
    w, x, y, z = ca.vertsplit(p)
    return ca.blockcat([[-x, w, z, -y], [-y, -z, w, x], [-z, y, -x, w]])


def rotation(p):
    w, x, y, z = ca.vertsplit(p)
    return ca.blockcat(
        [
            [w * w + x * x - y * y - z * z, 2 * (x * y - w * z), 2 * (x * z + w * y)],
            [2 * (x * y + w * z), w * w - x * x + y * y - z * z, 2 * (y * z - w * x)],
            [2 * (x * z - w * y), 2 * (y * z + w * x), w * w - x * x - y * y + z * z],
        ]
    )


def relative(p, q):
    """Vector part of p* q."""
    w, x, y, z = ca.vertsplit(p)
    a, b, c, d = ca.vertsplit(q)
    return ca.vertcat(w * b - x * a - y * d + z * c, w * c - y * a - z * b + x * d, w * d - z * a - x * c + y * b)


class Problem:
    """The problem of one scenario (`shape` or `tip`): parametric in the state, so that it is built and compiled once."""

    def __init__(self, arm, shape, eta=0.1, rho=0.8):
        self.arm, self.shape, self.eta = arm, shape, eta
        self.alpha_m, self.alpha_f = (2 * rho - 1) / (rho + 1), rho / (rho + 1)
        self.gamma = 0.5 + self.alpha_f - self.alpha_m
        self.phi = 0.25 * (self.gamma + 0.5) ** 2
        self.cg = self.gamma / (eta * self.phi)
        self.cb = (1 - self.alpha_m) / (eta**2 * self.phi * (1 - self.alpha_f))
        e = arm["elements"][0]
        self.scale = max(n["mass"] for n in arm["nodes"]) * self.cb + e["stiffness"][1] / e["length"] ** 3 * (
            1 + e["damping"] * self.cg
        )
        segment = np.array([c["segment"] for c in arm["cables"]])
        self.change = np.full(24, 2e6) if shape else 1e4 * (segment + 1.0)
        self.build()

    def instance(self, case):
        """Parameters, start (the predictor with the last tensions and multipliers) and cost scale of a case."""
        eta, alpha_m, alpha_f, gamma, phi = self.eta, self.alpha_m, self.alpha_f, self.gamma, self.phi
        assert case["eta"] == eta
        q0, v0, a0, b0 = (np.array(case[k]) for k in ("q0", "v0", "a0", "vd0"))
        a1 = (alpha_f * b0 - alpha_m * a0) / (1 - alpha_m)
        q = q0 + eta * v0 + eta**2 * ((0.5 - phi) * a0 + phi * a1)
        v = v0 + eta * ((1 - gamma) * a0 + gamma * a1)
        u = np.array(case["u_prev"])
        if self.shape:
            goal = np.concatenate((SHAPE, [np.sqrt(-9.99e5 * (case["t"] - 100) ** 2 + 1e10)]))
        else:
            h = np.sqrt(0.5)
            wanted = np.array([h, 0, h, 0])
            goal = np.concatenate((tip_target(case["t"]), wanted * np.sign(wanted @ q[-4:])))
        x0 = np.concatenate((np.zeros(140), np.array(case["lam0"]) / self.scale, u))
        p = np.concatenate((q, v, u, goal, [1.0]))
        # The objective in units of its value at the start: of order one, whatever the weights.
        p[-1] = 1.0 / float(self.cost_function(x0, p))
        return p, x0

    def build(self):
        arm = self.arm
        n, nc = len(arm["nodes"]), len(arm["cables"])
        dq, mu, u = ca.SX.sym("dq", 7 * n), ca.SX.sym("mu", 4 * n), ca.SX.sym("u", nc)
        q_start, v_start, u_previous = ca.SX.sym("q", 7 * n), ca.SX.sym("v", 7 * n), ca.SX.sym("u_previous", nc)
        goal, unit = ca.SX.sym("goal", 9 if self.shape else 7), ca.SX.sym("unit")
        q, v, a = q_start + dq, v_start + self.cg * dq, self.cb * dq
        base = ca.DM([0, 0, 0] + arm["base_quaternion"])
        pose = [ca.SX(base)] + [q[7 * i : 7 * i + 7] for i in range(n)]
        rate = [ca.SX.zeros(7)] + [v[7 * i : 7 * i + 7] for i in range(n)]
        force = [ca.SX.zeros(7) for _ in range(n + 1)]
        psi = []
        lam = self.scale * mu
        curvature, curvature_rate = {}, {}
        # One element's potential and viscosity as a function, so that derivatives are formed once.
        for i, e in enumerate(arm["elements"]):
            l, con = e["length"], e["connector"]
            pi, pj = ca.SX.sym("pi", 7), ca.SX.sym("pj", 7)
            vi, vj = ca.SX.sym("vi", 7), ca.SX.sym("vj", 7)
            m, tension = ca.SX.sym("m", 3), ca.SX.sym("t", nc)
            ri, rj, hi, hj = pi[:3], pj[:3], pi[3:], pj[3:]
            R, S = rotation(hi), rotation(hj)
            mid = hi + hj
            chord = l / 6 * (R[:, 0] + 4 * rotation(mid)[:, 0] / ca.dot(mid, mid) + S[:, 0])
            c = rj - ri - con * R[:, 0] - chord
            kappa = 2 / l * relative(hi, hj)
            kappa_rate = 2 / l * (relative(vi[3:], hj) + relative(hi, vj[3:]))
            stiffness = ca.DM(e["stiffness"])
            potential = l / 2 * ca.dot(kappa * stiffness, kappa) + ca.dot(m, c)
            for k, cable in enumerate(arm["cables"]):
                if cable["elements"][0] <= i < cable["elements"][1]:
                    h = ca.DM(cable["hole"])
                    leg = rj + S @ h - ri - con * R[:, 0] - R @ h
                    potential += tension[k] * ca.norm_2(leg)
            both = ca.vertcat(pi, pj)
            f = ca.gradient(potential, both) + e["damping"] * l * ca.jtimes(kappa, both, stiffness * kappa_rate, True)
            function = ca.Function("element", [pi, pj, vi, vj, m, tension], [f, c, kappa, kappa_rate])
            f, c, kappa, kappa_rate = function(pose[i], pose[i + 1], rate[i], rate[i + 1], lam[4 * i : 4 * i + 3], u)
            force[i] += f[:7]
            force[i + 1] += f[7:]
            psi.append((c, ca.dot(pose[i + 1][3:], pose[i + 1][3:]) - 1))
            s = self.segment_of(i)
            curvature.setdefault(s, []).append(kappa[1:])
            curvature_rate.setdefault(s, []).append(kappa_rate[1:])
        residual = []
        for i, node in enumerate(arm["nodes"]):
            p, pd, pdd = pose[i + 1][3:], rate[i + 1][3:], a[7 * i + 3 : 7 * i + 7]
            J = ca.diag(ca.DM(node["inertia"]))
            L = left_rate(p)
            f = force[i + 1]
            f[:3] += node["mass"] * a[7 * i : 7 * i + 3]
            Ld = left_rate(pd)
            f[3:] += 4 * L.T @ (J @ (L @ pdd)) + 8 * Ld.T @ (J @ (L @ pd)) + 2 * lam[4 * i + 3] * p
            residual += [f, self.scale * psi[i][0], self.scale * psi[i][1]]
        cost = ca.dot(u, u) + ca.dot(self.change * (u - u_previous), u - u_previous)
        # Outputs as a weighted vector: also what a least-squares solver needs.
        if self.shape:
            mean = lambda d: ca.vertcat(*[sum(d[s]) / len(d[s]) for s in range(4)])
            outputs = goal[8] * ca.vertcat(mean(curvature) - goal[:8], mean(curvature_rate))
        else:
            outputs = ca.vertcat(np.sqrt(5e12) * (q[-7:] - goal), np.sqrt(5e10) * v[-7:], np.sqrt(1e8) * v[:-7])
        cost += ca.dot(outputs, outputs)
        self.x, self.p = ca.vertcat(dq, mu, u), ca.vertcat(q_start, v_start, u_previous, goal, unit)
        self.residual, self.outputs, self.scaled_cost = ca.vertcat(*residual), outputs, unit * cost
        self.cost_function = ca.Function("cost", [self.x, self.p], [cost])
        inf = np.inf
        self.lower = np.concatenate((np.full(11 * n, -inf), np.zeros(nc)))
        self.upper = np.concatenate((np.full(11 * n, inf), np.full(nc, TENSION_MAX)))

    def segment_of(self, i):
        return next(c["segment"] for c in self.arm["cables"] if c["elements"][0] <= i < c["elements"][1])
