"""``python -m calibench``."""

from calibench.bench.cli import main

main()
