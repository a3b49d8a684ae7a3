"""How many members each of pygmo's populations has, unless its user says: a rule a method, with its source beside it.

pygmo leaves the number to its user. A rule gives it from the dimension d of the problem and the budget B that is left:
the number of the method's paper or of its authors' code, and where such a number spends a small budget on too few
generations, at most a share of the budget. What the numbers cost and bring is measured in docs/optimizers.md on our
problems and on functions that are not ours (``python -m benchmarks.populations.sizes``).
"""

from __future__ import annotations

from dataclasses import dataclass
from math import floor, log, sqrt


@dataclass(frozen=True)
class PopulationRule:
    """constant + floor(per_dimension d + per_root sqrt(d) + per_log ln d), at most B / `generations`, at least `least`.

    `name` is the formula as options and rows show it; `source` is where it is from, `read` where that number has been
    read again (empty: cited as known, the paper was not at hand), `why` tells of a share of the budget. `even`: rounded
    down to an even number.
    """

    method: str
    name: str
    source: str
    why: str = ""
    read: str = ""
    constant: int = 0
    per_dimension: int = 0
    per_root: int = 0
    per_log: int = 0
    generations: int | None = None
    least: int = 5
    even: bool = False

    def size(self, dimension: int, budget: int) -> int:
        """Return the number of members in `dimension` dimensions with `budget` evaluations left."""
        d = dimension
        size = self.constant + floor(self.per_dimension * d + self.per_root * sqrt(d) + self.per_log * log(d))
        if self.generations is not None:
            size = min(size, budget // self.generations)
        size = max(size, self.least)
        return size - size % 2 if self.even else size

    @property
    def default(self) -> int | str:
        """Return what the option `population` is unless it is given: the formula, or the number where it is one."""
        return int(self.name) if self.name.isdigit() else self.name

    @property
    def most(self) -> tuple[int, int]:
        """Return (a, b): in d dimensions there are never more than a + b d members, whatever the budget.

        2 sqrt(d) <= 1 + d, and 3 ln d <= .296 + d, so with whole numbers floor(3 ln d) <= d.
        """
        a, b = self.constant, self.per_dimension
        if self.per_root:
            a, b = a + self.per_root - 1, b + 1 if self.per_root <= 2 else b + self.per_root
        if self.per_log:
            a, b = a + max(0, floor(self.per_log * log(self.per_log) - self.per_log)), b + 1
        return max(a, self.least - b), b


_FEW_GENERATIONS = (
    "the number of the paper is for 1e5 evaluations and more; with fewer, more generations of fewer members reach "
    "further, on our problems and on the other functions alike"
)
_ADAPTIVE = "Brest et al. 2006, IEEE TEC 10(6): NP = 100 for jDE, whose adaptation pygmo's {} takes by default"

RULES: dict[str, PopulationRule] = {
    rule.method: rule
    for rule in (
        PopulationRule(
            "de", "min(10d,B/500)", "Storn, Price 1997, J. Global Optim. 11: NP of 5 d to 10 d; here 10 d",
            _FEW_GENERATIONS, per_dimension=10, generations=500, least=10,
        ),
        PopulationRule(
            "sade", "min(100,B/500)", _ADAPTIVE.format("sade"), _FEW_GENERATIONS,
            constant=100, generations=500, least=10,
        ),
        PopulationRule(
            "de1220", "min(100,B/500)", _ADAPTIVE.format("de1220"), _FEW_GENERATIONS,
            constant=100, generations=500, least=10,
        ),
        PopulationRule(
            "cmaes", "4+3ln(d)", "Hansen 2016, arXiv:1604.00772, table 1: lambda = 4 + floor(3 ln d); pygmo needs 5",
            read="DEAP's and libcmaes's defaults", constant=4, per_log=3,
        ),
        PopulationRule(
            "xnes", "4+3ln(d)", "Glasmachers et al. 2010, GECCO, table 1: lambda = 4 + floor(3 ln d); pygmo needs 4",
            constant=4, per_log=3, least=4,
        ),
        PopulationRule(
            "pso", "10+2sqrt(d)", "Clerc, Standard PSO 2006 and 2007: S = 10 + floor(2 sqrt d)",
            read="CRAN's pso, type SPSO2007", constant=10, per_root=2,
        ),
        PopulationRule(
            "pso_gen", "10+2sqrt(d)", "Clerc, Standard PSO 2006 and 2007: S = 10 + floor(2 sqrt d)",
            read="CRAN's pso, type SPSO2007", constant=10, per_root=2,
        ),
        PopulationRule(
            "sga", "min(200,B/25)", "MATLAB's ga: 200 members above five variables (De Jong 1975: 50 to 100)",
            "a thousand evaluations would be five generations of 200. MATLAB's 50 up to five variables is not taken: "
            "on sensor_zero, of three, 150 came lower than 40 and 80", read="MathWorks' answers: PopulationSize of ga",
            constant=200, generations=25, least=10, even=True,
        ),
        PopulationRule(
            "bee_colony", "62", "Karaboga, Basturk 2007, J. Global Optim. 39, as in their code: a colony of 125, half "
            "of it food sources, which are pygmo's members", read="their MATLAB code: NP = 125, and 20", constant=62,
        ),
        PopulationRule(
            "gaco", "min(50,B/250)", "Socha, Dorigo 2008, EJOR 185: an archive of 50; pygmo's archive (its kernel, at "
            "most 63) is at most its population", "pygmo samples a whole population a generation, the paper two ants",
            constant=50, generations=250, least=20,
        ),
        PopulationRule(
            "gwo", "30", "Mirjalili et al. 2014, Adv. Eng. Software 69: 30 search agents",
            read="their MATLAB code", constant=30,
        ),
        PopulationRule(
            "ihs", "5", "Omran, Mahdavi 2008, Appl. Math. Comput. 198: a harmony memory of 5, for improved harmony "
            "search too", constant=5, least=1,
        ),
    )
}  # fmt: skip


def most_members(method: str, population: int | str | None) -> tuple[int, int]:
    """Return (a, b): in d dimensions `method` has at most a + b d members."""
    return (population, 0) if isinstance(population, int) else RULES[method].most


def members(method: str, population: int | str | None, dimension: int, budget: int) -> int:
    """Return `population` if it is a number, else what the rule of `method` gives."""
    return population if isinstance(population, int) else RULES[method].size(dimension, budget)
