"""Who carries out the runs of a sweep: processes of this machine, or the workers of a Dask cluster.

All take their work in packs from one place (`packs`), execute and keep one run like another (`worker`), and tell of
each run as it ends. What is finished is told by the store alone, never by who was given it.
"""
