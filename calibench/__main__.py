"""``python -m calibench``."""

from calibench.bench.cli import command

command()
