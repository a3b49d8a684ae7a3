"""Why a run ended: the words of `stop_reason`, and what is kept of an exception.

`STOP_REASONS` lists the words, here and nowhere else; a new one is set where it happens (in the gate, as
`Evaluator.stopped`, or in `calibench.bench.execution.row_of`), and told in docs/results.md.

Of a failure a row keeps the last frames. A user looks for it in his own code first: if that has a frame, those of this
package are left out, except the one that raised, and frames of libraries before those of the user where there are too
many. An exception of another process comes as values that can be sent (`ToldError`): the same type, text and frames;
what cannot be sent, such as a class defined in a function, as an exception of a type of the same name.
"""

from __future__ import annotations

import pickle
from dataclasses import dataclass
from pathlib import Path
from traceback import FrameSummary, StackSummary, extract_tb, format_list
from typing import Literal, final, get_args

from calibench.core.sources import is_local, is_ours

ByGate = Literal["budget", "target", "timeout"]  # the gate refused a call: the run would have gone on
StopReason = Literal["converged", "budget", "target", "failed", "timeout"]

BY_GATE: tuple[ByGate, ...] = get_args(ByGate)
STOP_REASONS: tuple[StopReason, ...] = get_args(StopReason)


TOLD = "__calibench_frames__"  # attribute of an exception that was raised in another process: its frames there, as text
_FRAMES = 10
_LONGEST = 4_000  # characters of a traceback in a row
_LINE = 300  # of one frame
_LONGEST_TEXT = 10_000  # of an error in a row


def text_of(error: BaseException) -> str:
    """Return the text of an exception as a row can hold it, whatever foreign code made of it."""
    try:
        text = str(error)
    except Exception:
        text = "its text cannot be had"
    return text.encode("utf-8", "replace").decode()[:_LONGEST_TEXT]


def frames_of(error: BaseException | None) -> str:
    """Return the last frames of `error` and of what caused it, innermost last; '' where there are none."""
    parts: list[str] = []
    seen: set[int] = set()
    while error is not None and id(error) not in seen:
        seen.add(id(error))
        text = getattr(error, TOLD, "") or _frames(extract_tb(error.__traceback__))
        if text:
            parts.append(text if not parts else f"{text}{type(error).__name__}, which led to:\n")
        error = error.__cause__ or (None if error.__suppress_context__ else error.__context__)
    text = "".join(reversed(parts)).encode("utf-8", "replace").decode()
    return text if len(text) <= _LONGEST else "...\n" + text[-_LONGEST:]


def place_of(error: BaseException) -> str:
    """Return the file and the line of the user's own code that led to an error, in words; "" where it has none."""
    users = [frame for frame in extract_tb(error.__traceback__) if _is_users(frame)]
    return f"{Path(users[-1].filename).name}, line {users[-1].lineno}" if users else ""


def _frames(stack: StackSummary) -> str:
    frames = list(stack)
    users = [i for i, frame in enumerate(frames) if _is_users(frame)][-_FRAMES:]
    last = len(frames) - 1
    others = [i for i, frame in enumerate(frames) if i not in users and (not users or i == last or not _is_ours(frame))]
    room = _FRAMES - len(users)
    kept = {*users, *others[len(others) - room :]} if room < len(others) else {*users, *others}
    lines, left = [], 0
    for i, frame in enumerate(frames):
        if i not in kept:
            left += 1
            continue
        if left:
            lines.append(f"  ... {left} left out\n")
            left = 0
        lines.append("\n".join(line[:_LINE] for line in format_list([frame])[0].splitlines()[:2]) + "\n")
    return "".join(lines)


def _is_users(frame: FrameSummary) -> bool:
    """Tell whether a frame is neither of this package, nor of the standard library, nor of what is installed."""
    return not frame.filename.startswith("<frozen") and is_local(Path(frame.filename).resolve()) and not _is_ours(frame)


def _is_ours(frame: FrameSummary) -> bool:
    return is_ours(Path(frame.filename).resolve())


_LONGEST_SENT = 100_000  # characters of a text


@final
@dataclass(frozen=True)
class ToldError:
    """The exception pickled (None where that is not possible), the name of its type, its text, and its frames."""

    pickled: bytes | None
    kind: str
    text: str
    frames: str

    @staticmethod
    def of(error: BaseException) -> ToldError:
        """Return what is told of `error`."""
        text = _text(error)
        pickled = None
        try:
            raw = pickle.dumps(error)
            twin = pickle.loads(raw)
            if type(twin) is type(error) and _text(twin) == text:
                pickled = raw
        except Exception:  # whatever foreign classes do in it
            pass
        return ToldError(pickled, type(error).__name__, text, frames_of(error))

    def rebuilt(self) -> BaseException:
        """Return the exception, to be raised here."""
        error: BaseException | None = None
        if self.pickled is not None:
            try:
                error = pickle.loads(self.pickled)
            except Exception:  # its module is known only there
                error = None
        if error is None:
            error = type(self.kind, (Exception,), {})(self.text)
        setattr(error, TOLD, self.frames)
        return error


def _text(error: BaseException) -> str:
    try:
        return str(error)[:_LONGEST_SENT]
    except Exception:
        return "its text cannot be had"
