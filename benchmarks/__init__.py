"""Timings: `make bench`. Never asserted in the tests, as no two machines and no two minutes are alike."""
