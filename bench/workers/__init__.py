"""Who carries out runs: one protocol (`carrier`), and three that keep it: here, in processes, on a Dask cluster."""
