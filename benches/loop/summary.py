"""Summary of benches/loop/run: deadlines, times of each stage, and cyclictest beside them, from the raw data in a folder."""

import json
import sys
from pathlib import Path

sys.path.append(str(Path(__file__).resolve().parent.parent))
import machine

out, rates = Path(sys.argv[1]), [int(r) for r in sys.argv[2:]]
#: Share of deadlines that may be missed.
PERMITTED = {1000: 1e-3}
#: Largest tip error (mm) of an arm that tracks all the time; one that held meanwhile, for clients that were late, is far off.
TIP_MM_MAX = 17.0
#: `cycle` ends when the torques have left; `report` is what follows, and what the next tick waits for.
STAGES = ["wakeup", "input", "estimate", "plan", "guard", "send", "cycle", "report"]


def load(name):
    path = out / name
    text = path.read_text() if path.exists() else ""
    return json.loads(text) if text.strip() else None


def cyclic(name, period_us, work_us):
    """Cycles, percentiles (us) and deadlines that a loop with so much work would miss, of cyclictest's histogram: a wake-up
    of delay L leaves out floor(L / period) ticks, and its own overruns if the rest of the period is shorter than the work."""
    data = load(name)
    if data is None:
        return None
    thread = next(iter(data["thread"].values()))
    counts = sorted((int(us), n) for us, n in thread["histogram"].items())
    cycles = thread["cycles"]

    def at(quantile):
        seen = 0
        for us, n in counts:
            seen += n
            if seen >= quantile * cycles:
                return us
        return thread["max"]

    missed = sum(n * (us // period_us + (us % period_us + work_us > period_us)) for us, n in counts)
    # What lies beyond the histogram is told by its number and the maximum only.
    missed += max(0, cycles - sum(n for _, n in counts)) * (thread["max"] // period_us)
    return {"cycles": cycles, "p50": at(0.5), "p99": at(0.99), "p999": at(0.999), "max": thread["max"], "missed": int(missed)}


lines, failed = [], []
m = load("machine.json")
lines += [
    "# The loop in real time, beside cyclictest",
    "",
    f"`benches/loop/run` of commit {m['commit']}{machine.changed_note(m['commit'])} on {m['date']} ({m['profile']} profile, "
    f"{m['rustc']}): tip example, {m['seconds']:g} s, plant, "
    f"clients and daemon on the virtual bus (four buses, CAN FD, packed), plant's mesh {m['plant_mesh_refinement']} times as fine.",
    f"{m['processor']}, {m['processors']} processors{' of a virtual machine' if m['hypervisor'] else ''}, Linux {m['kernel']} "
    f"({m['preemption']}), load {m['load_average']:.2f} before; control thread alone on processor {m['control_cpu']}, SCHED_FIFO 80.",
    "Times in us.",
]
for rate in rates:
    run, status, beside = load(f"{rate}-run.json"), load(f"{rate}-status.json"), load(f"{rate}-beside.json")
    period_us = 1e6 / rate
    lines += ["", f"## {rate} Hz", ""]
    if beside["exit_code"] != 0 or run is None or status is None:
        failed.append(f"{rate} Hz: the run ended with {beside['exit_code']}: {(run or {}).get('faults')}")
        lines += [failed[-1]]
        if run is None or status is None:
            continue
    ticks = status["ticks"]
    missed = status["missed"]
    share = missed / ticks
    error = run["tip_error_m"]
    nearest = min(o["surface_distance_min_m"] for o in run["obstacles"])
    lines += [
        f"- deadlines missed: **{missed} of {ticks} ({100 * share:.4f} %)**: {status['left_out']} left out because the loop woke too "
        f"late, {status['overran']} overran",
        f"- tip error mean {1e3 * error['norm_mean']:.2f}, max {1e3 * error['norm_max']:.2f} mm; nearest obstacle {1e3 * nearest:.1f} mm; "
        f"faults {run['faults'] or 'none'}; records dropped {status['records_dropped']}",
        f"- {beside['plant']}",
    ]
    if beside["processors"]:
        stolen = ", ".join(f"{cpu} {100 * p['steal']:.2f} %" for cpu, p in beside["processors"].items() if cpu != "cpu")
        lines += [f"- taken by the host meanwhile: {stolen}"]
    control = next((t for t in status["threads"] if t["name"] == "sinew-control"), None)
    if control:
        lines += [
            f"- control thread: {control['scheduling']} on {control['cpus']}, ran {control['run_s']:.1f} s, waited "
            f"{control['wait_s']:.3f} s for its processor, {control['faults_minor'] + control['faults_major']} page faults, "
            f"preempted {control['switches_involuntary']} times"
        ]
    lines += [f"- refused: {r}" for r in status["realtime_refused"]]
    # What the machine's own wake-ups would cost a loop with the median cycle's work, beside what this one missed.
    work_us = status["time_us"]["warning"]["cycle"]["p50"]
    beside_us = [cyclic(f"{rate}-cyclictest-{name}.json", period_us, work_us) for name in ["before", "after"]]
    total = sum(c["cycles"] for c in beside_us)
    lines += [
        f"- cyclictest's wake-ups in the same minutes, with {work_us:.0f} us of work after each: "
        f"{sum(c['missed'] for c in beside_us)} of {total} missed ({100 * sum(c['missed'] for c in beside_us) / total:.4f} %)",
        "",
        "| | count | p50 | p99 | p99.9 | max | missed |",
        "|---|---|---|---|---|---|---|",
    ]
    for name, c in zip(["before", "after"], beside_us):
        lines += [f"| cyclictest {name} | {c['cycles']} | {c['p50']} | {c['p99']} | {c['p999']} | {c['max']} | {c['missed']} |"]
    for branch, stages in status["time_us"].items():
        for stage in STAGES:
            s = stages[stage]
            lines += [f"| {branch}: {stage} | {s['count']} | {s['p50']:.1f} | {s['p99']:.1f} | {s['p999']:.1f} | {s['max']:.1f} | |"]
    if 1e3 * error["norm_max"] > TIP_MM_MAX or run["loop"] is None:
        failed.append(f"{rate} Hz: the tip did not follow: {1e3 * error['norm_max']:.1f} mm at most")
    if share > PERMITTED.get(rate, 0.0):
        failed.append(f"{rate} Hz: {100 * share:.4f} % of the deadlines missed, permitted {100 * PERMITTED.get(rate, 0.0):g} %")

lines += ["", "**Missed:** " + "; ".join(failed) if failed else "All within bounds."]
text = "\n".join(lines) + "\n"
(out / "summary.md").write_text(text)
print(text)
sys.exit(1 if failed else 0)
