"""The origin of a row: the id of its run, the digest of the code that made it, the versions and the machine."""
