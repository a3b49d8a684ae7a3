"""`valid` and `split`: every door that reads a table knows the same words, and refuses all others."""

import numpy as np
import pytest

from calibench.bench.calibration.request import read_table
from calibench.calibration.readings import read_readings
from calibench.calibration.urdf import read_urdf
from calibench.core.tables.cells import split_rows, valid_rows
from calibench.discrepancy import MeasuredData
from calibench.discrepancy.checks.validate import entered
from calibench.problems.arm.build import read_measured
from tests.bench.arm_by_hand import measured, table, urdf

ROWS = 40


def test_a_cell_that_is_empty_marks_no_row_as_valid_and_holds_none_back():
    assert valid_rows(["", "nan", "None"]).tolist() == [False, False, False]
    assert split_rows(np.array(["", None, " Hold "], dtype=object)).tolist() == ["", "", "hold"]


def searched(file, column, words):
    data = entered(MeasuredData({"y": np.arange(float(ROWS)), column: np.array(words)}, "table"))
    return len(data), int((data["split"] == "hold").sum()) if "split" in data else 0


def calibrated(file, column, words):
    chain = read_urdf(file.with_name("my.urdf")).chain()
    read = read_readings(read_table(str(file), {}), chain)
    return len(read), 0 if read.hold is None else int(read.hold.sum())


def optimised(file, column, words):
    read = read_measured(file, read_urdf(file.with_name("my.urdf")).chain()).readings
    return len(read), int((~read.train).sum())


@pytest.mark.parametrize("door", [searched, calibrated, optimised])
@pytest.mark.parametrize(
    ("column", "words", "counts"),
    [
        ("valid", ["ok"] * 36 + ["no"] * 4, (36, 0)),
        ("valid", ["Y"] * 40, (40, 0)),
        ("split", ["Train"] * 30 + ["HOLD"] * 10, (40, 10)),
        (
            "valid",
            ["true"] * 39 + ["maybe"],
            r"column valid holds 'maybe'; true or false \(1 or 0, yes or no",
        ),
        ("split", ["train"] * 39 + ["check"], "column split holds 'check'; train \\(fitted\\) or hold"),
    ],
)
def test_every_door_knows_the_same_words(tmp_path, door, column, words, counts):
    q, seen, _ = measured(ROWS)
    (tmp_path / "my.urdf").write_text(urdf())
    lines = zip(table(q, seen).splitlines(), [column, *words], strict=True)
    (tmp_path / "my.csv").write_text("\n".join(map(",".join, lines)))
    if isinstance(counts, str):
        with pytest.raises(ValueError, match=counts):
            door(tmp_path / "my.csv", column, words)
    else:
        assert door(tmp_path / "my.csv", column, words) == counts
