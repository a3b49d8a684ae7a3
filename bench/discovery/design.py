"""What data or a plan can show before anything is fitted, and which readings would show more: `bench design`."""

from dataclasses import dataclass
from typing import Any, final

from calibench.bench.discovery.request import DesignRequest
from calibench.bench.measured.sources import sets
from calibench.bench.words import RequestError
from calibench.core.options import coerce, declared_options, suggest
from calibench.discrepancy import MeasuredData
from calibench.discrepancy.design.detectability import Design, design
from calibench.discrepancy.design.next_poses import NextPoses, next_poses
from calibench.discrepancy.registries import description_of

_MOST_CLASSES = 6  # that are tried for one that further readings split at all
_MOST_RIVALS = 4  # of a class that next poses are asked to split


@final
@dataclass(frozen=True, eq=False)
class Designed:
    """The answer: what can be detected, and the readings that best split `further.rivals` (None: not asked)."""

    design: Design
    further: NextPoses | None
    reason: str

    def to_dict(self, machine: str) -> dict[str, Any]:
        """Return plain values for JSON."""
        said = {"schema_version": 1, "machine": machine, **self.design.to_dict()}
        return said | {"next": None if self.further is None else self.further.to_dict()}


def designed(request: DesignRequest) -> Designed:
    """Return the answer to a request. Raises `RequestError`, `DataError` or `ValueError`, in one line."""
    if request.data:
        listed = sets(request.data, request.build_machine().name, request.stated)
        if len(listed) > 1:
            raise RequestError(f"data={request.data}: names {len(listed)} sets; design looks at one")
        data = listed[0].read(request.stated)
    else:
        make, names = description_of(request.machine).plan, plan_names(request.machine)
        if make is None:
            raise RequestError(f"plan=: {request.machine} has no named plans; give data=FILE with the plan's readings")
        if request.plan not in names:
            raise RequestError(f"plan={request.plan}: {suggest(request.plan, names)}")
        for key in ("columns", "units"):
            if key in request.stated:
                raise RequestError(f"{key}=: goes with data=FILE, and plan={request.plan} has its own names")
        declared = declared_options(make)
        chosen = {**{k: v for k, v in request.stated.items() if k in declared}, **request.plan_options}
        for key in chosen:
            if key not in declared or key == "plan":
                raise RequestError(f"plan.{key}: {suggest(key, [k for k in declared if k != 'plan'])}")
        checked = {key: coerce(f"plan.{key}", value, declared[key].type) for key, value in chosen.items()}
        made = make(request.plan, **checked)
        data = MeasuredData(made.columns, made.machine, {**made.metadata, **request.stated}, made.name, made.notes)
    answer = design(request.build_machine(), data, size=request.size)
    if not request.further:
        return Designed(answer, None, "")
    if request.rivals:
        further = next_poses(request.build_machine(), data, request.rivals, request.further, request.size)
        return Designed(answer, further, "")
    best, reason = None, "no two names look alike in these data"
    for rivals in [names[:_MOST_RIVALS] for names in answer.classes if len(names) > 1][:_MOST_CLASSES]:
        try:
            best = next_poses(request.build_machine(), data, rivals, request.further, request.size)
        except ValueError as error:
            reason = str(error)
            continue
        if best.helps:
            break
    return Designed(answer, best, "" if best else reason)


def plan_names(machine: str) -> tuple[str, ...]:
    """Return the plans that can be asked for without data."""
    make = description_of(machine).plan
    return tuple(str(choice) for choice in declared_options(make)["plan"].type.__args__) if make else ()
