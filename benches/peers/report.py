"""The summary (Markdown) and the plots (SVG) from what was measured. No figure is written by hand."""

import statistics

import matplotlib

matplotlib.use("Agg")
import matplotlib.pyplot as plt

import machine
import plants

COLOURS = {"sinew": "#c1121f", "MuJoCo": "#1d4e89", "PyElastica": "#4a7c59"}
MARKS = {5: "o", 10: "s", 20: "^", 40: "D"}
# A front of its own for the rod whose shear and stretch are the backbone's: a softened one is another rod.
PEERS = [("MuJoCo", "MuJoCo", None), ("PyElastica", "PyElastica", None), ("PyElastica, not softened", "PyElastica", "stretch 1")]
plt.rcParams |= {"svg.hashsalt": "sinew", "font.size": 9, "axes.grid": True, "grid.alpha": 0.3}


def save(figure, path):
    figure.tight_layout()
    figure.savefig(path, metadata={"Date": None})
    plt.close(figure)


def millimetres(v):
    return "-" if v is None else f"{v * 1e3:.3g}"


def plot_plants(out, runs, key, name, title):
    figure, axes = plt.subplots(figsize=(7.5, 4.8))
    for package, colour in COLOURS.items():
        mine = [r for r in runs if r["package"] == package and r.get(key) is not None]
        if not mine:
            continue
        for mesh, mark in MARKS.items():
            some = [r for r in mine if r["elements_per_segment"] == mesh]
            if some:
                axes.plot(
                    [r[key] * 1e3 for r in some], [r["realtime_factor"] for r in some],
                    mark, color=colour, alpha=0.55, markersize=5, label=f"{package}, {mesh} elements a segment",
                )
        edge = plants.front(mine, key)
        axes.plot([r[key] * 1e3 for r in edge], [r["realtime_factor"] for r in edge], "-", color=colour, linewidth=1.2)
    axes.set(xscale="log", yscale="log", xlabel="error of the tip, rms over time (mm)", ylabel="real-time factor", title=title)
    axes.legend(fontsize=7)
    save(figure, out / name)


def plant(out, data, lines):
    runs = data["runs"]
    plot_plants(out, runs, "rms_m", "plant.svg", "The arm as a plant: error against the common limit")
    lines += [
        "## Plant", "",
        f"{data['duration_s']:g} s of motion; the tip's error against the common limit (sinew on finer meshes and steps, "
        f"extrapolated; good to about {millimetres(data['reference_uncertainty_m'])} mm). Real-time factors from the "
        "processor time of the steps, median.", "", "![](plant.svg)", "",
        "Where the peers themselves go under refinement:", "",
        "| package | own limit's distance to the reference, rms (max), mm | meshes it is extrapolated from, rms mm | how |", "|---|---|---|---|",
    ]
    for name, p in data["peer_limits"].items():
        rms, most = p["rms_m,max_m"]
        meshes = ", ".join(millimetres(e[0]) for e in p["unextrapolated_rms_m,max_m"])
        own = "none" if rms is None else f"{millimetres(rms)} ({millimetres(most)})"
        lines.append(f"| {name} | {own} | {meshes} | {p['how']} |")
    for key, heading, note in (
        ("rms_m", "At equal error", "Every setting of the peer that no other of its settings beats in both error and speed, "
         "and the fastest setting of sinew whose error is no larger (no interpolation)."),
        ("own_rms_m", "Time integration alone", "The unrefined arm (5 elements a segment), errors against each package's own "
         "limit of small steps: what the choice of mesh and chord does not touch."),
    ):
        table = []
        for name, package, setting in PEERS:
            for r in plants.ratios(runs, package, key, setting):
                p = r["peer"]
                table.append(
                    f"| {name}, {p['elements_per_segment']} elements, {p['setting']}, {p['step_s'] * 1e3:g} ms "
                    f"| {millimetres(r['error_m'])} | {p['realtime_factor']:.3g} "
                    + (f"| {r['sinew_realtime_factor']:.3g} | **{r['ratio']:.3g}** |" if r["ratio"] else "| - | - |")
                )
        if table:
            lines += ["", f"### {heading}", "", note, "",
                      "| peer | rms error (mm) | its real-time factor | sinew's | ratio |", "|---|---|---|---|---|", *table]
    if any(r.get("own_rms_m") is not None for r in runs):
        plot_plants(out, [r for r in runs if r.get("own_rms_m") is not None], "own_rms_m", "plant_time.svg",
                    "Time integration alone: the unrefined arm, error against each package's own limit")
        lines += ["", "![](plant_time.svg)"]
    unstable = [r for r in runs if r["rms_m"] is None]
    lines += ["", "### All settings", "",
              "| package | elements a segment | setting | step (ms) | rms error (mm) | max error (mm) | real-time factor | time a step (us) |",
              "|---|---|---|---|---|---|---|---|"]
    for r in runs:
        if r["rms_m"] is not None:
            each = statistics.median(r["cpu_s"]) / r["steps"] * 1e6
            extra = f", {r['newton_iterations']:.2f} Newton iterations" if "newton_iterations" in r else ""
            lines.append(
                f"| {r['package']} | {r['elements_per_segment']} | {r['setting']}{extra} | {r['step_s'] * 1e3:g} | "
                f"{millimetres(r['rms_m'])} | {millimetres(r['max_m'])} | {r['realtime_factor']:.3g} | {each:.1f} |"
            )
    if unstable:
        lines += ["", "Did not finish (unstable or no convergence): "
                  + "; ".join(f"{r['package']} {r['elements_per_segment']} {r['setting']} {r['step_s'] * 1e3:g} ms" for r in unstable)]


