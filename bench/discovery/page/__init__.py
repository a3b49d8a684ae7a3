"""The page of one verdict: its words, tables and drawings, from a `Report` alone.

`page` lays it out and writes it; `words` has the sentences that the terminal shares, `figures` what is drawn.
"""
