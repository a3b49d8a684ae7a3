"""`arm_ur10`, `arm_panda`, `arm`: calibrations of real arms, and simulated ones drawn like them (``instance=K``).

`arm_ur10`: a UR10 by a laser tracker, every so many rows of three series. `arm_panda`: a Panda whose ball sits in the
sockets of a tool; nothing is measured from outside. Both come with the package (`data/arms`, thinned, with sources and
licences). `arm`: a URDF and a CSV of one's own.
"""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal, final

from calibench.calibration.rigid import Rotation
from calibench.core.options import Range
from calibench.problems.base import Number, registry

if TYPE_CHECKING:
    from calibench.problems.arm.calibration import ArmCalibration

Robust = Annotated[float, Range(0, unit="mm, from which readings count less; 0 for none")]


def _ur10(
    series: Literal["B", "C", "D"] = "B", reads: Literal["position", "pose"] = "position", robust: Robust = 0.0,
    instance: Number = None,
) -> None:  # fmt: skip
    """The geometry of a UR10 from places or poses by a laser tracker; each fifth reading is kept back."""


def _panda(robust: Robust = 0.0, instance: Number = None) -> None:
    """The geometry of a Panda from a ball in the sockets of a tool at nine places, of which two are kept back."""


def _own(
    data: Path, urdf: Path | None = None, base: str = "", tip: str = "",
    reads: Literal["auto", "position", "pose", "sockets"] = "auto", rotation: Rotation = "", gap: float = 0.0,
    robust: Robust = 0.0, dh: Path | None = None, convention: str = "",
) -> None:  # fmt: skip
    """Declare the options of `arm`: gap [mm] is the distance of sockets 0 and 1 of a place, 0 where it is not known.

    `urdf`, or `dh`, a table of joints in the `convention` standard or modified, describes the arm.
    """


@final
class ShippedFamily:
    """An arm whose readings come with the package, or one drawn like it."""

    def __init__(self, name: str, about: str | None) -> None:
        self.name, self.__doc__ = name, about

    def __call__(self, **options: Any) -> ArmCalibration:
        """Build the problem with `options` (those of ``bench list problems``)."""
        chosen = registry.complete(self.name, options)
        from calibench.problems.arm import build  # here, as the names of all problems are listed in every start

        if chosen["instance"] is None:
            del chosen["instance"]
            return build.of_shipped(self.name, tuple(sorted(chosen.items())))
        if options.get("series") is not None:
            raise ValueError(
                f"{self.name}.series={options['series']}: instance={chosen['instance']} is simulated and of no "
                "series; leave one of the two out"
            )
        chosen |= {"series": None} if "series" in chosen else {}  # so rows say: of none
        return build.simulated(self.name, tuple(sorted(chosen.items())))


@final
class ArmFamily:
    """The geometry of one's own arm from its URDF, or a table of its joints, and a CSV file of measured postures."""

    name = "arm"

    def __call__(self, **options: Any) -> ArmCalibration:
        """Build the problem with `options` (those of ``bench list problems``)."""
        chosen = registry.complete(self.name, options)
        for key in ("dh", "convention"):  # so rows say nothing of a table where there is none
            if not chosen[key]:
                del chosen[key]
        urdf, dh = chosen["urdf"], chosen.get("dh")
        if urdf is None and dh is None:
            raise ValueError("arm needs its description: problem.urdf=my.urdf, or problem.dh=table.csv")
        if urdf is not None and dh is not None:
            raise ValueError("problem.urdf= and problem.dh= both describe the arm; give one")
        if "convention" in chosen and dh is None:
            raise ValueError("problem.convention= is that of a table; state problem.dh= too, or leave it out")
        if dh is not None and (chosen["base"] or chosen["tip"]):
            raise ValueError("problem.base= and problem.tip= are links of a URDF; a table has none: leave them out")
        from calibench.problems.arm import build  # here, as the names of all problems are listed in every start

        return build.of_own(chosen, Path(urdf if dh is None else dh))


arm_ur10, arm_panda = ShippedFamily("arm_ur10", _ur10.__doc__), ShippedFamily("arm_panda", _panda.__doc__)
arm = ArmFamily()
registry.register("arm_ur10", options=_ur10)(arm_ur10)
registry.register("arm_panda", options=_panda)(arm_panda)
registry.register("arm", options=_own)(arm)


def shipped(name: str) -> Path:
    """Return the file of a table or URDF that comes with the package."""
    return Path(__file__).resolve().parents[1] / "data" / "arms" / name
