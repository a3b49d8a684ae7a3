"""What an interval says of a bar, and the record of all batches on the page."""

import numpy as np
import pytest

from benchmarks.blind.bars import mean_interval, median_interval, verdict
from benchmarks.blind.batches import BATCHES, PAGE, read, section
from benchmarks.blind.score import Row


@pytest.mark.parametrize(
    ("low", "high", "bar", "told"),
    [
        (0.95, 0.99, ">= 0.93", "met"), (0.93, 0.99, ">= 0.93", "met"), (0.854, 0.989, ">= 0.93", "open"),
        (0.80, 0.92, ">= 0.93", "missed"), (0.003, 0.021, "<= 0.015", "open"), (0.0, 0.009, "<= 0.015", "met"),
        (0.02, 0.03, "<= 0.015", "missed"), (0.91, 0.97, "0.90-0.98", "met"), (0.88, 0.95, "0.90-0.98", "open"),
        (0.99, 1.0, "0.90-0.98", "missed"), (0.7, 0.89, "0.90-0.98", "missed"), (0.11, 0.49, "< 0.5", "met"),
        (0.11, 0.5, "< 0.5", "open"), (0.5, 0.6, "< 0.5", "missed"), (None, None, ">= 0.93", None),
        (0.1, 0.2, "", None),
    ],
)  # fmt: skip
def test_met_only_where_the_whole_interval_is_on_the_good_side(low, high, bar, told):
    assert verdict(low, high, bar) == told


def test_a_value_on_the_good_side_does_not_meet_a_bar_alone():
    assert Row("a rate", "all", 57, 0.947, 0.854, 0.989, ">= 0.93", True).verdict == "open"


def test_intervals_of_medians_and_means_cover_as_often_as_they_say():
    rng = np.random.default_rng(1)
    draws = rng.exponential(size=(400, 60))
    medians = [median_interval(row) for row in draws]
    assert np.mean([low <= np.log(2) <= high for low, high in medians]) > 0.93
    means = [mean_interval(row) for row in draws]
    assert np.mean([low <= 1 <= high for low, high in means]) > 0.90
    assert median_interval([1.0] * 5) == (None, None)
    assert mean_interval([1.0] * 9) == (None, None)


def test_the_page_holds_every_batch_as_it_came():
    assert section(read(BATCHES)) in PAGE.read_text()


def test_no_batch_shares_a_seed_with_another():
    seeds = [seed for batch in read(BATCHES) for part in batch["drawn"].values() for seed in range(*part)]
    assert len(seeds) == len(set(seeds))
