"""Drives an arm with numpy: arm, track, hold, fault, clear. `SINEW_IPC_PREFIX` and the like choose the daemon."""

import numpy as np

from sinew_arm import Arm, FaultError, Path, RefusedError, SupervisorState

with Arm("paper") as arm, arm.watch():  # a source of obstacles that sees nothing
    print("armed:", arm.arm())
    rest = arm.state()
    times = np.linspace(0, 4, 41)
    circle = np.stack([np.sin(np.pi * times / 2), 1 - np.cos(np.pi * times / 2), 0 * times], axis=1)
    path = Path.of_tip(times, rest.tip_position_m + 0.1 * circle, rest.tip_quaternion)
    track = arm.track(path, approach_s=1.0)
    print(f"tracked: the tip was off by {1e3 * np.nanmean(track.tip_error_m):.1f} mm in the mean")
    print("held:", arm.hold())
    try:
        for state in arm.tracking(path):
            if state.tip_position_m[0] > rest.tip_position_m[0] + 0.05:
                arm.emergency_stop()
    except FaultError as fault:
        print("fault:", fault)
    arm.emergency_release()
    while arm.state().supervisor is SupervisorState.FAULTED:
        try:
            arm.clear()
        except RefusedError as refused:  # the tensions are still on their way
            print(refused) if "moment" not in str(refused) else None
    print("cleared:", arm.state().supervisor)
