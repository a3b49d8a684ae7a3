"""``bench identify``: which parameters the data of a problem determine."""

from calibench.bench.commands.console import print_json, print_table
from calibench.bench.sweep.composition import parse, refuse_lists
from calibench.bench.sweep.request import members_of
from calibench.bench.verbs import IdentifyWords
from calibench.bench.words import RequestError, read, split_flags
from calibench.core.words import plain, print_plain as print
from calibench.problems import identify


def run(argv: list[str]) -> int:
    flags, words = split_flags(argv, ("--json",))
    given = read(IdentifyWords, "identify", words)
    overrides = parse([word for word in words if word.startswith("problem")])
    refuse_lists(overrides)
    member = members_of("problem", overrides)[0]
    if member.broken is not None:
        raise RequestError(f"problem {member.name} cannot be built: {member.broken.error}")
    problem = member.built
    known = identify(problem, noise=given.noise)
    if "--json" in flags:
        print_json(known.to_dict())
        return 0
    print(f"{getattr(problem, 'name', type(problem).__name__)}: {known.sentence()}\n")
    unit = known.noise_unit + ("/mm" if any(known.units) else "")
    print(f"singular values [{unit}]: {'  '.join(f'{plain(s, 3)}' for s in known.singular_values)}\n")
    rows = [
        [name, unit, f"{value:.6g}", f"{plain(error, 3)}" if error < float("inf") else "cannot be found"]
        for name, unit, value, error in zip(known.names, known.units, known.x, known.standard_errors, strict=True)
    ]
    print_table(["parameter", "unit", "value", f"standard error at {known.noise:g} {known.noise_unit}"], rows)
    return 0
