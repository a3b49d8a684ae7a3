"""The registry: a name is entered once, options are those of a signature, and every mistake has its sentence."""

import dataclasses
import functools
import importlib.metadata
import os
import sys
import typing
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from enum import Enum
from fractions import Fraction
from pathlib import Path
from typing import Any, Literal, Protocol

import numpy as np
import pytest
from numpy.typing import NDArray

import calibench.core.registry
from calibench.core.options import Range, coerce, declared_options, suggest
from calibench.core.registry import Registry


def kettle(size: int = 2, heat: float = 1.5, metal: Literal["tin", "iron"] = "tin", lid: bool = True) -> tuple:
    """Return its options, as a stand-in for what a registry builds."""
    return size, heat, metal, lid


def needy(size: int) -> int:
    return size


@pytest.fixture(autouse=True)
def _no_entry_points(monkeypatch):
    """Keep what is installed on this machine out of the toy registries."""
    monkeypatch.setattr(calibench.core.registry, "entry_points", lambda group: ())


@pytest.fixture
def pots():
    """Return a registry of one kind with two entries."""
    registry = Registry(kind="pot", group="test.pots")
    registry.register("kettle")(kettle)
    registry.register("needy")(needy)
    return registry


def refused(match, call):
    with pytest.raises(ValueError, match=match) as caught:
        call()
    assert "\n" not in str(caught.value)


# Names


def test_a_name_is_entered_once(pots):
    refused("pot 'kettle' is registered twice", lambda: pots.register("kettle")(needy))
    assert pots.make("kettle") == (2, 1.5, "tin", True)


def test_the_decorator_gives_back_what_it_enters(pots):
    def pan():
        return "pan"

    assert pots.register("pan")(pan) is pan
    assert pots.names() == ["kettle", "needy", "pan"]
    assert pots.factories()["pan"] is pan


@pytest.fixture
def promised(pots, tmp_path, monkeypatch):
    """Return a registry of which a module that is not loaded promised two entries, before the two that are there."""
    monkeypatch.syspath_prepend(tmp_path)
    monkeypatch.setattr(sys.modules[__name__], "SHELF", pots, raising=False)
    text = "import sys\nSHELF = sys.modules[" + repr(__name__) + "].SHELF\n"
    text += "SHELF.register('wok')(lambda size=3: size)\nSHELF.register('pan')(lambda: 'pan')\n"
    text += "SHELF.exclude('vase', 'it holds flowers')\n"
    (tmp_path / "shelf_of_pots.py").write_text(text)
    pots.promise("shelf_of_pots", "pan", "wok")
    pots.promise("loaded_long_ago", "kettle")
    yield pots
    sys.modules.pop("shelf_of_pots", None)


def test_what_is_promised_is_known_before_its_module_is_loaded(promised):
    assert promised.names() == ["needy", "pan", "wok", "kettle"]
    assert "wok" in promised
    assert "vase" not in promised
    assert promised.make("kettle") == (2, 1.5, "tin", True)
    assert "shelf_of_pots" not in sys.modules
    assert promised.make("wok", size=4) == 4
    assert "shelf_of_pots" in sys.modules


@pytest.mark.parametrize(
    "call",
    [
        lambda pots: pots.factories()["pan"](),
        lambda pots: pots.option("wok", "size"),
        lambda pots: pots.factory("pan"),
        lambda pots: pots.check("wok", {"size": 1}),
        lambda pots: pots.left_out["vase"],
    ],
)
def test_what_is_promised_is_loaded_where_it_is_needed(promised, call):
    assert call(promised)
    assert promised.names() == list(promised.factories()) == ["needy", "pan", "wok", "kettle"]


def test_what_a_promised_module_leaves_out_is_told(promised):
    refused("pot 'vase' is left out: it holds flowers", lambda: promised.make("vase"))


def test_a_near_name_is_proposed_of_promised_ones_too(promised):
    refused("unknown pot 'wokk'; did you mean 'wok'", lambda: promised.make("wokk"))


def test_a_promised_name_is_taken(promised):
    refused("pot 'wok' is registered twice", lambda: promised.register("wok")(kettle))


