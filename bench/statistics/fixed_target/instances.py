"""Instances of one problem taken together: the same but for the options that choose the instance, and its data."""

from __future__ import annotations

import json
from collections.abc import Sequence

import pandas as pd

from calibench.bench.provenance.run_id import canonical
from calibench.core.options import suggest


def pooled(runs: pd.DataFrame, options: Sequence[str]) -> pd.DataFrame:
    """Return `runs` with the instances of a problem as one problem, and a column `instance` that tells them apart.

    `options` of the problem, such as ("instance",), choose the instance; without any, a problem is its only instance.
    """
    if not options:
        return runs.assign(instance="")
    texts = {text: json.loads(text) for text in runs["problem_options"].unique()}
    known = {key for held in texts.values() for key in held}
    for key in options:
        if key not in known:
            raise ValueError(f"no problem of these runs has an option {key!r}; {suggest(key, sorted(known))}")
    rest = {
        text: canonical({key: value for key, value in held.items() if key not in options})
        for text, held in texts.items()
    }
    own = {text: canonical({key: held[key] for key in options if key in held}) for text, held in texts.items()}
    has = runs["problem_options"].map({text: bool(own[text] != "{}") for text in texts}).to_numpy(dtype=bool)
    instance = runs["problem_options"].map(own).astype(str) + " " + runs["data_id"].astype(str)
    return runs.assign(
        problem_options=runs["problem_options"].map(rest),
        data_id=runs["data_id"].where(~has, ""),
        instance=instance.where(has, ""),
    )