def headline(data):
    """What was asked of each comparison, beside what came out."""
    lines = ["| ratio in this run | asked | least | median | most | of |", "|---|---|---|---|---|---|"]

    def row(what, asked, values, of):
        if values:
            v = sorted(values)
            lines.append(f"| {what} | {asked} | {v[0]:.3g} | **{statistics.median(v):.3g}** | {v[-1]:.3g} | {of} |")

    if "safe" in data:
        cases = data["safe"]["cases"]

        def best(names):
            out = []
            for c in cases:
                times = [e["median_s"] for n, e in c["solvers"].items() if names(n) and e["same_optimum"]]
                if times:
                    out.append(min(times) / c["solvers"]["sinew"]["median_s"])
            return out

        row("safe step, CasADi + IPOPT, best interpreted setting of each case", 100,
            best(lambda n: n.startswith("ipopt") and n != "ipopt compiled"), f"{len(cases)} cases")
        row("safe step, CasADi + IPOPT, compiled as C", 100, best(lambda n: n == "ipopt compiled"), f"{len(cases)} cases")
        row("safe step, SciPy, same Newton", "-", best(lambda n: n == "scipy newton"), f"{len(cases)} cases")
        row("safe step, SciPy, SLSQP", "-", best(lambda n: n == "scipy slsqp"), f"{len(cases)} cases")
    if "plant" in data:
        for name, package, setting in PEERS:
            found = [r for r in plants.ratios(data["plant"]["runs"], package, "rms_m", setting) if r["ratio"]]
            asked = 2 if package == "MuJoCo" else 50
            row(f"plant at equal error, {name}", asked, [r["ratio"] for r in found], f"{len(found)} settings on its front")
            good = [r["ratio"] for r in found if r["error_m"] <= 0.02]
            row(f"plant at equal error, {name}, errors up to 20 mm", asked, good, f"{len(good)} settings on its front")
        found = [r for r in plants.ratios(data["plant"]["runs"], "MuJoCo", "own_rms_m") if r["ratio"]]
        row("plant, time integration alone, MuJoCo", "-", [r["ratio"] for r in found], f"{len(found)} settings on its front")
    if "swarm" in data:
        for peer, asked in (("pyswarms", 10), ("numpy", "-")):
            rates = [c["equal_evaluations"] for c in data["swarm"]["cases"]]
            row(f"swarm evaluations per second, {peer}", asked,
                [r["sinew"]["evaluations_per_s"] / r[peer]["evaluations_per_s"] for r in rates], f"{len(rates)} problems")
    return lines + [""]


