"""The page of one verdict: its words, which the terminal shares, tables and drawings, from a `Report` alone."""