def test_a_promise_that_is_not_kept_is_told(promised):
    promised.promise("shelf_of_pots", "pot")
    refused("shelf_of_pots was to register pot pot, and did not", lambda: promised.make("pot"))


def test_changing_the_dictionary_handed_out_enters_nothing(pots):
    pots.factories()["pan"] = kettle
    assert pots.names() == ["kettle", "needy"]


@pytest.mark.parametrize("name", ["ketle", "KETTLE", "kettles"])
def test_a_misspelt_name_is_answered_with_the_nearest_and_the_list(pots, name):
    refused(f"unknown pot '{name}'; did you mean 'kettle'\\? choices: kettle, needy", lambda: pots.make(name))


def test_a_name_like_no_other_is_answered_with_the_list(pots):
    refused("unknown pot 'xyz'; choices: kettle, needy", lambda: pots.make("xyz"))


def test_an_empty_registry_says_there_are_none():
    refused("unknown pot 'kettle'; there are none", lambda: Registry(kind="pot", group="none").make("kettle"))


# Options


def test_options_are_those_of_the_signature_with_type_and_default(pots):
    options = pots.options("kettle")
    assert list(options) == ["size", "heat", "metal", "lid"]
    assert [option.default for option in options.values()] == [2, 1.5, "tin", True]
    assert not any(option.required for option in options.values())
    assert pots.options("needy")["size"].required
    assert [option.describe() for option in options.values()] == [
        "size=2 (int)",
        "heat=1.5 (float)",
        "metal=tin (tin|iron)",
        "lid=true (bool)",
    ]


def test_options_can_be_declared_by_another_signature():
    registry = Registry(kind="pot", group="none")
    registry.register("any", options=kettle)(lambda **options: options)
    assert registry.make("any", size=5) == {"size": 5}
    refused("any has no option 'sizes'; did you mean 'size'", lambda: registry.make("any", sizes=5))


def test_a_class_and_a_partial_declare_their_options_too():
    class Pot:
        def __init__(self, size: int = 3, *rest: int, **others: int) -> None:
            self.size = size

    assert list(declared_options(Pot)) == ["size"]
    assert declared_options(Pot)["size"].type is int
    small = declared_options(functools.partial(kettle, size=1))
    assert (small["size"].default, small["size"].type) == (1, int)


def test_an_unknown_option_is_answered_with_the_nearest_and_the_list(pots):
    refused(
        "kettle has no option 'sise'; did you mean 'size'\\? choices: size, heat, metal, lid",
        lambda: pots.make("kettle", sise=1),
    )


def test_a_required_option_is_asked_for(pots):
    refused("needy needs size", lambda: pots.make("needy"))
    assert pots.make("needy", size=3) == 3


def test_values_come_in_the_type_that_is_declared(pots):
    size, heat, metal, lid = pots.make("kettle", size=4.0, heat=2, metal="iron", lid=False)
    assert (size, heat, metal, lid) == (4, 2.0, "iron", False)
    assert (type(size), type(heat)) == (int, float)


def test_a_wrong_value_names_entry_and_option(pots):
    refused("kettle.size=1.5: a whole number is needed", lambda: pots.make("kettle", size=1.5))
    refused("kettle.metal=irn: did you mean 'iron'", lambda: pots.make("kettle", metal="irn"))


# Values: taken where nothing is lost

TAKEN = [
    (1e4, int, 10_000),
    (np.int64(7), int, 7),
    (np.float64(7.0), int, 7),
    (-3, int, -3),
    (3, float, 3.0),
    (np.float32(0.5), float, 0.5),
    (True, bool, True),
    ("tin", Literal["tin", "iron"], "tin"),
    ("3", Literal[3, 4], 3),
    (3, Literal["3", "4"], "3"),
    (5, str, "5"),
    ("5", str, "5"),
    ("z1,la2", tuple[str, ...], ("z1", "la2")),
    ("z1, la2  lb3", tuple[str, ...], ("z1", "la2", "lb3")),
    (["z1"], tuple[str, ...], ("z1",)),
    ([1, 2.0], tuple[int, ...], (1, 2)),
    ([], tuple[str, ...], ()),
    (None, int | None, None),
    (4.0, int | None, 4),
    ("null", str | None, "null"),
    (object, Any, object),
]


