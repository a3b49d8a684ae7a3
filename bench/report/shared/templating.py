"""The one Jinja2 environment of all pages: text is escaped wherever it stands, and a value that is missing is an error.

A template is named by its path below the package ``calibench.bench``. `render` makes a whole page; `macros` gives the
macros of a template to who builds the cells of a table. No HTML is put together anywhere else.
"""

from __future__ import annotations

from functools import cache
from importlib.resources import files
from typing import Any

from jinja2 import Environment, FunctionLoader, StrictUndefined
from markupsafe import Markup


def render(template: str, **values: Any) -> str:
    """Return the page that `template` makes of `values`. Raises `jinja2.UndefinedError` for a value that is missing."""
    return _environment().get_template(template).render(values)


@cache
def macros(template: str) -> Any:
    """Return the macros of `template` as functions, by name: text in, safe `Markup` out."""
    return _environment().get_template(template).module


@cache
def _environment() -> Environment:
    environment = Environment(
        loader=FunctionLoader(_source), autoescape=True, undefined=StrictUndefined, trim_blocks=True, lstrip_blocks=True
    )
    environment.globals["css"] = _css
    return environment


def _css(name: str) -> Markup:
    """Return a style sheet of ours as it is."""
    return Markup(_source(name))


def _source(name: str) -> str:
    return files("calibench.bench").joinpath(*name.split("/")).read_text(encoding="utf-8")
