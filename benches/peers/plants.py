"""Plant against plant: the grid of settings, the reference, errors and real-time factors."""

import time

import numpy as np

import plant_elastica
import plant_mujoco
import tension_trace as trace

DURATION_S, SAMPLE_S = trace.DURATION_S, trace.SAMPLE_S


class Sinew:
    def __init__(self, driver, refinement, step_s):
        self.driver, self.request = driver, {"refinement": refinement, "step": step_s}

    def run(self):
        answer = self.driver.ask("plant", **self.request, rho_inf=0.8, duration=DURATION_S, sample=SAMPLE_S)
        if answer["failed"] is not None:
            return None, answer["seconds"], answer["steps"]
        self.iterations = answer["iterations"] / answer["steps"]
        return np.array(answer["tip"]), answer["seconds"], answer["steps"]


class Mujoco:
    def __init__(self, plant, integrator, step_s):
        self.plant, self.integrator, self.step_s = plant, integrator, step_s

    def run(self):
        return self.plant.run(self.integrator, self.step_s)


class Elastica:
    def __init__(self, arm, stretch, step_s):
        self.plant, self.step_s = plant_elastica.Plant(arm, stretch), step_s

    def run(self):
        return self.plant.run(self.step_s)


def reference(driver, quick):
    """sinew on two fine meshes and with two steps, extrapolated in both (second order): tip at the samples.

    Returns the path and an estimate of what is left: the difference to the same extrapolation one level coarser.
    """
    path = {}

    def at(refinement, step_s):
        if (refinement, step_s) not in path:
            path[refinement, step_s] = Sinew(driver, refinement, step_s).run()[0]
        return path[refinement, step_s]

    def extrapolated(mesh, step_s):
        base = at(mesh, step_s)
        return base + 4 / 3 * (at(2 * mesh, step_s) - base) + 4 / 3 * (at(mesh, step_s / 2) - base)

    mesh, step_s = (4, 0.0125) if quick else (8, 0.00625)
    fine, coarse = extrapolated(mesh, step_s), extrapolated(mesh // 2, 2 * step_s)
    return fine, float(np.linalg.norm(fine - coarse, axis=1).max())


def grid(driver, quick):
    """(package, mesh, setting, step, runner), slow ones last."""
    meshes = (1, 2, 4)
    arms = {k: driver.ask("arm", refinement=k) for k in (1, 2, 4, 8)}
    for k in meshes:
        for step_s in (0.1, 0.05, 0.025, 0.0125, 0.00625):
            yield "sinew", k, "rho_inf 0.8", step_s, Sinew(driver, k, step_s)
    for k in meshes if quick else (1, 2, 4, 8):
        plant = plant_mujoco.Plant(arms[k])
        steps = (0.05, 0.02, 0.01, 0.005) if quick or k > 2 else (0.05, 0.02, 0.01, 0.005, 0.002, 0.001)
        for integrator in ("implicitfast", "discrete") if quick else ("Euler", "implicitfast", "implicit", "discrete"):
            for step_s in steps if k < 8 else (0.02, 0.01):
                yield "MuJoCo", k, integrator, step_s, Mujoco(plant, integrator, step_s)
        if k == 1 and not quick:
            yield "MuJoCo", k, "RK4", 5e-5, Mujoco(plant, "RK4", 5e-5)
    # Steps near the largest stable ones: far below any error in time that would matter.
    for k, stretch, steps in (
        (1, 0.01, (1e-3, 5e-4)),
        (1, 0.1, (2e-4, 1e-4)),
        (1, 1.0, (1e-4, 8e-5)),
        (2, 0.01, (5e-4, 2.5e-4)),
        (2, 0.03, (2.5e-4, 2e-4)),
        (2, 0.1, (2e-4, 1e-4)),
        (2, 1.0, (5e-5, 4e-5)),
        (4, 0.1, (1e-4, 8e-5)),
    ):
        if quick and (k > 2 or (k, stretch) == (2, 1.0)):
            continue
        for step_s in steps[:1] if quick else steps:
            yield "PyElastica", k, f"stretch {stretch:g}", step_s, Elastica(arms[k], stretch, step_s)


def error(path, truth):
    if path is None:
        return None, None
    e = np.linalg.norm(path - truth, axis=1)
    return float(np.sqrt(np.mean(e * e))), float(e.max())


def limits(driver, truth, quick):
    """Each package's own limit under refinement (extrapolated), and its distance to the reference (m, max).

    A package that has no stable run on a mesh has no limit: `None`, and in `how` the mesh and the steps that were tried.
    """
    out = {}
    meshes = (2, 4)
    arms = {k: driver.ask("arm", refinement=k) for k in meshes}
    fine = {}
    for k in meshes:
        plant = plant_mujoco.Plant(arms[k])
        a, b = (plant.run("implicitfast", h)[0] for h in (0.004, 0.002))
        fine[k] = 2 * b - a
    out["MuJoCo"] = {
        "how": "implicitfast, steps 4 and 2 ms, 10 and 20 elements a segment, extrapolated (first order in time, second in the mesh)",
        "rms_m,max_m": error(fine[4] + (fine[4] - fine[2]) / 3, truth),
        "unextrapolated_rms_m,max_m": [error(fine[k], truth) for k in meshes],
    }
    if not quick:
        out["PyElastica"] = elastica_limit(arms, truth)
    return out


def elastica_limit(arms, truth):
    """Of the rod that is not softened, on two meshes, each with the largest stable of the steps tried."""
    steps = {2: (5e-5, 2.5e-5), 4: (1e-5, 5e-6)}
    runs = {k: first_stable(plant_elastica.Plant(arm, 1.0), steps[k]) for k, arm in arms.items()}
    milliseconds = lambda values: " and ".join(f"{h * 1e3:g}" for h in values)
    unstable = [f"{5 * k} elements a segment unstable at {milliseconds(steps[k])} ms" for k in arms if runs[k] is None]
    if unstable:
        limit, how = None, ", ".join(unstable)
    else:
        (_, coarse), (_, fine) = runs[2], runs[4]
        limit = fine + (fine - coarse) / 3
        how = f"steps {milliseconds(h for h, _ in runs.values())} ms, 10 and 20 elements a segment, extrapolated (second order in the mesh)"
    return {
        "how": f"stretch 1, {how}",
        "rms_m,max_m": error(limit, truth),
        "unextrapolated_rms_m,max_m": [error(run and run[1], truth) for run in runs.values()],
    }


def first_stable(plant, steps_s):
    """The largest of the steps that is stable, and the tip's path with it; `None` if none is."""
    runs = ((h, plant.run(h)[0]) for h in steps_s)
    return next(((h, path) for h, path in runs if path is not None), None)


def own_limits(driver, quick):
    """The tip's path of the unrefined arm in the limit of small steps, for each package: errors in time alone."""
    h = 0.00625 if quick else 0.003125
    a, b = (Sinew(driver, 1, step).run()[0] for step in (h, h / 2))
    out = {"sinew": b + (b - a) / 3}
    plant = plant_mujoco.Plant(driver.ask("arm", refinement=1))
    a, b = (plant.run("implicitfast", step)[0] for step in ((0.002, 0.001) if quick else (0.001, 0.0005)))
    out["MuJoCo"] = 2 * b - a
    return out


def measure(driver, quick, say):
    # Compile PyElastica's kernels before anything is timed.
    plant_elastica.Plant(driver.ask("arm", refinement=1)).run(1e-4, duration_s=1e-3, sample_s=1e-3)
    say("plant: reference")
    truth, uncertainty = reference(driver, quick)
    say(f"plant: reference good to about {uncertainty * 1e3:.3f} mm; limits of the peers")
    peers = limits(driver, truth, quick)
    own = own_limits(driver, quick)
    rows, runners = [], list(grid(driver, quick))
    begin = time.monotonic()
    for round_ in range(1 if quick else 3):
        for k, (package, mesh, setting, step_s, runner) in enumerate(runners):
            if round_ == 0:
                rows.append(
                    {"package": package, "elements_per_segment": 5 * mesh, "setting": setting, "step_s": step_s, "cpu_s": []}
                )
            row = rows[k]
            # A run that failed fails again; a slow one is repeated by its length anyway.
            if round_ and (row["rms_m"] is None or min(row["cpu_s"]) > 2.0):
                continue
            path, seconds, steps = runner.run()
            row["cpu_s"].append(seconds)
            row["steps"] = steps
            if round_ == 0:
                row["rms_m"], row["max_m"] = error(path, truth)
                if mesh == 1 and package in own:
                    row["own_rms_m"], row["own_max_m"] = error(path, own[package])
                if package == "sinew" and path is not None:
                    row["newton_iterations"] = runner.iterations
        say(f"plant: round {round_ + 1} of the grid ({len(runners)} settings) after {time.monotonic() - begin:.0f} s")
    for row in rows:
        row["realtime_factor"] = DURATION_S / float(np.median(row["cpu_s"])) if row["rms_m"] is not None else None
    return {
        "duration_s": DURATION_S,
        "reference_uncertainty_m": uncertainty,
        "reference_tip_m": truth.tolist(),
        "peer_limits": peers,
        "runs": rows,
    }


def front(rows, key="rms_m"):
    """Settings that no other of the same package beats in both error and speed, best error last."""
    good = sorted((r for r in rows if r.get(key) is not None), key=lambda r: (-r["realtime_factor"], r[key]))
    out = []
    for r in good:
        if not out or r[key] < out[-1][key]:
            out.append(r)
    return out


def ratios(rows, package, key="rms_m", setting=None):
    """At every point of the package's front (of one setting's, where named): sinew's fastest setting with no more error,
    over it. No interpolation."""
    sinew = [r for r in rows if r["package"] == "sinew" and r.get(key) is not None]
    out = []
    for r in front([r for r in rows if r["package"] == package and setting in (None, r["setting"])], key):
        able = [s["realtime_factor"] for s in sinew if s[key] <= r[key]]
        best = max(able) if able else None
        out.append({"error_m": r[key], "peer": r, "sinew_realtime_factor": best, "ratio": best and best / r["realtime_factor"]})
    return out