@pytest.mark.parametrize(("value", "kind", "expected"), TAKEN)
def test_a_value_is_taken_where_nothing_is_lost(value, kind, expected):
    taken = coerce("pot.size", value, kind)
    assert taken == expected
    assert type(taken) is type(expected)


REFUSED = [
    (1.5, int, r"pot\.size=1\.5: a whole number is needed"),
    ("5", int, r"pot\.size=5: a whole number is needed"),
    (True, int, r"pot\.size=true: a whole number is needed"),
    (None, int, r"pot\.size=null: a whole number is needed"),
    (float("inf"), int, r"pot\.size=inf: a whole number is needed"),
    (True, float, r"pot\.size=true: a finite number is needed"),
    (float("nan"), float, r"pot\.size=nan: a finite number is needed"),
    (float("inf"), float, r"pot\.size=inf: a finite number is needed"),
    ("warm", float, r"pot\.size=warm: a finite number is needed"),
    (1j, float, r"pot\.size=1j: a finite number is needed"),
    (1, bool, r"pot\.size=1: true or false is needed"),
    ("true", bool, r"pot\.size=true: true or false is needed"),
    (False, str, r"pot\.size=false: a word is needed"),
    (["a"], str, r"pot\.size=\[a\]: a word is needed"),
    ("steel", Literal["tin", "iron"], r"pot\.size=steel: choices: tin, iron"),
    ("in", Literal["tin", "iron"], r"pot\.size=in: did you mean 'tin'\? choices: tin, iron"),
    (5, Literal[3, 4], r"pot\.size=5: choices: 3, 4"),
    (5, tuple[str, ...], r"pot\.size=5: a list is needed"),
    ([1, 1.5], tuple[int, ...], r"pot\.size=1\.5: a whole number is needed"),
    ("1 2", tuple[int, ...], r"pot\.size=1: a whole number is needed"),
    (1.5, int | None, r"pot\.size=1\.5: a whole number is needed"),
    (None, Literal["tin", "iron"], r"pot\.size=null: choices: tin, iron"),
]


@pytest.mark.parametrize(("value", "kind", "match"), REFUSED)
def test_a_value_that_would_be_bent_is_refused(value, kind, match):
    refused(match, lambda: coerce("pot.size", value, kind))


def test_a_choice_is_given_back_as_it_is_declared():
    assert type(coerce("pot.size", 4.0, Literal[3, 4])) is int


@pytest.mark.parametrize("kind", [int, float])
def test_an_integer_beyond_all_floats_is_refused_in_words(kind):
    with pytest.raises(ValueError, match="number is needed"):
        coerce("pot.size", 10**400, kind)


def test_a_misspelt_name_is_told_the_names_of_its_library_and_no_wall():
    others = [f"nlopt_{letter}{number}" for letter in "abcdefgh" for number in range(9)]
    of_scipy = ["scipy_powell", "scipy_cg", "scipy_direct", "scipy_differential_evolution"]
    listed = [*others, *of_scipy, "pygmo_de"]
    told = suggest("scipy_diferential_evolution", listed)
    assert told == f"did you mean 'scipy_differential_evolution'? choices: {', '.join(of_scipy)}"
    assert suggest("scipy_quadratic_zoo", listed) == f"choices: {', '.join(of_scipy)}"
    assert suggest("pygmo_de1", listed).startswith("did you mean 'pygmo_de'? choices: nlopt_a0, ")


def test_an_option_that_begins_alike_is_offered():
    assert suggest("popsize", ["population", "F", "CR"]) == "did you mean 'population'? choices: population, F, CR"
    assert suggest("popsize", ["pop_a", "pop_b", "pop_c", "pop_d"]).startswith("choices: ")


