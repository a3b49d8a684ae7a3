"""Why a run ended: the words of `stop_reason`, listed here and nowhere else, and what is kept of an exception.

Of a failure a row keeps the last frames. A user looks for it in his own code first: if that has a frame, those of this
package are left out, except the one that raised. An exception of another process comes as values that can be sent
(`ToldError`); what cannot be sent, such as a class defined in a function, as one of a type of the same name.
"""

from __future__ import annotations

import pickle
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from traceback import FrameSummary, extract_tb, format_list
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


def text_of(error: BaseException, longest: int = _LONGEST_TEXT) -> str:
    """Return the text of an exception as a row can hold it, whatever foreign code made of it."""
    try:
        text = str(error)
    except Exception:
        text = "its text cannot be had"
    return text.encode("utf-8", "replace").decode()[:longest]


def frames_of(error: BaseException | None) -> str:
    """Return the last frames of `error` and of what caused it, innermost last; '' where there are none."""
    parts: list[str] = []
    seen: set[int] = set()
    while error is not None and id(error) not in seen:
        seen.add(id(error))
        text = getattr(error, TOLD, "") or ""
        if not text:
            frames = list(extract_tb(error.__traceback__))
            ours = {i for i, frame in enumerate(frames) if is_ours(Path(frame.filename).resolve())}
            users = [i for i, frame in enumerate(frames) if i not in ours and _is_users(frame)][-_FRAMES:]
            ends = {len(frames) - 1} | ({*range(len(frames))} - ours)
            others = [i for i in range(len(frames)) if i not in users and (not users or i in ends)]
            after = 0
            for i in sorted([*users, *others[max(len(others) - _FRAMES + len(users), 0) :]]):
                text += f"  ... {i - after} left out\n" if i > after else ""
                text += "\n".join(line[:_LINE] for line in format_list([frames[i]])[0].splitlines()[:2]) + "\n"
                after = i + 1
        if text:
            parts.append(text if not parts else f"{text}{type(error).__name__}, which led to:\n")
        error = error.__cause__ or (None if error.__suppress_context__ else error.__context__)
    text = "".join(reversed(parts)).encode("utf-8", "replace").decode()
    return text if len(text) <= _LONGEST else "...\n" + text[-_LONGEST:]


def place_of(error: BaseException) -> str:
    """Return the file and the line of the user's own code that led to an error, in words; "" where it has none."""
    users = [frame for frame in extract_tb(error.__traceback__) if _is_users(frame)]
    return f"{Path(users[-1].filename).name}, line {users[-1].lineno}" if users else ""


def _is_users(frame: FrameSummary) -> bool:
    """Tell whether a frame is neither of this package, nor of the standard library, nor of what is installed."""
    path = Path(frame.filename).resolve()
    return not frame.filename.startswith("<frozen") and is_local(path) and not is_ours(path)


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
        text, pickled = text_of(error, _LONGEST_SENT), None
        with suppress(Exception):  # whatever foreign classes do in it
            raw = pickle.dumps(error)
            twin = pickle.loads(raw)
            if type(twin) is type(error) and text_of(twin, _LONGEST_SENT) == text:
                pickled = raw
        return ToldError(pickled, type(error).__name__, text, frames_of(error))

    def rebuilt(self) -> BaseException:
        """Return the exception, to be raised here."""
        error: BaseException = type(self.kind, (Exception,), {})(self.text)
        if self.pickled is not None:
            with suppress(Exception):  # its module is known only there
                error = pickle.loads(self.pickled)
        setattr(error, TOLD, self.frames)
        return error
