"""What many runs say: cells, medians, success, ranks, and what is known of the least value."""