def test_suggestions_prefer_the_nearest_then_another_case():
    assert suggest("gage", ["gauge", "plan"]) == "did you mean 'gauge'? choices: gauge, plan"
    assert suggest("XA", ["xa", "ya"]) == "did you mean 'xa'? choices: xa, ya"
    assert suggest("zzz", ["gauge"]) == "choices: gauge"
    assert suggest("zzz", []) == "there are none"
    listed = ["de", "nlopt_GN_DIRECT", "nlopt_GN_DIRECT_L", "nlopt_LN_NELDERMEAD", "pygmo_cmaes"]
    assert suggest("nelder_mead", listed).startswith("did you mean 'nlopt_LN_NELDERMEAD'? choices: de, ")
    assert suggest("CMA-ES", listed).startswith("did you mean 'pygmo_cmaes'? ")
    assert suggest("direct", listed).startswith("did you mean 'nlopt_GN_DIRECT' or 'nlopt_GN_DIRECT_L'? ")
    assert suggest("nl", listed).startswith("choices: ")


def test_of_a_long_list_only_the_beginning_stands_beside_a_near_name():
    listed = [f"method_{k:02d}" for k in range(31)]
    assert suggest("method_7", listed).endswith("choices: method_00, method_01, method_02, method_03, method_04, "
                                                "method_05, method_06, method_07 and 23 more")  # fmt: skip
    assert suggest("method_7", listed[:30]).endswith(", method_28, method_29")
    assert suggest("x", listed).endswith(", method_29, method_30")


# People outside: a path on the command line, an entry point


@pytest.fixture
def outside(tmp_path, monkeypatch):
    """Return the name of an importable module of someone else's."""
    (tmp_path / "my_pots.py").write_text(
        "class Pan:\n"
        "    def __init__(self, size: int = 4) -> None:\n"
        "        self.size = size\n"
        "number = 5\n"
        "def pot(heat: float = 1.0) -> float:\n"
        "    return heat\n"
    )
    monkeypatch.syspath_prepend(tmp_path)
    yield "my_pots"
    sys.modules.pop("my_pots", None)


def test_a_class_is_found_by_its_path_and_has_checked_options(pots, outside):
    assert pots.make(f"{outside}:Pan").size == 4
    assert pots.make(f"{outside}:Pan", size=9.0).size == 9
    assert pots.make(f"{outside}:pot", heat=2) == 2.0
    refused(r"my_pots:Pan\.size=1\.5: a whole number", lambda: pots.make(f"{outside}:Pan", size=1.5))
    refused("my_pots:Pan has no option 'sise'; did you mean 'size'", lambda: pots.make(f"{outside}:Pan", sise=1))


def test_a_path_is_a_name_from_then_on(pots, outside):
    assert list(pots.options(f"{outside}:Pan")) == ["size"]
    assert pots.names() == ["kettle", "needy"]
    pots.make(f"{outside}:Pan")
    assert pots.names() == ["kettle", "needy"]


@pytest.mark.parametrize(
    ("path", "match"),
    [
        ("not_there_at_all:Pan", "cannot import pot 'not_there_at_all:Pan': No module named"),
        ("my_pots:Pam", "cannot find pot 'my_pots:Pam': my_pots has no 'Pam'"),
        ("my_pots:", "cannot find pot 'my_pots:'"),
        (":Pan", "cannot import pot ':Pan'"),
        ("my_pots:number", "pot 'my_pots:number' is not a class or function"),
    ],
)
def test_a_path_that_leads_nowhere_is_refused(pots, outside, path, match):
    refused(match, lambda: pots.make(path))
    assert pots.names() == ["kettle", "needy"]


def test_a_relative_path_is_refused_in_words(pots):
    refused("cannot import pot '.my_pots:Pan'", lambda: pots.make(".my_pots:Pan"))


def announced(monkeypatch, *points):
    """Let the entry points of every group be `points`, (name, value); return the groups that were asked for."""
    asked = []

    def entry_points(group):
        asked.append(group)
        return [importlib.metadata.EntryPoint(name, value, group) for name, value in points]

    monkeypatch.setattr(calibench.core.registry, "entry_points", entry_points)
    return asked


