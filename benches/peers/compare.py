"""sinew beside its peers: measures everything, writes raw data, summary and plots. Started by `run`."""

import argparse
import csv
import importlib.metadata
import json
import os
import pathlib
import platform
import statistics
import sys
import time

# pyswarms writes a log where it is imported, CasADi's compiler where it is called: not into the checkout.
STARTED_IN = pathlib.Path.cwd()
os.chdir(os.environ.get("TMPDIR", "."))
sys.path.append(str(pathlib.Path(__file__).resolve().parents[1]))

import numpy as np

import machine
import plants
import report
import safe_model
import safe_peers
import swarm_peers
from sinew import ROOT, Sinew

BEGIN = time.monotonic()


def say(text):
    print(f">> [{time.monotonic() - BEGIN:4.0f} s] {text}", flush=True)


def environment(quick):
    pins = [l.split("==")[0] for l in (ROOT / "benches/peers/requirements.txt").read_text().splitlines() if "==" in l]
    return machine.describe() | {
        "quick": quick,
        "python": platform.python_version(),
        "packages": {name: importlib.metadata.version(name) for name in pins},
    }


def safe_step(driver, quick):
    """All solvers take turns on each case, `rounds` times."""
    arm = driver.ask("arm", refinement=1)
    cases = [(k, c) for k, c in enumerate(safe_model.golden()["cases"]) if not c["avoid"]]
    if quick:
        cases = [cases[k] for k in (1, 4, 7)]
    rounds, rows = (3 if quick else 7), []
    compiled = {}
    for shape in (True, False):
        chosen = [(k, c) for k, c in cases if (c["scenario"] == "shape") == shape]
        problem = safe_model.Problem(arm, shape)
        solvers = {name: safe_peers.Ipopt(problem, options, False) for name, options in safe_peers.IPOPT.items()}
        if not quick:
            begin = time.monotonic()
            solvers["ipopt compiled"] = safe_peers.Ipopt(problem, safe_peers.IPOPT["ipopt"], True)
            compiled["shape" if shape else "tip"] = time.monotonic() - begin
        solvers["scipy newton"] = safe_peers.ScipyNewton(problem)
        solvers["scipy slsqp"] = safe_peers.ScipySlsqp(problem)
        for k, case in chosen:
            p, x0 = problem.instance(case)
            goal = {} if shape else {"position": list(safe_model.tip_target(case["t"]))}
            row = {"case": k, "scenario": case["scenario"], "t_s": case["t"], "optimum": case["J_opt"], "solvers": {}}
            entry = lambda name: row["solvers"].setdefault(name, {"cpu_s": []})
            for round_ in range(rounds):
                answer = driver.ask("safe", case=k, repeats=40, **goal)
                e = entry("sinew")
                e["cpu_s"] += answer["seconds"]
                e |= {"iterations": answer["iterations"], "gap": answer["cost"] / case["J_opt"] - 1, "ended": answer["status"]}
                for name, solver in solvers.items():
                    if name == "scipy slsqp" and round_ > 0:
                        continue
                    solver.start(p, x0)
                    if round_ == 0 and name != "scipy slsqp":
                        solver.solve()  # the first solve sets memory up
                    seconds, x = safe_peers.timed(solver, 1)
                    e = entry(name)
                    e["cpu_s"] += seconds
                    gap = float(problem.cost_function(x, p)) / case["J_opt"] - 1
                    e |= {"iterations": int(solver.iterations), "gap": gap, "ended": str(solver.ended)}
                    if hasattr(solver, "functions_s"):
                        e.setdefault("functions_s", []).append(solver.functions_s)
            for name, e in row["solvers"].items():
                e["median_s"] = statistics.median(e["cpu_s"])
                e["same_optimum"] = abs(e["gap"]) < 1e-6
                del e["cpu_s"][200:]
            rows.append(row)
            say(f"safe step: {case['scenario']} t = {case['t']:g} s")
    return {"rounds": rounds, "compile_s": compiled, "cases": rows}


