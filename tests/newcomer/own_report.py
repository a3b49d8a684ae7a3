"""From `git clone` to the first report on one's own problem: the class of README.md, swept over every method.

python tests/newcomer/own_report.py [REPOSITORY]
"""

from fresh import Newcomer, story


def follow(newcomer: Newcomer) -> None:
    """Save the class, run the three methods that the page shows, sweep, report."""
    newcomer.save("mine.py", newcomer.code("README.md", "class Rosenbrock"))
    said = newcomer.run("python", "mine.py")
    if said.count("evaluations, best") != 3:
        raise SystemExit(f"README.md shows three methods, this came:\n{said}")
    newcomer.do("README.md", "bench run -m problem=./mine.py:Rosenbrock")
    newcomer.do("README.md", "bench report results/mine")
    newcomer.needs("results/mine/report.html", least=50_000)


if __name__ == "__main__":
    story("from git clone to the report on one's own problem", follow)