def test_entries_of_other_packages_come_last_and_are_made_like_ours(pots, outside, monkeypatch):
    asked = announced(monkeypatch, ("pan", f"{outside}:Pan"))
    assert pots.names() == ["kettle", "needy", "pan"]
    assert asked == ["test.pots"]
    assert pots.make("pan", size=6.0).size == 6
    assert list(pots.factories()) == ["kettle", "needy", "pan"]
    refused("did you mean 'pan'", lambda: pots.make("pen"))


def test_entry_points_are_looked_up_once_and_only_when_needed(outside, monkeypatch):
    asked = announced(monkeypatch, ("pan", f"{outside}:Pan"))
    registry = Registry(kind="pot", group="test.pots")
    registry.register("kettle")(kettle)
    assert asked == []
    for _ in range(3):
        registry.make("pan")
        registry.names()
    assert asked == ["test.pots"]


def test_another_package_cannot_take_a_name_of_ours(pots, outside, monkeypatch):
    announced(monkeypatch, ("kettle", f"{outside}:Pan"))
    assert "registered twice" in pots.left_out["kettle"]
    assert pots.make("kettle") == (2, 1.5, "tin", True)


def test_an_entry_that_enters_itself_as_it_is_loaded_is_there_once(pots, tmp_path, monkeypatch):
    monkeypatch.setattr(sys, "path", [str(tmp_path), *sys.path])
    entry = "from calibench.core import registry\n\nWOK = registry.POTS.register('wok')(dict)"
    (tmp_path / "enters_itself.py").write_text(entry)
    monkeypatch.setattr(calibench.core.registry, "POTS", pots, raising=False)
    announced(monkeypatch, ("wok", "enters_itself:WOK"), ("kettle", "enters_itself:WOK"))
    assert pots.names() == ["kettle", "needy", "wok"]
    assert list(pots.left_out) == ["kettle"]


def test_an_installed_package_needs_nothing_but_its_entry_point(pots, outside, tmp_path, monkeypatch):
    # the true function this time, over a package that is installed as far as Python can tell
    folder = tmp_path / "my_pots-1.0.dist-info"
    folder.mkdir()
    (folder / "METADATA").write_text("Metadata-Version: 2.1\nName: my-pots\nVersion: 1.0\n")
    (folder / "entry_points.txt").write_text("[test.pots]\npan = my_pots:Pan\n[test.lids]\nlid = my_pots:pot\n")
    monkeypatch.setattr(calibench.core.registry, "entry_points", importlib.metadata.entry_points)
    assert pots.names() == ["kettle", "needy", "pan"]
    assert pots.make("pan").size == 4
    assert Registry(kind="lid", group="test.lids").names() == ["lid"]


def test_a_package_that_cannot_be_loaded_takes_no_other_name_away(monkeypatch):
    points = [
        importlib.metadata.EntryPoint(name, value, "test.pots")
        for name, value in (("broken", "no_such_module:Pan"), ("kettle", "math:sqrt"), ("root", "math:sqrt"))
    ]
    monkeypatch.setattr(calibench.core.registry, "entry_points", lambda group: points)
    registry = Registry(kind="pot", group="test.pots")
    registry.register("kettle")(kettle)
    assert registry.names() == registry.names() == ["kettle", "root"]
    assert registry.make("kettle") == kettle()
    with pytest.raises(ValueError, match="no_such_module:Pan"):
        registry.make("broken")


# What a class of one's own annotates


class Shade(Enum):
    DARK = "d"
    BRIGHT = "b"


@dataclass
class Vase:
    shade: Shade = Shade.DARK
    file: Path | None = None
    heights: list[float] = dataclasses.field(default_factory=lambda: [1.0, 2.0])
    size: tuple[int, str] = (3, "cm")
    curve: NDArray[np.float64] = dataclasses.field(default_factory=lambda: np.zeros(2))
    lid: float = None
    parts: dict[str, float] = dataclasses.field(default_factory=dict)
    notes: typing.Dict = dataclasses.field(default_factory=dict)  # noqa: UP006


@pytest.fixture
def vases():
    registry = Registry(kind="vase", group="test.vases")
    registry.register("vase")(Vase)
    return registry


