import numpy as np
import pandas as pd
import pyarrow as pa
import pytest

from calibench.bench.statistics.summary import goal_hits, goals_of
from calibench.bench.store.arrays import lists_of, to_pandas


def test_lists_are_read_as_python_reads_them():
    told = [[3.0, 1.0], [], None, [2.0]]
    for column in (pd.Series(told), pa.chunked_array([told[:1], told[1:]], pa.list_(pa.float64()))):
        found = lists_of(column)
        assert found.count.tolist() == [2, 0, 0, 1]
        assert found.flat.tolist() == [3.0, 1.0, 2.0]
        np.testing.assert_array_equal(found.last, [1.0, np.nan, np.nan, 2.0])
    assert lists_of(pd.Series([[], []])).last.shape == (2,)


def test_runs_with_the_same_list_are_taken_together():
    found = lists_of(pd.Series([[3.0, 1.0], [2.0], [3.0, 1.0]]))
    together = [(listed.tolist(), at.tolist()) for listed, at in found.alike(np.arange(3))]
    assert together == [([3.0, 1.0], [0, 2]), ([2.0], [1])]


def test_the_goal_is_read_of_all_runs_as_of_one():
    runs = pd.DataFrame(
        {
            "target": [np.nan, 1.0, np.nan, 5.0, np.nan],
            "targets": [[10.0, 0.1], [10.0, 1.0, 0.1], [], [5.0], [10.0, 0.1]],
            "hits_charged": [[7, None], [7, 9, None], [], [3], [7, 12]],
            "status": ["ok", "timeout", "ok", "failed", "ok"],
        }
    )
    np.testing.assert_array_equal(goals_of(runs), [0.1, 1.0, np.nan, 5.0, 0.1])
    np.testing.assert_array_equal(goal_hits(runs), [np.nan, 9.0, np.nan, np.nan, 12.0])


@pytest.mark.parametrize("chunks", [0, 1, 2])
def test_text_is_the_same_object_wherever_it_is_equal(chunks):
    one = pa.array(["long options", None, "long options"])
    table = pa.table(
        {"text": pa.chunked_array([one] * chunks, pa.string()), "n": pa.chunked_array([[1, 2, 3]] * chunks, pa.int64())}
    )
    frame = to_pandas(table)
    assert frame["text"].dtype == "str"
    assert frame["text"].isna().tolist() == [False, True, False] * chunks
    assert len({id(text) for text in frame["text"].dropna()}) == min(chunks, 1)
    assert list(frame.columns) == ["text", "n"]
    assert len(frame) == 3 * chunks
