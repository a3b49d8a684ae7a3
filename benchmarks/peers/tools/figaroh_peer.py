"""FIGAROH: a robot from its URDF, parameters that the data determine, and its own least squares."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import arm6
import arms3
from answering import answer, timed

_SETTINGS = """
robot: {name: arm6, properties: {joints: {active_joints: [j1, j2, j3, j4, j5, j6]}}}
tasks:
  calibration:
    type: kinematic_calibration
    enabled: true
    joints: {active_joints: [j1, j2, j3, j4, j5, j6]}
    kinematics: {base_frame: universe, tool_frame: l7}
    parameters: {calibration_level: full_params, outlier_threshold: 0.05}
    measurements:
      markers: [{name: tool, measurable_dof: [true, true, true, false, false, false]}]
      poses: {base_pose: [0, 0, 0, 0, 0, 0], tool_pose: [0, 0, 0, 0, 0, 0]}
    data: {source_file: FILE, number_of_samples: 300}
"""


def _arm(work: Mapping[str, Any]) -> dict[str, Any]:
    import numpy as np
    import pandas as pd
    from figaroh.calibration.base_calibration import BaseCalibration
    from figaroh.calibration.calibration_tools import calc_updated_fkm
    from figaroh.tools.robot import Robot

    folder = Path(work["folder"])
    q, seen = arm6.seen()
    columns = ["x1", "y1", "z1", *(f"j{i}" for i in range(1, 7))]
    pd.DataFrame(np.hstack([seen, q]), columns=columns).to_csv(folder / "seen.csv", index=False)
    (folder / "arm6.urdf").write_text(arm6.urdf())
    (folder / "settings.yaml").write_text(_SETTINGS.replace("FILE", str(folder / "seen.csv")))

    class Arm(BaseCalibration):  # type: ignore[misc]
        def cost_function(self, var: Any) -> Any:
            there = calc_updated_fkm(self.model, self.data, var, self.q_measured, self.calib_config)
            return self.apply_measurement_weighting(self.PEE_measured - there)

    robot = Robot(str(folder / "arm6.urdf"), package_dirs=str(folder))
    found: list[Any] = []

    def calibrated() -> int:
        arm = Arm(robot, str(folder / "settings.yaml"))
        arm.calib_config.update(known_baseframe=True, known_tipframe=True)  # the file has no word for it
        arm.initialize()
        arm.solve(enable_logging=False)
        found.append(arm)
        return 1

    taken = timed(calibrated)
    arm = found[0]
    left = float(np.abs(arm.LM_result.fun).max()) * 1e3
    return {
        **taken,
        "note": f"{len(arm.LM_result.x)} parameters it chose, largest weighted residual {left:.1g}e-3, {arm.STATUS}",
    }


def _fitted(folder: str, name: str) -> Any:
    import numpy as np
    import pandas as pd
    from figaroh.calibration.base_calibration import BaseCalibration
    from figaroh.calibration.calibration_tools import calc_updated_fkm

    q, seen = arms3.read(folder, name)
    joints = [f"j{k}" for k in range(1, q.shape[1] + 1)]
    pd.DataFrame(np.hstack([seen, q]), columns=["x1", "y1", "z1", *joints]).to_csv(f"{folder}/figaroh.csv", index=False)
    settings = _SETTINGS.replace("FILE", f"{folder}/figaroh.csv").replace("l7", f"l{len(joints) + 1}")
    settings = settings.replace("number_of_samples: 300", f"number_of_samples: {len(q)}")
    Path(f"{folder}/figaroh.yaml").write_text(settings.replace("[j1, j2, j3, j4, j5, j6]", f"[{', '.join(joints)}]"))

    class Arm(BaseCalibration):  # type: ignore[misc]
        def cost_function(self, var: Any) -> Any:
            there = calc_updated_fkm(self.model, self.data, var, self.q_measured, self.calib_config)
            return self.apply_measurement_weighting(self.PEE_measured - there)

    arm = Arm(_opened(f"{folder}/{name}.urdf"), f"{folder}/figaroh.yaml")
    arm.calib_config.update(known_baseframe=True, known_tipframe=False)
    arm.initialize()
    arm.solve(enable_logging=False)
    return lambda fresh: (
        calc_updated_fkm(
            arm.model, arm.data, arm.LM_result.x, np.asarray(fresh), {**arm.calib_config, "NbSample": len(fresh)}
        )
        .reshape(3, -1)
        .T
    )


def _opened(path: str) -> Any:
    from figaroh.tools.robot import Robot

    return Robot(path, package_dirs=str(Path(path).parent))


def _arms(work: Mapping[str, Any]) -> dict[str, Any]:
    return arms3.measure(work["arms"], _fitted, _opened)


LINES: dict[str, dict[str, Callable[[Mapping[str, Any]], Mapping[str, Any]]]] = {
    "arm": {"FIGAROH": _arm},
    "arms": {"FIGAROH": _arms},
}

if __name__ == "__main__":
    answer(LINES)
