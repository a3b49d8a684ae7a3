"""Measured data on disk: Parquet, CSV, Excel or MATLAB with units, statements on them, and the meaning of `data=`."""

from calibench.bench.measured.files import read_measured, write_measured
from calibench.bench.measured.sources import Source, shipped_path, sources

__all__ = ["Source", "read_measured", "shipped_path", "sources", "write_measured"]
