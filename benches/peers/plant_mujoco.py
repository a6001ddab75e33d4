"""The arm in MuJoCo: rigid links, a joint of three hinges at the middle of each element, spatial tendons.

Every link carries one node's mass and inertia, a disk with its holes as sites. The joint at the middle of an element
is what a chain needs to approximate a beam to second order; three hinges through one point are a ball joint whose
torsional spring may differ from the bending ones (a ball joint has one stiffness for all three). Bending, torsion and
their damping are joint springs and dampers, cables are spatial tendons pulled by force actuators. Contacts and
constraints are off. All steps of a run are taken inside one call of `mujoco.rollout`: no Python between steps.
"""

import time

import mujoco
import numpy as np
from mujoco import rollout

import tension_trace as trace

INTEGRATORS = {
    "Euler": mujoco.mjtIntegrator.mjINT_EULER,
    "implicitfast": mujoco.mjtIntegrator.mjINT_IMPLICITFAST,
    "implicit": mujoco.mjtIntegrator.mjINT_IMPLICIT,
    "discrete": mujoco.mjtIntegrator.mjINT_DISCRETE,
    "RK4": mujoco.mjtIntegrator.mjINT_RK4,
}


def xml(arm):
    nodes, elements = arm["nodes"], arm["elements"]
    holes = {}  # node (0 is the base) -> cable -> offset along the link
    for c, cable in enumerate(arm["cables"]):
        first, end = cable["elements"]
        holes.setdefault(first, []).append((c, elements[first]["connector"]))
        for i in range(first, end):
            holes.setdefault(i + 1, []).append((c, 0.0))
    starts = {(c, cable["elements"][0]) for c, cable in enumerate(arm["cables"])}

    def sites(node):
        text = ""
        for c, offset in holes.get(node, []):
            y, z = arm["cables"][c]["hole"][1:]
            kind = "s" if (c, node) in starts else "h"
            text += f'<site name="{kind}{c}_{node}" pos="{offset!r} {y!r} {z!r}"/>\n'
        return text

    body = sites(0)
    depth = 0
    for i, (node, e) in enumerate(zip(nodes, elements)):
        half = e["length"] / 2
        at = e["connector"] + half
        # The body's frame is at its node; the joint lies half an element before it.
        body += f'<body name="n{i + 1}" pos="{at + half!r} 0 0">\n'
        for axis, stiffness in zip(("0 1 0", "0 0 1", "1 0 0"), (e["stiffness"][1], e["stiffness"][2], e["stiffness"][0])):
            k = stiffness / e["length"]
            body += (
                f'<joint type="hinge" pos="{-half!r} 0 0" axis="{axis}" stiffness="{k!r}" '
                f'damping="{k * e["damping"]!r}"/>\n'
            )
        inertia = " ".join(repr(v) for v in node["inertia"])
        body += f'<inertial pos="0 0 0" mass="{node["mass"]!r}" diaginertia="{inertia}"/>\n'
        body += sites(i + 1)
        depth += 1
    body += '<site name="tip" pos="0 0 0"/>\n' + "</body>\n" * depth
    tendons = actuators = ""
    for c, cable in enumerate(arm["cables"]):
        first, end = cable["elements"]
        path = f'<site site="s{c}_{first}"/>' + "".join(f'<site site="h{c}_{i + 1}"/>' for i in range(first, end))
        tendons += f'<spatial name="t{c}">{path}</spatial>\n'
        # A positive control shortens the tendon.
        actuators += f'<motor tendon="t{c}" gear="-1"/>\n'
    w, x, y, z = arm["base_quaternion"]
    return f"""<mujoco model="arm">
<compiler autolimits="true" boundinertia="0" boundmass="0"/>
<option gravity="0 0 0"><flag contact="disable" constraint="disable" energy="disable"/></option>
<worldbody><body name="base" quat="{w!r} {x!r} {y!r} {z!r}">
{body}</body></worldbody>
<tendon>{tendons}</tendon>
<actuator>{actuators}</actuator>
<sensor><framepos objtype="site" objname="tip"/></sensor>
</mujoco>"""


class Plant:
    def __init__(self, arm):
        self.arm = arm
        self.model = mujoco.MjModel.from_xml_string(xml(arm))
        self.data = mujoco.MjData(self.model)

    def run(self, integrator, step_s, duration_s=trace.DURATION_S, sample_s=trace.SAMPLE_S):
        """Tip at the samples, processor time of the steps alone (s)."""
        m, d = self.model, self.data
        m.opt.integrator = INTEGRATORS[integrator]
        m.opt.timestep = step_s
        mujoco.mj_resetData(m, d)
        state = np.zeros(mujoco.mj_stateSize(m, mujoco.mjtState.mjSTATE_FULLPHYSICS))
        mujoco.mj_getState(m, d, state, mujoco.mjtState.mjSTATE_FULLPHYSICS)
        # One step more: a sensor is read at the start of its step.
        steps = round(duration_s / step_s) + 1
        # A control is held for a step: its middle is its best sample.
        control = trace.tensions(self.arm, (np.arange(steps) + 0.5) * step_s)
        sensor = np.zeros((1, steps, m.nsensordata))
        states = np.zeros((1, steps, state.size))
        begin = time.thread_time()
        rollout.rollout(m, d, state[None], control[None], state=states, sensordata=sensor)
        seconds = (time.thread_time() - begin) * (steps - 1) / steps
        each = round(sample_s / step_s)
        tip = sensor[0, each::each, :3]
        if not np.isfinite(tip).all() or d.warning[mujoco.mjtWarning.mjWARN_BADQACC].number:
            return None, seconds, steps - 1
        return tip, seconds, steps - 1
