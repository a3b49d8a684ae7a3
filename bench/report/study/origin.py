"""The versions, commits, machines and dates of the runs of a study; more than one where they differ."""

from __future__ import annotations

import json

import pandas as pd


def versions(runs: pd.DataFrame) -> dict[str, list[str]]:
    """Return the versions that the runs were made with; of a package more than one where they differ."""
    versions: dict[str, list[str]] = {}
    for text in runs["versions"].dropna().unique():
        for package, version in json.loads(text).items():
            if version and version not in versions.setdefault(package, []):
                versions[package].append(version)
    return {package: found for package, found in versions.items() if found}


def commits(runs: pd.DataFrame) -> str:
    """Return the commits, and whether something stood uncommitted beside them."""
    commits = runs[["git_commit", "git_dirty"]].drop_duplicates().to_numpy().tolist()
    return ", ".join(f"{c[:10]}{' with uncommitted changes' if d is True else ''}" for c, d in commits if c)


def machines(runs: pd.DataFrame) -> str:
    """Return the platforms."""
    return ", ".join(runs["platform"].dropna().unique())


def began(runs: pd.DataFrame) -> str:
    """Return when the first and the last run were begun, to the minute."""
    began = runs["started_at"].dropna()
    if began.empty:
        return ""
    first, last = f"{began.min():%Y-%m-%d %H:%M}", f"{began.max():%Y-%m-%d %H:%M}"
    return f"{first} UTC" if first == last else f"{first} to {last} UTC"
