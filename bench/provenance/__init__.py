"""Where a row comes from: the id of its run, the digest of the code that made it, the versions and the machine."""
