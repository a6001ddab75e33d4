"""Particle swarms on the warning subspace's cost: pyswarms, and the same algorithm in plain NumPy for information.

The problem comes from sinew's driver as numbers: `J(u) = u^T A u + 2 b^T u + c` and, for every body point near a ball,
its position as an affine function of the tensions; the penalty is (27). The cost is vectorised over the particles (two
matrix products a sweep), so what is compared is what each package adds to that, and the product itself.
"""

import time

import numpy as np
import pyswarms


class Cost:
    def __init__(self, problem):
        self.a = np.array(problem["a"]).reshape(24, 24)
        self.b, self.c = np.array(problem["b"]), problem["c"]
        self.origin = np.array(problem["origin"])
        self.slope = np.array(problem["slope"]).reshape(-1, 24)
        self.centre = np.array(problem["centre"])
        self.radius, self.nu = problem["radius"], problem["penalty"]
        self.low, self.high = np.full(24, problem["low"]), np.full(24, problem["high"])
        self.u_previous = np.array(problem["u_previous"])
        self.evaluations = 0

    def __call__(self, u):
        """Costs of the particles `u`, one a row."""
        self.evaluations += len(u)
        cost = np.einsum("ij,ij->i", u @ self.a + 2.0 * self.b, u) + self.c
        at = (self.origin + u @ self.slope.T).reshape(len(u), -1, 3) - self.centre
        s2 = np.einsum("ijk,ijk->ij", at, at) / self.radius**2
        near = np.maximum(1.0 - s2 * s2 * s2, 0.0)
        return cost + self.nu * np.einsum("ij,ij,ij->i", near, near, near)

    def start(self, seed, normal=30, uniform=10, sigma=2.0):
        """The start (30)-(32) of sinew's swarm: about the last tensions, across the box, and the last tensions."""
        rng = np.random.default_rng(seed)
        u = np.vstack(
            (
                self.u_previous + sigma * rng.standard_normal((normal, 24)),
                rng.uniform(self.low, self.high, (uniform, 24)),
                self.u_previous,
            )
        )
        return np.clip(u, self.low, self.high)


def pyswarms_search(cost, seed, sweeps, seconds=None):
    """`GlobalBestPSO` with sinew's start, coefficients and inertia schedule."""
    np.random.seed(seed)
    start = cost.start(seed)
    optimizer = pyswarms.single.GlobalBestPSO(
        n_particles=len(start),
        dimensions=24,
        options={"c1": 1.5, "c2": 1.5, "w": 0.9},
        bounds=(cost.low, cost.high),
        bh_strategy="nearest",
        oh_strategy={"w": "lin_variation"},
        init_pos=start,
    )
    before = cost.evaluations
    begin = time.thread_time()
    best, _ = optimizer.optimize(cost, iters=sweeps, verbose=False)
    return best, time.thread_time() - begin, cost.evaluations - before


def numpy_search(cost, seed, sweeps):
    """(29) in NumPy without a package around it: how much of the time is the package's."""
    rng = np.random.default_rng(seed)
    begin = time.thread_time()
    x = cost.start(seed)
    v = np.zeros_like(x)
    best, best_cost = x.copy(), np.full(len(x), np.inf)
    top, top_cost = x[0], np.inf
    for sweep in range(sweeps):
        j = cost(x)
        better = j < best_cost
        best[better], best_cost[better] = x[better], j[better]
        k = np.argmin(best_cost)
        if best_cost[k] < top_cost:
            top, top_cost = best[k].copy(), best_cost[k]
        w = 0.9 - 0.5 * sweep / sweeps
        v = w * v + 1.5 * rng.random(x.shape) * (best - x) + 1.5 * rng.random(x.shape) * (top - x)
        y = np.clip(x + v, cost.low, cost.high)
        v, x = y - x, y
    return top_cost, time.thread_time() - begin, sweeps * len(x)
