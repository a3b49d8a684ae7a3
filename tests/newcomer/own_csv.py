"""From `git clone` to a verdict on one's own CSV: a table of readings and a function that should explain them.

python tests/newcomer/own_csv.py [REPOSITORY]
"""

from fresh import Newcomer, story


def follow(newcomer: Newcomer) -> None:
    """Save the function and the readings of docs/my-table.md, ask what the function misses, read the verdict."""
    newcomer.save("of_mine.py", newcomer.code("docs/my-table.md", "def spring"))
    newcomer.save("readings.py", newcomer.code("docs/my-table.md", "spring.csv"))
    newcomer.run("python", "readings.py")
    said = newcomer.do("docs/my-table.md", "bench discover machine=table data=spring.csv machine.model=./of_mine.py")
    if "term of force cubed" not in said:
        raise SystemExit(f"docs/my-table.md promises the cubed term, this came:\n{said}")
    newcomer.needs("results/discover/spring/report.html", least=10_000)


if __name__ == "__main__":
    story("from git clone to a verdict on one's own CSV", follow)
