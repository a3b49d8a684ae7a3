"""The printed numbers as data: nothing without a unit, no correction without a reason, no cell missing."""

import pytest

from calibench.problems import constants

CELLS = {"table1": 18, "table2": 26, "table3": 51, "table4": 51, "table5": 48, "table6": 9, "table7": 25, "table8": 24}
UNITS = {"mm", "rad", "1", "mm^2", "mm^4", "mm or rad"}
KEYS = {"value", "unit", "printed", "why", "certain", "doubt", "kind"}
KINDS = ("input", "setting", "result")


def quantities(node, path=""):
    """Yield (path, entry) of every quantity below a node of the data file."""
    for name, entry in node.items():
        if isinstance(entry, dict):
            here = f"{path}.{name}".lstrip(".")
            if "value" in entry or "unit" in entry or "printed" in entry:
                yield here, entry
            else:
                yield from quantities(entry, here)


QUANTITIES = dict(quantities(constants.document("cong2008")))
COLUMNS = sorted({path.rpartition(".")[0] for path in QUANTITIES})


@pytest.mark.parametrize("table", CELLS)
def test_no_cell_of_a_printed_table_is_missing(table):
    assert sum(path.startswith(f"{table}.") for path in QUANTITIES) == CELLS[table]


def test_there_are_no_other_tables():
    assert {path.split(".")[0] for path in QUANTITIES if path.startswith("table")} == set(CELLS)


def test_a_quantity_has_a_value_a_unit_and_nothing_unknown():
    for path, entry in QUANTITIES.items():
        assert isinstance(entry["value"], int | float), path
        assert not isinstance(entry["value"], bool), path
        assert entry["unit"] in UNITS, path
        assert set(entry) <= KEYS, path


@pytest.mark.parametrize("path", [path for path, entry in QUANTITIES.items() if "printed" in entry])
def test_a_misprint_carries_a_reason_and_says_how_certain_it_is(path):
    entry = QUANTITIES[path]
    assert entry["printed"] != entry["value"]
    assert len(entry["why"]) > 20
    assert isinstance(entry["certain"], bool)


def test_what_is_not_a_misprint_explains_no_correction():
    sound = {path: entry for path, entry in QUANTITIES.items() if "printed" not in entry}
    assert len(sound) > 250
    assert [path for path, entry in sound.items() if {"why", "certain"} & set(entry)] == []


def test_the_misprints_are_those_that_were_found():
    misprints = {path for path, entry in QUANTITIES.items() if "printed" in entry}
    assert misprints == {
        *(f"table3.{column}.la3" for column in ("j1", "j2", "j3")),
        *(f"table4.j3_12.{cell}" for cell in ("la1", "la2", "la3", "lb2", "lb3")),
        "table4.j3_11.la3",
        "table7.de_j3.ya2",
        "table7.de_j3.kmrmse",
        "text.kmrmse",
        "text.largest_error",
    }


@pytest.mark.parametrize("key", COLUMNS)
def test_every_quantity_is_read_as_it_stands_with_its_place(key):
    column = constants.column("cong2008", key)
    assert {f"{key}.{name}" for name in column} == {path for path in QUANTITIES if path.rpartition(".")[0] == key}
    for name, cell in column.entries.items():
        entry = QUANTITIES[f"{key}.{name}"]
        assert (cell.value, cell.unit) == (entry["value"], entry["unit"])
        assert cell.printed == entry.get("printed", entry["value"])
        assert cell.is_misprint == ("printed" in entry)
        assert (cell.why, cell.doubt) == (entry.get("why", ""), entry.get("doubt", ""))
        assert cell.certain == entry.get("certain", True)
        assert cell.place == column.place
        assert cell.place.startswith(("Table ", "Section", "Sections"))


def test_a_column_keeps_the_printed_order_and_answers_by_name():
    column = constants.column("cong2008", "table4.j3_12")
    assert list(column) == [
        "z1", "z2", "z3", "la1", "la2", "la3", "lb1", "lb2", "lb3", "xa3", "ya3", "xa2", "kmrmse", "iterations",
    ]  # fmt: skip
    assert column["xa2"] == 440.3557
    assert "ya2" not in column
    assert "xa2" in column


def test_an_unknown_column_or_quantity_is_a_key_error():
    with pytest.raises(KeyError):
        constants.column("cong2008", "table9.actual")
    with pytest.raises(KeyError):
        constants.column("cong2008", "table2.actual")["xa2"]


@pytest.mark.parametrize("number", range(len(constants.document("cong2008")["erratum"])))
def test_an_erratum_says_where_what_is_printed_what_to_read_and_why(number):
    erratum = constants.document("cong2008")["erratum"][number]
    assert set(erratum) - {"about"} == {"place", "printed", "read", "why", "certain"}
    assert set(erratum.get("about", ())) <= set(QUANTITIES)
    assert all(str(erratum[key]).strip() for key in ("place", "printed", "read", "why"))


@pytest.mark.parametrize("paper", ["cong2008", "pashkevich2008"])
def test_every_column_says_what_kind_of_numbers_it_holds(paper):
    def walk(node):
        if "place" in node:
            assert node["kind"] in KINDS, node["place"]
        for below in node.values():
            if isinstance(below, dict):
                assert below.get("kind", "input") in KINDS
                walk(below)

    walk(constants.document(paper))


def test_a_column_s_numbers_are_of_its_kind_unless_they_say_another():
    column = constants.column("cong2008", "section33").entries
    assert (column["samples_c"].kind, column["parameters_identified"].kind) == ("setting", "result")


def test_every_misprinted_cell_has_an_erratum_for_its_table():
    places = " ".join(erratum["place"] for erratum in constants.document("cong2008")["erratum"])
    for table in ("Table 3", "Table 4", "Table 7, row ya2", "Table 7, kmrmse"):
        assert table in places


def test_the_link_lengths_of_sections_3_and_4_differ_in_l_b3_only():
    # l_b3 is 244.2 in Tables 3-4 and 244.6 in Tables 5-7, both genuine: two simulated machines
    earlier, later = (constants.column("cong2008", key) for key in ("table4.actual", "table5.actual"))
    lengths = [f"{link}{i}" for link in ("la", "lb") for i in (1, 2, 3)]
    assert [name for name in lengths if earlier[name] != later[name]] == ["lb3"]
