"""Statistics of many runs: cells, medians, success, ranks, and the least value that is known."""
