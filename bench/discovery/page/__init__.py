"""The page of one verdict: its words, tables and drawings, from a `Report` alone.

`page` lays it out and `write` writes it; `words` has the sentences that the terminal shares, `series` what is drawn.
"""
