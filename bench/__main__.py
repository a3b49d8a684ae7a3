"""``python -m bench`` is ``bench``."""

from calibench.bench.cli import command

if __name__ == "__main__":
    command()
