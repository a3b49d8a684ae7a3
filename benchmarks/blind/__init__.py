"""Blind test data: simulated machines with hidden effects, whose truth the search that has to find them never reads.

The physics are this room's own: nothing is imported from the rooms that it puts to the test. `gpm2002` and `orthoglide`
simulate, `write` writes cases and their truths into two folders, `score` holds the verdicts against the truths, `bars`
are what they must reach, `batches` is the record of all cases ever drawn.

    python -m benchmarks.blind.write --seeds 0:600 --to DATA --sealed TRUTHS
    bench discover machine=gpm2002 data=DATA --json > reports.jsonl
    python -m benchmarks.blind.score --reports reports.jsonl --sealed TRUTHS --misses
"""
