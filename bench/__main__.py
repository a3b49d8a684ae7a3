"""``python -m bench`` is ``bench``."""

from calibench.bench.cli import main

if __name__ == "__main__":
    main()
