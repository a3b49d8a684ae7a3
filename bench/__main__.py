"""``python -m bench`` is ``bench``."""

import sys

if not sys.flags.safe_path:
    sys.path.append(sys.path.pop(0))  # the working folder, whose files may have the names of Python's modules

from calibench.bench.cli import command

if __name__ == "__main__":
    command()
