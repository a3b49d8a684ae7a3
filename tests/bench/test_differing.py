import numpy as np
import pytest

from calibench.bench.report.study.html_tables import differing
from calibench.bench.statistics.ranking import Blocks, friedman


@pytest.fixture
def three():
    rng = np.random.default_rng(5)
    medians = np.column_stack([rng.normal(0, 1, 20), rng.normal(0, 1, 20), rng.normal(9, 1, 20)])
    return friedman(Blocks(("one", "other", "worst"), medians))


def test_the_page_names_which_methods_differ(three):
    found = differing(three)
    rows = {row[0]: row for row in found.table.rows}
    assert rows["worst"][4] == "all others"
    assert rows["one"][4:] == ["worst", "other"]
    assert rows["other"][4:] == ["worst", "one"]
    assert "Of 3 pairs of methods 2 differ" in found.sentence


def test_long_names_in_a_list_break_after_an_underscore_so_that_no_column_is_cut():
    medians = np.column_stack([np.arange(20.0), np.arange(20.0), np.arange(20.0) + 99])
    found = differing(friedman(Blocks(("one_long", "other", "worst"), medians)))
    assert {row[0]: row for row in found.table.rows}["other"][5] == "one_<wbr>long"


def test_the_p_values_of_the_page_are_those_of_scikit_posthocs(three):
    posthocs = pytest.importorskip("scikit_posthocs")
    rng = np.random.default_rng(5)
    medians = np.column_stack([rng.normal(0, 1, 20), rng.normal(0, 1, 20), rng.normal(9, 1, 20)])
    known = posthocs.posthoc_nemenyi_friedman(medians).to_numpy()
    order = [("one", "other", "worst").index(name) for name in three.methods]
    assert three.nemenyi == pytest.approx(known[np.ix_(order, order)], abs=1e-6)


def test_where_ranks_tell_nothing_the_page_says_so():
    alike = friedman(Blocks(("a", "b", "c"), np.zeros((12, 3))))
    assert "do not tell the methods apart" in differing(alike).sentence
