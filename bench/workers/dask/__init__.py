"""The workers of a Dask cluster: packs go out, each run comes home as it ends."""
