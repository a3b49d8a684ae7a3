"""What each threshold of the search costs: the table of rates at half and at twice each value."""

from benchmarks.thresholds.table import main, rates, rows, scaled, searched

__all__ = ["main", "rates", "rows", "scaled", "searched"]
