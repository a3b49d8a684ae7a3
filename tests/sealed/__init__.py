"""Test data of the GPM2002 with hidden effects, whose truth is sealed away from the workflow that has to find it.

The physics here are this folder's own: nothing is imported from the rooms that it puts to the test.

    python -m tests.sealed.write --seeds 0:600 --to DATA --sealed TRUTHS
    bench discover machine=gpm2002 data=DATA --json > reports.jsonl
    python -m tests.sealed.score --reports reports.jsonl --sealed TRUTHS --misses
"""