def swarm(driver, quick):
    rows = []
    sweeps, seeds = 60, 5 if quick else 20
    for k in (5, 7):
        problem = driver.ask("swarm problem", case=k)
        cost = swarm_peers.Cost(problem)
        row = {"case": k, "points": len(problem["centre"]), "sweeps": sweeps, "equal_evaluations": {}, "equal_time": {}}
        entry = lambda table, name: row[table].setdefault(name, {"cpu_s": [], "evaluations": [], "cost": []})

        def add(table, name, best, seconds, evaluations):
            e = entry(table, name)
            e["cost"].append(best)
            e["cpu_s"].append(seconds)
            e["evaluations"].append(evaluations)

        def ask(table, name, **request):
            a = driver.ask("swarm", case=k, repeats=1, **request)
            add(table, name, a["costs"][0], a["seconds"][0], a["evaluations"][0])
            return a

        first = driver.ask("swarm", case=k, repeats=1, sweeps=sweeps)
        check = float(cost(np.array([first["answer"]]))[0]) / first["costs"][0] - 1
        row["cost_difference"] = check
        assert abs(check) < 1e-12, f"the two cost functions differ by {check}"
        for seed in range(seeds):
            ask("equal_evaluations", "sinew", sweeps=sweeps, seed=seed)
            ask("equal_evaluations", "sinew standard", sweeps=sweeps, seed=seed, variant="standard")
            pyswarms = swarm_peers.pyswarms_search(cost, seed, sweeps)
            add("equal_evaluations", "pyswarms", *pyswarms)
            add("equal_evaluations", "numpy", *swarm_peers.numpy_search(cost, seed, sweeps))
            # As long as pyswarms took: more sweeps of the same swarm.
            rate = sum(entry("equal_evaluations", "sinew")["evaluations"]) / sum(entry("equal_evaluations", "sinew")["cpu_s"])
            more = max(sweeps, int(pyswarms[1] * rate / 41))
            add("equal_time", "pyswarms", *pyswarms)
            ask("equal_time", "sinew", sweeps=more, seed=seed)
        for table in ("equal_evaluations", "equal_time"):
            for e in row[table].values():
                e["evaluations_per_s"] = statistics.median(n / s for n, s in zip(e["evaluations"], e["cpu_s"]))
                e["cost_median"] = statistics.median(e["cost"])
        best = min(min(e["cost"]) for table in ("equal_evaluations", "equal_time") for e in row[table].values())
        row["best_cost"] = best
        rows.append(row)
    say("swarm: done")
    return {"cases": rows}


def write_csv(path, rows, columns):
    with open(path, "w", newline="") as file:
        out = csv.writer(file)
        out.writerow(columns)
        for row in rows:
            out.writerow([row.get(c) if not isinstance(row.get(c), float) else f"{row[c]:.6g}" for c in columns])


def main():
    parser = argparse.ArgumentParser()
    parser.add_argument("--quick", action="store_true")
    parser.add_argument("--results", type=pathlib.Path, default=ROOT / "benches/peers/results")
    parser.add_argument("--only", choices=["plant", "safe", "swarm"], action="append")
    arguments = parser.parse_args()
    out = STARTED_IN / arguments.results
    out.mkdir(parents=True, exist_ok=True)
    wanted = arguments.only or ["plant", "safe", "swarm"]
    data = {"environment": environment(arguments.quick)}
    driver = Sinew()
    measures = {
        "plant": lambda: plants.measure(driver, arguments.quick, say),
        "safe": lambda: safe_step(driver, arguments.quick),
        "swarm": lambda: swarm(driver, arguments.quick),
    }
    for name in wanted:
        data[name] = measures[name]()
    driver.close()
    data["environment"]["load_average_at_end"] = os.getloadavg()[0]
    data["environment"]["seconds"] = time.monotonic() - BEGIN
    for name in ("environment", *wanted):
        (out / f"{name}.json").write_text(json.dumps(data[name], indent=1) + "\n")
    if "plant" in data:
        columns = [
            "package", "elements_per_segment", "setting", "step_s", "rms_m", "max_m", "realtime_factor", "steps",
            "own_rms_m", "own_max_m", "newton_iterations",
        ]
        write_csv(out / "plant.csv", data["plant"]["runs"], columns)
    if "safe" in data:
        rows = [
            {"case": c["case"], "scenario": c["scenario"], "t_s": c["t_s"], "solver": name, **e}
            for c in data["safe"]["cases"]
            for name, e in c["solvers"].items()
        ]
        write_csv(out / "safe.csv", rows, ["case", "scenario", "t_s", "solver", "median_s", "iterations", "gap", "ended"])
    if "swarm" in data:
        rows = [
            {"case": c["case"], "budget": table, "swarm": name, **e}
            for c in data["swarm"]["cases"]
            for table in ("equal_evaluations", "equal_time")
            for name, e in c[table].items()
        ]
        write_csv(out / "swarm.csv", rows, ["case", "budget", "swarm", "evaluations_per_s", "cost_median"])
    report.write(out, data)
    say(f"written to {out}")


if __name__ == "__main__":
    sys.exit(main())
