"""How a law is told to be broken: one line with the law, what was found, and what to do."""

from collections.abc import Callable, Sequence
from contextlib import suppress
from functools import partial
from pathlib import Path
from time import perf_counter
from traceback import extract_tb
from typing import Any

from calibench.bench.gate.processes import CAN_FORK, Sender, exit_of, forked

TIME_LIMIT = 60.0  # seconds for all laws of an object
MOST_NUMBERS = 1_000_000  # of all points of a law together: 8 MB, of which some ten copies are made
_MEMORY = 10**9  # bytes that the child may take beyond what is there: an object's own, and .2 GB of the laws'
Law = Callable[..., None]
Checks = list[tuple[str, Callable[[], None]]]


def require(kept: object, law: str, finding: object, remedy: str) -> None:
    """Raise `AssertionError` of one line unless the law is kept."""
    if not kept:
        raise AssertionError(" ".join(f"{law}; found {finding}; {remedy}".split()))


def checks_of(laws: Sequence[Law], *subject: Any) -> Checks:
    """Return (name, check) for each of `laws`; ``check()`` raises `AssertionError` where its law is broken."""
    return [(law.__name__, partial(_check, law, *subject)) for law in laws]


def keep_all(checks: Callable[[], Checks], time_limit: float) -> None:
    """Do all `checks` in a forked child; raise `AssertionError` for the first that is broken, or not done in time.

    What hangs, or takes a gigabyte, does so there. Where a system cannot fork, they are done here without a limit.
    """
    if not CAN_FORK:
        for _, check in checks():
            check()
        return

    def work(theirs: Sender) -> None:
        import resource

        with suppress(OSError, ValueError):  # where a system tells how much this process has, it may take some more
            now = int(Path("/proc/self/statm").read_text().split()[5]) * resource.getpagesize()
            resource.setrlimit(resource.RLIMIT_DATA, (now + _MEMORY, resource.getrlimit(resource.RLIMIT_DATA)[1]))
        theirs.send(("law", "what is needed to begin", None))
        try:
            for name, check in checks():
                theirs.send(("law", name, None))
                check()
        except BaseException as error:  # whatever foreign code raises, SystemExit too
            message = str(error) if isinstance(error, AssertionError) else f"{type(error).__name__}: {error}"
            try:
                theirs.send(("broken", message, error.__context__))
            except Exception:  # it cannot be pickled
                theirs.send(("broken", message, None))
        else:
            theirs.send(("kept", "", None))

    law, end = "", perf_counter() + time_limit
    with forked(work) as (child, ours):
        while ours.poll(max(0.0, end - perf_counter())):
            try:
                what, message, raised = ours.recv()
            except EOFError:
                remedy = "call the law alone to see where"
                require(False, law, f"its process ended with {exit_of(child.exitcode)}", remedy)
            if what == "broken":
                broken = AssertionError(message)
                broken.__context__ = raised
                raise broken
            if what == "kept":
                return
            law = message
    require(
        False, f"the laws are tried within {time_limit:g} s", f"{law} not at its end",
        "take a smaller or a faster object, or give time_limit=SECONDS",
    )  # fmt: skip


def _check(law: Law, *subject: Any) -> None:
    """Run a law; what is checked may raise whatever it likes, and is told in a line all the same."""
    try:
        law(*subject)
    except AssertionError:
        raise
    except Exception as error:
        asked = (law.__doc__ or law.__name__).partition("\n")[0].rstrip(".")
        place = extract_tb(error.__traceback__)[-1]
        where = f"{Path(place.filename).name}, line {place.lineno}: {place.line}"
        require(False, asked, f"{type(error).__name__}: {error}", f"it was raised in {where}")
