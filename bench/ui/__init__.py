"""A local web application over all studies, and sweeps as they run."""