def test_a_default_that_a_dataclass_makes_is_told_as_it_is_made(vases):
    described = [option.describe() for option in vases.options("vase").values()]
    assert described == [
        "shade=DARK (DARK|BRIGHT)",
        "file=null (Path or null)",
        "heights=[1.0,2.0] (list of float)",
        "size=[3,cm] (list of int and str)",
        "curve=[0. 0.] (list of numbers)",
        "lid=null (float)",
        "parts={} (dict)",
        "notes={} (Dict)",
    ]


def test_a_value_comes_as_the_class_annotates_it(vases):
    vase = vases.make("vase", shade="BRIGHT", file="a.csv", heights=[1, 2], size=[4, "mm"], curve=[1, 2], lid=None)
    assert (vase.shade, vase.file, vase.heights, vase.size) == (Shade.BRIGHT, Path("a.csv"), [1.0, 2.0], (4, "mm"))
    assert vase.curve.dtype == float
    assert vase.curve.tolist() == [1.0, 2.0]
    assert vases.make("vase", shade="b").shade is Shade.BRIGHT  # by its value where no member has that name
    assert vases.make("vase", lid=2).lid == 2.0
    assert repr(vases.make("vase", parts={"a": 2, "b": 0.5}).parts) == "{'a': 2.0, 'b': 0.5}"
    assert vases.make("vase", notes={"a": 2}).notes == {"a": 2}
    assert vases.make("vase", curve=np.array([1, 2])).curve.dtype == float
    assert (
        coerce("n", np.array([1, 2]), NDArray[np.int64]).dtype == coerce("n", [1.0, 2], NDArray[np.int64]).dtype == int
    )
    assert coerce("rough", np.True_, bool) is True
    assert repr(coerce("level", -0.0, float)) == "0.0"
    assert coerce("one", [7], tuple[int]) == (7,)
    assert coerce("some", [7, 8], tuple[int, ...]) == (7, 8)
    with pytest.raises(ValueError, match=r"one=\[7,8\]: a list of 1 is needed"):
        coerce("one", [7, 8], tuple[int])


@pytest.mark.parametrize(
    ("option", "value", "match"),
    [
        ("shade", "black", "vase.shade=black: choices: DARK, BRIGHT"),
        ("heights", 3.0, r"vase.heights=3.0: a list is needed"),
        ("heights", ["tall"], r"vase.heights=tall: a finite number is needed"),
        ("size", [1], r"vase.size=\[1\]: a list of 2 is needed"),
        ("curve", ["a", "b"], r"vase.curve=\[a,b\]: a list of finite numbers is needed"),
        ("parts", [1], r"vase.parts=\[1\]: names with values are needed"),
        ("size", None, "vase.size=null: a list is needed"),
    ],
)
def test_a_value_of_another_kind_is_refused_in_words(vases, option, value, match):
    refused(match, lambda: vases.make("vase", **{option: value}))


@dataclass(frozen=True)
class Lid:
    weight: float = 0.5
    holes: int = 3


@dataclass(frozen=True)
class Pan:
    handle: str
    lid: Lid = dataclasses.field(default_factory=lambda: Lid(weight=2.0))
    spare: Lid | None = None


def test_a_dataclass_is_taken_by_its_fields_and_keeps_those_of_the_default():
    pans = Registry(kind="pan", group="test.pans")
    pans.register("pan")(Pan)
    assert pans.make("pan", handle="oak", lid={"holes": 5.0}).lid == Lid(weight=2.0, holes=5)
    assert pans.make("pan", handle="oak", spare={"holes": 5}).spare == Lid(weight=0.5, holes=5)
    assert pans.make("pan", handle="oak", lid=Lid(), spare=None) == Pan("oak", Lid())
    assert pans.option("pan", "spare.holes").type is int
    refused(
        "pan.lid has no option 'hole'; did you mean 'holes'\\? choices: weight, holes",
        lambda: pans.make("pan", handle="oak", lid={"hole": 1}),
    )
    refused("pan.lid.holes=1.5: a whole number is needed", lambda: pans.make("pan", handle="oak", lid={"holes": 1.5}))
    refused("pan.lid=3: names with values are needed", lambda: pans.make("pan", handle="oak", lid=3))
    refused("pan.lid has no option 'hole'", lambda: pans.option("pan", "lid.hole"))
    refused("pan has no option 'handle.x', as handle is one value", lambda: pans.option("pan", "handle.x"))


