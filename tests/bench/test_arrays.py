"""Arrow's arrays without pandas: what `pa.array` makes of the same values, refusals included."""

import math

import numpy as np
import pandas as pd
import pyarrow as pa
import pyarrow.compute as pc
import pytest
from hypothesis import given, settings, strategies as st

from calibench.bench.store import arrays
from calibench.bench.store.arrays import (
    PART_SCHEMA,
    RUNS_SCHEMA,
    array_of,
    empty_table,
    indices,
    mask_of,
    numbers,
    to_pandas,
)
from calibench.bench.store.columns import floats, known, numbered, plain, true

WHOLE = st.integers(-(2**63), 2**63 - 1)
KINDS = {
    pa.string(): st.text(),
    pa.int64(): WHOLE,
    pa.int32(): st.integers(-(2**31), 2**31 - 1),
    pa.float64(): st.floats(),
    pa.bool_(): st.booleans(),
    pa.timestamp("us", tz="UTC"): st.integers(-(2**55), 2**55),
    pa.struct([("name", pa.string()), ("weight", pa.float64())]): st.fixed_dictionaries(
        {"name": st.text()}, optional={"weight": st.none() | st.floats(), "more": st.booleans()}
    ),
}


@st.composite
def columns(draw):
    kind = draw(st.sampled_from(list(KINDS)))
    values = st.none() | KINDS[kind]
    if draw(st.booleans()):
        return pa.list_(kind), draw(st.lists(st.none() | st.lists(values, max_size=4), max_size=9))
    return kind, draw(st.lists(values, max_size=20))


@settings(deadline=None)  # the first call loads pandas
@given(columns())
def test_values_become_the_array_that_arrow_makes_of_them(column):
    kind, values = column
    found, theirs = array_of(values, kind), pa.array(values, kind)
    found.validate(full=True)
    assert found.type == theirs.type
    assert found.null_count == theirs.null_count
    assert repr(found.to_pylist()) == repr(theirs.to_pylist())


@pytest.mark.parametrize(
    ("values", "kind"),
    [([1, 2.5], pa.float64()), ([True], pa.int64()), ([1.5], pa.int64()), ([2**63], pa.int64()), (["a"], pa.int64()),
     ([2**60 + 1], pa.float64()), ([1], pa.string()), ([[1], 2], pa.list_(pa.int64())), ([{}], pa.string()),
     (["\ud800"], pa.string())],
)  # fmt: skip
def test_what_is_of_another_kind_is_converted_or_refused_as_arrow_does(values, kind):
    def outcome(make):
        try:
            return repr(make(values, kind).to_pylist())
        except (ValueError, TypeError, OverflowError, pa.ArrowException) as error:
            return type(error)

    assert outcome(array_of) == outcome(pa.array)


@given(st.lists(st.none() | st.floats(allow_nan=False)))
def test_numbers_come_back_with_what_stands_for_null(values):
    found = numbers(pa.chunked_array([array_of(values, pa.float64())]), np.nan)
    assert [None if math.isnan(x) else x for x in found] == values


def test_parts_of_arrays_and_tables_without_rows_are_read_too():
    assert numbers(array_of([1, 2, 3], pa.int64()).slice(1)).tolist() == [2, 3]
    assert numbers(pa.chunked_array([], pa.int64())).tolist() == []
    assert indices([2, 0]).to_pylist() == [2, 0]
    assert mask_of(np.arange(11) % 3 == 0).to_pylist() == [i % 3 == 0 for i in range(11)]
    assert empty_table(PART_SCHEMA).equals(PART_SCHEMA.empty_table())


def test_columns_are_read_alike_from_arrow_and_from_pandas():
    row = {"run_id": "a", "restarts": 2, "target": 1.5, "inside_box": True, "minimum": -0.5, "unit": "V"}
    table = pa.Table.from_pylist([row, {"run_id": "b", "target": float("nan"), "inside_box": False}, {}], RUNS_SCHEMA)
    frame = to_pandas(table)
    for name in row:
        assert plain(table[name]) == plain(frame[name]) == plain(plain(frame[name])), name
        assert known(table[name]).tolist() == known(frame[name]).tolist(), name
    for name in ("restarts", "target", "minimum"):
        np.testing.assert_array_equal(floats(table[name]), floats(frame[name]))
    assert true(table["inside_box"]).tolist() == true(frame["inside_box"]).tolist() == [True, False, False]
    assert numbered([table["target"], table["unit"]]).tolist() == [0, 1, 1]


def test_functions_of_columns_say_what_pyarrow_says():
    texts = pa.chunked_array([["b", None, "a"], ["b", "c"]])
    known, flat = pa.array(["b", "c"]), texts.combine_chunks()
    lists = pa.array([[1, 2], None, [], [3]])
    table = pa.table({"text": texts, "number": [3, 1, 2, 1, 0]})
    flags = pa.array([True, False, None, True, True])
    same = [
        (arrays.index_in(texts, known), pc.index_in(texts, value_set=known)),
        (arrays.is_in(texts, known), pc.is_in(texts, value_set=known)),
        (arrays.compute("coalesce", flat, pa.scalar("z")), pc.fill_null(flat, "z")),
        (arrays.compute("array_sort_indices", flat), pc.sort_indices(flat)),
        (arrays.compute("list_parent_indices", lists), pc.list_parent_indices(lists)),
        (arrays.compute("take", table, pa.array([4, 0])), table.take([4, 0])),
        (arrays.kept(table, flags), table.filter(flags)),
        (arrays.cast(table["number"], pa.float64()), table["number"].cast(pa.float64())),
    ]
    for i, (ours, theirs) in enumerate(same):
        assert ours.equals(theirs), i
    with pytest.raises(pa.ArrowInvalid):
        arrays.cast(pa.array([1.5]), pa.int64())
    assert arrays.cast(pa.array([1.5]), pa.int64(), safe=False).to_pylist() == [1]


def test_texts_as_dictionaries_are_read_as_texts_whatever_each_part_lists_first():
    texts = [["a", None, "b"], ["b", "c"]]
    apart = pa.chunked_array([pa.array(some).dictionary_encode() for some in texts])
    assert plain(apart) == plain(pa.chunked_array(texts)) == ["a", None, "b", "b", "c"]
    tables = [pa.table({"t": column}) for column in (apart, pa.chunked_array(texts))]
    pd.testing.assert_frame_equal(*map(arrays.to_pandas, tables))
    assert arrays.joined(tables)["t"].to_pylist() == plain(apart) * 2
