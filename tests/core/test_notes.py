"""Notes are values: told apart by their codes, each of which is documented, and written to JSON whole."""

import json
import pickle

from calibench.core.notes import Code, DataError, Note, once
from calibench.core.plain import finite


def test_every_code_is_a_word_of_its_own_with_a_meaning() -> None:
    assert all(code.value.replace("_", "").isalpha() and code.meaning for code in Code)
    assert len({code.meaning for code in Code}) == len(Code)


def test_a_note_is_an_object_in_json() -> None:
    note = Note(Code.JOINT_SHIFTED, "90° are added to joint elbow", ("q2",), ("row 3",), {"degrees": 90})
    written = json.loads(json.dumps(note.to_dict()))
    assert written == {
        "code": "joint_shifted", "text": "90° are added to joint elbow", "columns": ["q2"], "rows": ["row 3"],
        "values": {"degrees": 90},
    }  # fmt: skip
    assert json.loads(json.dumps(finite(note))) == written
    assert str(note) == note.text


def test_notes_with_the_same_words_stand_once() -> None:
    one, same, other = Note(Code.FILE, "a"), Note(Code.FILE, "a"), Note(Code.FILE, "b")
    assert once([one, other, same]) == (one, other)


def test_a_refusal_keeps_its_note_between_processes() -> None:
    error = DataError("x are metres", Note(Code.POSITION_UNIT, "x are metres"))
    assert pickle.loads(pickle.dumps(error)).note == error.note
    assert DataError("x").note is None