def test_a_member_of_an_enumeration_is_read_back_from_what_rows_write():
    class Metal(Enum):
        TIN = 1
        IRON = 2

    told = f"{Metal.__module__}:{Metal.__qualname__}.IRON"
    assert coerce("metal", told, Metal) is Metal.IRON


@pytest.mark.skipif(sys.version_info < (3, 12), reason="the type statement came with Python 3.12")
def test_a_named_type_is_what_it_stands_for():
    made = {"Literal": Literal, "Shade": Shade}
    exec(
        "type Few[T] = list[T]\ntype Heights = Few[float]\ntype Mode = Literal['slow', 'fast']\n"
        "def jar(heights: Heights = (), mode: Mode = 'slow', shade: Shade | Mode = 'slow'): ...",
        made,
    )
    told = [option.describe() for option in declared_options(made["jar"]).values()]
    assert told == ["heights=[] (list of float)", "mode=slow (slow|fast)", "shade=slow (DARK|BRIGHT or slow|fast)"]
    assert coerce("jar.heights", [1], made["Heights"]) == [1.0]
    refused("jar.mode=quick: choices: slow, fast", lambda: coerce("jar.mode", "quick", made["Mode"]))


class Called(Protocol):
    def __call__(self, x: float) -> float: ...


@pytest.mark.parametrize("kind", [Callable, Callable[[float], float], Called, Callable[[float], float] | None])
@pytest.mark.parametrize("value", ["abc", 3, 0.5, True])
def test_a_word_in_the_place_of_a_function_is_refused_with_the_way_out(kind, value):
    with pytest.raises(ValueError, match=r"^p\.k="):
        coerce("p.k", value, kind)
    assert coerce("p.k", abs, kind) is abs


def test_a_word_in_the_place_of_an_object_is_refused_in_words():
    with pytest.raises(ValueError, match=r"p\.rng=3"):
        coerce("p.rng", 3, np.random.Generator | None)
    with pytest.raises(ValueError, match=r"p\.some=abc: a list is needed"):
        coerce("p.some", "abc", set[int])
    rng = np.random.default_rng(0)
    assert coerce("p.rng", rng, np.random.Generator) is rng


@pytest.mark.parametrize(
    ("kind", "value"),
    [
        (Callable | str, "abc"), (os.PathLike, "a.csv"), (complex, 3), (Fraction, 3), (np.float64, 0.5),
        (Iterable[str], "abc"), (object, "abc"), (set[int], [1]),
    ],
)  # fmt: skip
def test_a_word_that_may_be_meant_is_taken(kind, value):
    assert coerce("p.k", value, kind) == value


@dataclass
class Cup:
    share: typing.Annotated[float, Range(0, 1)] = 0.5
    handles: typing.Annotated[int | None, Range(0, above=True, unit="of clay")] = None
    rims: typing.Annotated[tuple[float, ...], "mm", Range(1)] = (1.0,)


def test_a_range_that_an_option_is_annotated_with_is_kept_and_no_part_of_its_type():
    registry = Registry(kind="cup", group="test.cups")
    registry.register("cup")(Cup)
    described = [option.describe() for option in registry.options("cup").values()]
    assert described == ["share=0.5 (float)", "handles=null (int or null)", "rims=[1.0] (list of float)"]
    assert registry.make("cup", share=1, handles=None, rims=[1, 2]) == Cup(1.0, None, (1.0, 2.0))
    for options, said in [
        ({"share": 1.5}, r"cup\.share=1\.5: must lie in 0 \.\. 1$"),
        ({"handles": 0}, r"cup\.handles=0: must be above 0 \(of clay\)$"),
        ({"rims": [2, 0.5]}, r"cup\.rims=\[2,0\.5\]: must be 1 or more$"),
    ]:
        with pytest.raises(ValueError, match=said):
            registry.make("cup", **options)
