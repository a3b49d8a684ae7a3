"""Plain words are read and composed without Hydra, to the result that Hydra gives."""

from dataclasses import replace

import pytest

from calibench.bench.sweep import composition
from calibench.bench.sweep.composition import (
    _AS_TEXT,
    CONF,
    _override,
    compose,
    compose_by_hydra,
    enter,
    last_value,
    parse,
    registry_of,
    values_of,
)
from calibench.bench.sweep.words import PlainOverride
from tests.few import few

WORDS = [
    "problem=full12", "optimizer=nlopt_ln_cobyla", "budget=100", "budget=-0", "budget=ci", "budget=2e4", "budget=1e-3",
    "budget=1.50", "budget=1E3", "budget=1_000", "budget=007", "budget=.5", "budget=5.", "budget=+5", "budget=null",
    "budget=NULL", "budget=true", "budget=False", "budget=nan", "budget=-inf", "budget=a-b", "budget=a.b", "budget=",
    "budget='5'", "budget=99999999999999999999", "budget=1e400", "budget= 5", "seeds=3", "seeds=0:5", "seeds='3'",
    "seeds=ci", "seeds=", "study=x", "study=1e3", "study=null", "results=/data/a b-c.d", "results=a,b", "results=a\\",
    "target=1e-12", "start=random", "time_limit=2.5", "execution=processes", "execution.n_jobs=-1", "problem.error=J2",
    "problem.readings=A", "opt.de.population=200", "problem.n=7", "problem=a:B", "problem=./a.py:B",
    "problem=a.b:C", "target=a:B", "budget=a.b:C",
]  # fmt: skip


@pytest.mark.parametrize("word", WORDS)
def test_a_plain_word_is_read_as_hydra_reads_it(word):
    (mine,) = parse([word])
    key = word.partition("=")[0]
    hydras = replace(_override(word, key in _AS_TEXT), key_or_group=key, input_line=word)
    assert values_of(mine) == values_of(hydras)
    assert repr(mine.value()) == repr(hydras.value())
    assert last_value([mine], key, "none") == last_value([hydras], key, "none")
    assert (mine.key_or_group, mine.input_line) == (hydras.key_or_group, hydras.input_line)
    assert not mine.is_sweep_override()
    assert not hydras.is_sweep_override()


@pytest.mark.slow
@pytest.mark.parametrize("kind", ["problem", "optimizer"])
def test_every_name_and_preset_is_composed_as_hydra_composes_it(kind):
    names = registry_of(kind).names()
    presets = [path.stem for path in (CONF / kind).glob("*.yaml")]
    for name in [*names, *presets]:
        assert repr(compose([f"{kind}={name}"])) == repr(compose_by_hydra([f"{kind}={name}"]))


REQUESTS = [
    [], ["budget=100", "seeds='1'"], ["budget=ci", "start=random", "target=null", "seeds='0:3'"],
    ["execution=processes", "execution.n_jobs=2", "results='/data/x'"], ["time_limit=2.5", "study='a'"],
    ["problem=full12", "problem.error=J3"], ["problem=full12", "problem.error=5"], ["problem=full12", "optimizer=lm"],
    ["optimizer=ga", "optimizer.population=20"], ["optimizer=de", "optimizer.population=true"],
    ["optimizer=fmincon_matlab", "optimizer.tol_x=1e-9"], ["problem=full12", "problem.readings='a b'"],
]  # fmt: skip


@pytest.mark.parametrize("texts", few(6, REQUESTS), ids=" ".join)
def test_a_plain_request_is_composed_as_hydra_composes_it(texts):
    def said(how):
        try:
            return repr(how(texts))
        except ValueError as error:
            return str(error)

    assert said(compose) == said(compose_by_hydra)


@pytest.mark.parametrize("word", ["problem=full12", "budget=100", "seeds=0:5", "optimizer.population=20"])
def test_a_plain_word_needs_no_hydra(word):
    assert isinstance(parse([word])[0], PlainOverride)
    assert word.partition("=")[0] in _AS_TEXT or values_of(parse([word])[0]) == [word.partition("=")[2]]


def test_a_class_of_a_module_needs_no_hydra(fresh, monkeypatch):
    (fresh / "plainly.py").write_text("class Bowl:\n    def __init__(self, depth: float = 1.0):\n        pass\n")
    monkeypatch.syspath_prepend(fresh)
    monkeypatch.setattr(composition, "_ENTERED", {})
    enter("problem", "plainly:Bowl", registry_of("problem"))
    texts = ["problem=plainly:Bowl", "problem.depth=2.5", "budget=50"]
    hydras = compose_by_hydra(texts)
    monkeypatch.delattr(composition, "compose_by_hydra")
    assert repr(compose(texts)) == repr(hydras)
    assert hydras["problem"]["depth"] == 2.5