def safe(out, data, lines):
    cases = data["cases"]
    names = list(cases[0]["solvers"])
    names += [n for c in cases for n in c["solvers"] if n not in names]
    ratio = {n: [] for n in names}
    lines += ["", "## Safe step", "",
              "One planning step of the safe subspace to convergence, from the reference states; median time, and its ratio to "
              "sinew's in the same turns. A cost within 1e-6 of the reference's counts as the same optimum.", "",
              "| case | sinew | " + " | ".join(n for n in names if n != "sinew") + " |", "|---|" + "---|" * len(names)]
    for c in cases:
        mine = c["solvers"]["sinew"]["median_s"]
        cells = []
        for n in names:
            e = c["solvers"].get(n)
            if e is None:
                cells.append("-")
                continue
            if n != "sinew" and e["same_optimum"]:
                ratio[n].append(e["median_s"] / mine)
            value = f"{mine * 1e6:.0f} us" if n == "sinew" else f"{e['median_s'] * 1e3:.1f} ms, x{e['median_s'] / mine:.0f}"
            cells.append(f"{value} ({e['iterations']} it.)" + ("" if e["same_optimum"] else f" **cost off by {e['gap']:.1e}**"))
        lines.append(f"| {c['scenario']} {c['t_s']:g} s | " + " | ".join(cells) + " |")
    best, first = [], []
    for c in cases:
        mine = c["solvers"]["sinew"]["median_s"]
        ipopt = {n: e for n, e in c["solvers"].items() if n.startswith("ipopt") and e["same_optimum"]}
        interpreted = [e["median_s"] for n, e in ipopt.items() if n != "ipopt compiled"]
        if interpreted:
            first.append(min(interpreted) / mine)
            best.append(min(e["median_s"] for e in ipopt.values()) / mine)
    lines += ["", "| ratio to sinew's median | median over the cases | least | most | same optimum |", "|---|---|---|---|---|"]
    for n in names:
        if n != "sinew" and ratio[n]:
            r = ratio[n]
            lines.append(f"| {n} | **{statistics.median(r):.0f}** | {min(r):.0f} | {max(r):.0f} | {len(r)} of {len(cases)} |")
    for what, r in (("IPOPT, best interpreted setting of each case", first), ("IPOPT, best of all settings of each case", best)):
        if r:
            lines.append(f"| {what} | **{statistics.median(r):.0f}** | {min(r):.0f} | {max(r):.0f} | {len(r)} of {len(cases)} |")
    share = {
        n: statistics.median(statistics.median(c["solvers"][n]["functions_s"]) / c["solvers"][n]["median_s"] for c in cases)
        for n in names
        if all("functions_s" in c["solvers"].get(n, {}) for c in cases)
    }
    if share:
        lines += ["", "Share of a solve that evaluates cost, constraints and derivatives (the rest is IPOPT with MUMPS): "
                  + ", ".join(f"{n} {100 * v:.0f} %" for n, v in share.items()) + "."]
    if data["compile_s"]:
        lines += ["", "Compiling the functions took " + ", ".join(f"{v:.0f} s ({k})" for k, v in data["compile_s"].items())
                  + ", not counted."]
    figure, axes = plt.subplots(figsize=(7.5, 4))
    for k, n in enumerate(names):
        times = [c["solvers"][n]["median_s"] * 1e3 for c in cases if n in c["solvers"]]
        axes.plot([k] * len(times), times, "o", alpha=0.6, color=COLOURS["sinew"] if n == "sinew" else COLOURS["MuJoCo"])
    axes.set(yscale="log", ylabel="time of a step (ms)", title="One planning step, every case a point")
    axes.set_xticks(range(len(names)), names, rotation=25, ha="right")
    save(figure, out / "safe.svg")
    lines += ["", "![](safe.svg)"]


def swarm(out, data, lines):
    lines += ["", "## Swarm", "",
              "The cost of a planning step beside an obstacle, 41 particles. Medians over the seeds. `sinew` is the improved swarm, "
              "`sinew standard` the plain one from a uniform start; `numpy` is the plain algorithm without a package, for information.", ""]
    figure, axes = plt.subplots(figsize=(7.5, 4))
    labels, values = [], []
    for c in data["cases"]:
        rate = {n: e["evaluations_per_s"] for n, e in c["equal_evaluations"].items()}
        lines += [f"Case {c['case']} ({c['points']} points near a ball), best cost found {c['best_cost']:.8g}:", "",
                  "| swarm | evaluations | evaluations/s | sinew's over it | median cost over the best |", "|---|---|---|---|---|"]
        for table, label in (("equal_evaluations", ""), ("equal_time", ", in the time that pyswarms took")):
            for n, e in c[table].items():
                if table == "equal_time" and n != "sinew":
                    continue
                over = f"**{rate['sinew'] / e['evaluations_per_s']:.1f}**" if n in ("pyswarms", "numpy") else "-"
                lines.append(
                    f"| {n}{label} | {statistics.median(e['evaluations']):.0f} | {e['evaluations_per_s']:.3g} | {over} | "
                    f"{e['cost_median'] / c['best_cost'] - 1:.2e} |"
                )
        lines.append("")
        for n, r in rate.items():
            labels.append(f"{n}\ncase {c['case']}")
            values.append(r)
    axes.bar(range(len(values)), values, color=[COLOURS["sinew"] if l.startswith("sinew") else COLOURS["MuJoCo"] for l in labels])
    axes.set(yscale="log", ylabel="evaluations per second", title="Swarm of 41 particles, 24 tensions")
    axes.set_xticks(range(len(labels)), labels, fontsize=7)
    save(figure, out / "swarm.svg")
    lines += ["![](swarm.svg)"]


def write(out, data):
    e = data["environment"]
    lines = [
        "# Beside its peers: what was measured", "",
        f"Written by `benches/peers/run{' --quick' if e['quick'] else ''}` in {e['seconds']:.0f} s; how and why: "
        "[README.md](../README.md). Do not edit.", "",
        f"- {machine.line(e)}, {e['load_average_at_end']:.2f} at the end",
        f"- Python {e['python']}: " + ", ".join(f"{n} {v}" for n, v in e["packages"].items()),
        "- one thread each; times are the processor time of the thread", "",
    ]
    lines += headline(data)
    for name, part in (("plant", plant), ("safe", safe), ("swarm", swarm)):
        if name in data:
            part(out, data[name], lines)
    (out / "SUMMARY.md").write_text("\n".join(lines) + "\n")
