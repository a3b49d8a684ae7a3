"""Commands on studies: run, status, merge, report, export, show, compare, choose."""
