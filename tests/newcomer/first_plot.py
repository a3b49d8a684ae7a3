"""From `git clone` to the first plot: install, run one method on a problem that ships, draw.

python tests/newcomer/first_plot.py [REPOSITORY]
"""

from fresh import Newcomer, story


def follow(newcomer: Newcomer) -> None:
    """Give the guide's first run, and draw it."""
    newcomer.do("docs/guide.md", "bench run problem=full12 problem.error=J3 optimizer=de")
    newcomer.run("bench", "report", "results/adhoc")
    newcomer.needs("results/adhoc/figures/convergence_full12.png", least=5000)


if __name__ == "__main__":
    story("from git clone to the first plot", follow)
