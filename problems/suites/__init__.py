"""Suites that others publish, as problems: `nist` ships, `bbob` and `ioh` need the package that holds them.

A problem of a suite says in `group` which of the suite's groups it belongs to, so that results can be told by group.
"""
