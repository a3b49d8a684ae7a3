"""Choosing one setting of a method from a sweep, and what the act of choosing is worth on instances it has not seen."""
