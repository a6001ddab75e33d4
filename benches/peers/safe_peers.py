"""Solvers of the safe step: CasADi + IPOPT, and two ways with SciPy.

All start from the same point (the predictor with the last tensions and multipliers) and end at the same optimum, which
is checked. `repeats` solves are timed by the thread's processor time, set-up and compilation excluded.
"""

import time

import casadi as ca
import numpy as np
import scipy.optimize
import scipy.sparse
import scipy.sparse.linalg

import safe_model

# Each was the fastest for some of the cases; all of them are measured, and the best is quoted beside the first.
IPOPT = {
    "ipopt": {"mu_init": 1e-4, "mehrotra_algorithm": "yes"},
    "ipopt adaptive": {"mu_strategy": "adaptive", "mu_oracle": "probing"},
    "ipopt monotone": {"mu_init": 1e-6},
}


class Ipopt:
    """Exact Hessian, sparse, MUMPS; the functions interpreted by CasADi, or compiled as C."""

    def __init__(self, problem, options, compiled):
        self.problem = problem
        nlp = {"x": problem.x, "p": problem.p, "f": problem.scaled_cost, "g": problem.residual}
        settings = {
            "print_time": False,
            "calc_lam_p": False,
            "calc_lam_x": False,
            "ipopt": {
                "print_level": 0,
                "sb": "yes",
                "tol": 1e-8,
                # The problem is scaled by hand already; IPOPT's own scaling fails on the weights of 5e12.
                "nlp_scaling_method": "none",
                "warm_start_init_point": "yes",
                "warm_start_bound_push": 1e-6,
                "warm_start_mult_bound_push": 1e-6,
                **options,
            },
        }
        if compiled:
            settings |= {"jit": True, "compiler": "shell", "jit_options": {"flags": ["-O1", "-march=native"], "verbose": False}}
        self.solver = ca.nlpsol("solver", "ipopt", nlp, settings)

    def start(self, p, x0):
        self.arguments = {"p": p, "x0": x0, "lbx": self.problem.lower, "ubx": self.problem.upper, "lbg": 0, "ubg": 0}

    def solve(self):
        solution = self.solver(**self.arguments)
        stats = self.solver.stats()
        self.ended = stats["return_status"]
        self.iterations = stats["iter_count"]
        # Cost, constraints and their derivatives; the rest is IPOPT's own, mostly MUMPS.
        self.functions_s = sum(v for k, v in stats.items() if k.startswith("t_proc_nlp"))
        return np.array(solution["x"])[:, 0]


class Compiled:
    """Residual, outputs and their Jacobians from CasADi, for SciPy."""

    def __init__(self, problem):
        x, p = problem.x, problem.p
        n = problem.residual.numel()
        self.n = n
        self.function = ca.Function(
            "f", [x, p], [problem.residual, ca.jacobian(problem.residual, x), problem.outputs, ca.jacobian(problem.outputs, x)]
        )
        self.buffer = None

    def __call__(self, x, p):
        r, j, y, s = self.function(x, p)
        return np.array(r)[:, 0], j.sparse(), np.array(y)[:, 0], s.sparse()


class ScipyNewton:
    """The reduced problem as a SciPy user would write it: sparse LU of the step's tangent, bounded linear least squares."""

    def __init__(self, problem):
        self.problem, self.f = problem, Compiled(problem)
        self.ended = ""

    def start(self, p, x0):
        self.p, self.x0 = p, x0

    def solve(self):
        change, n = self.problem.change, self.f.n
        u_previous = self.x0[n:]
        x = self.x0.copy()
        weight = np.concatenate((np.ones(24), np.sqrt(change)))
        for self.iterations in range(1, 31):
            r, j, y, s = self.f(x, self.p)
            j = j.tocsc()
            lu = scipy.sparse.linalg.splu(j[:, :n])
            map_ = lu.solve(np.column_stack((-r, -j[:, n:].toarray())))
            s = s.tocsr()
            reduced = s[:, :n] @ map_
            a = np.vstack((reduced[:, 1:] + s[:, n:].toarray(), np.diag(weight[:24]), np.diag(weight[24:])))
            u = x[n:]
            b = -np.concatenate((y + reduced[:, 0], u, weight[24:] * (u - u_previous)))
            # In the step du: the bounds move with it.
            found = scipy.optimize.lsq_linear(a, b, (-u - 1e-300, safe_model.TENSION_MAX - u + 1e-300), method="bvls", tol=1e-14)
            dx = map_[:, 0] + map_[:, 1:] @ found.x
            x[:n] += dx
            x[n:] = np.clip(u + found.x, 0.0, safe_model.TENSION_MAX)
            if np.linalg.norm(dx[:140]) < 1e-8:
                self.ended = "converged"
                break
        return x


class ScipySlsqp:
    """All 244 unknowns to SLSQP with exact derivatives."""

    def __init__(self, problem):
        self.problem = problem
        x, p = problem.x, problem.p
        cost = ca.Function("c", [x, p], [problem.scaled_cost, ca.gradient(problem.scaled_cost, x)])
        dense = ca.Function("g", [x, p], [problem.residual, ca.densify(ca.jacobian(problem.residual, x))])
        self.cost = lambda v: tuple(np.array(k).reshape(-1) for k in cost(v, self.p))
        self.dense = dense

    def start(self, p, x0):
        self.p, self.x0 = p, x0

    def solve(self):
        def cost(v):
            c, g = self.cost(v)
            return c[0], g

        found = scipy.optimize.minimize(
            cost,
            self.x0,
            jac=True,
            method="SLSQP",
            bounds=scipy.optimize.Bounds(self.problem.lower, self.problem.upper),
            constraints={
                "type": "eq",
                "fun": lambda v: np.array(self.dense(v, self.p)[0])[:, 0],
                "jac": lambda v: np.array(self.dense(v, self.p)[1]),
            },
            options={"maxiter": 200, "ftol": 1e-9},
        )
        self.iterations, self.ended = found.nit, found.message
        return found.x


def timed(solver, repeats):
    """Thread processor time of each solve (s), and the last answer."""
    seconds = []
    for _ in range(repeats):
        begin = time.thread_time()
        x = solver.solve()
        seconds.append(time.thread_time() - begin)
    return seconds, x
