"""An exception that was raised in another process, as values that can be sent: the same type, text and frames here.

What cannot be sent (a class defined in a function, an argument that is an open file) comes as an exception of a type of
the same name.
"""

from __future__ import annotations

import pickle
from dataclasses import dataclass
from typing import final

from calibench.bench.gate.frames import TOLD, frames_of

_LONGEST = 100_000  # characters of a text


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
        return str(error)[:_LONGEST]
    except Exception:
        return "its text cannot be had"
