"""A verdict in an engineer's words: the same sentences on the terminal and on the page.

They are made from the report as JSON has it (`report.to_dict()`), so a stored report reads as a fresh one.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from bench.quantity import amount

_FAMILIES = {
    "angle_error": "angle error of the encoder, harmonic order unresolved,",
    "gear": "gear-ratio or encoder-scale error",
    "cyclic": "cyclic error at the tooth count",
    "lag": "timing lag",
    "slip": "encoder slip",
    "drift": "drift",
    "outlier": "outlying readings",
    "heavy_tails": "heavy-tailed noise",
    "quantisation": "coarse quantisation",
    "thermal_links": "thermal growth of the links",
    "thermal_leg": "thermal growth of the links",
    "thermal_legs": "thermal growth of the legs",
    "thermal_base": "thermal growth of the base",
    "compliance": "joint compliance",
    "scale": "encoder-scale error",
}

_OF_JOINT = {"enc": "angle", "dir": "direction", "vel": "velocity", "tau": "torque", "axial": "axial force"}
_COLUMNS = {
    "t_s": "time", "temp_K": "temperature above reference", "deviation": "the reading", "load_x": "load along x",
    "load_y": "load along y", "place": "place in the workspace", "payload_N": "payload",
}  # fmt: skip


def headline(report: Mapping[str, Any]) -> str:
    """Return the verdict in one sentence, with amplitude and interval where an effect is named."""
    findings = report.get("findings", [])
    verdict = report["verdict"]
    if verdict == "none":
        return "Nothing is missing from the model that these data could show."
    if verdict == "negligible":
        which = f" ({_join([_claim(f) for f in findings])})" if findings else ""
        return f"Something is missing{which}, but it is too small to matter against the noise."
    if verdict == "unknown":
        known = [f for f in findings if f.get("family") not in (None, "", "unknown")]
        beside = f" beside {_join([_claim(f) for f in known])}" if known else ""
        return f"Something is missing that no effect of the catalogue explains{beside}{_place(report)}."
    claims = [_claim(f) for f in findings]
    return f"Missing from the model: {claims[0] if len(claims) == 1 else '; and '.join(claims)}."


def gap_sentence(report: Mapping[str, Any]) -> str:
    """Return what adding the effect does to the error on readings that were not fitted."""
    gap = report.get("gap") or {}
    unseen = gap.get("held_out_before") is not None
    before, after = (gap.get(f"{'held_out' if unseen else 'train'}_{when}") for when in ("before", "after"))
    floor, interval = gap.get("noise_floor"), gap.get("held_out_ci95")
    if before is None or floor is None:
        return "The gap between model and data could not be measured."
    where = "On readings that were not fitted" if unseen else "On the fitted readings (none were held out)"
    ends = None if not interval or None in interval else f" (95 %: {interval[0]:.2f} to {interval[1]:.2f})"
    unit = " times the stated noise" if gap.get("unit", "sigma") == "sigma" else f" {gap['unit']}"
    said = f"{where} the error is {before:.2f}{unit}"
    if report["verdict"] == "none" or after is None or after == before:
        return f"{said}{ends or ''}; noise alone leaves {floor:.2f}."
    shrink = gap.get("excess_shrink")
    share = f"; {100 * shrink:.0f} % of the excess is gone" if shrink is not None else ""
    return f"{said} without the effect and {after:.2f}{ends or ''} with it; noise alone leaves {floor:.2f}{share}."


def moved_sentence(report: Mapping[str, Any], units: Mapping[str, str]) -> str:
    """Return which calibrated parameter moves furthest, in its standard errors, when the effect is added."""
    moves = {
        name: ((p["after"] - p["before"]) / p["sd"], p["after"] - p["before"])
        for name, p in (report.get("parameters") or {}).items()
        if None not in (p.get("before"), p.get("after"), p.get("sd")) and p["sd"] > 0
    }
    if report["verdict"] in ("none", "unknown") or not moves:
        return ""
    name = max(moves, key=lambda key: abs(moves[key][0]))
    in_sd, moved = moves[name]
    size = amount(moved, units.get(name, "1")).split(" (")[0]
    return f"Of the calibrated parameters, {name} moves furthest: by {size}, {abs(in_sd):.1f} standard errors."


def chance_sentence(report: Mapping[str, Any]) -> str:
    """Return how often data would look so if nothing were missing."""
    p = report.get("p")
    if p is None:
        return ""
    if p >= 0.01:
        return f"If nothing were missing, data would look at least so odd in {100 * p:.0f} of 100 cases: no alarm."
    often = "fewer than 1 of 100 000" if p < 1e-5 else f"1 of {round(1 / p, -1 if p < 0.002 else 0):.0f}"
    return f"If nothing were missing, data would look so odd in {often} cases."


def size_of(finding: Mapping[str, Any]) -> str:
    """Return a finding's amplitude with its interval; empty where it has none."""
    size = finding.get("amplitude") or {}
    interval = size.get("ci95")
    if size.get("value") is None:
        return ""
    whole = interval is not None and None not in interval
    return amount(float(size["value"]), str(size.get("unit", "")), tuple(interval) if whole else None)


def next_sentences(report: Mapping[str, Any]) -> list[str]:
    """Return what to measure next, once each."""
    said: list[str] = []
    for finding in report.get("findings", []):
        advice = finding.get("separated_by")
        said += [advice] if isinstance(advice, str) else [str(a) for a in advice or ()]
    return list(dict.fromkeys(s for s in said if s))


def effect_words(family: str, target: str) -> str:
    """Return an effect in words.

    >>> effect_words("backlash", "joint 2"), effect_words("thermal_links", "all")
    ('backlash of joint 2', 'thermal growth of the links')
    """
    words = _FAMILIES.get(family, family.replace("_", " "))
    if target == "all" and family == "lag":
        return f"{words} of all encoders"
    return words.rstrip(",") if target in ("", "all", "tracker") else f"{words} of {target}"


def column_words(name: str) -> str:
    """Return the name of a column, quantity or covariate in words.

    >>> column_words("enc_2"), column_words("dir_1"), column_words("lb3"), column_words("t_s")
    ('angle of joint 2', 'direction of joint 1', 'lb3', 'time')
    """
    head, _, number = name.partition("_")
    if head in _OF_JOINT and number.isdigit():
        return f"{_OF_JOINT[head]} of joint {number}"
    return _COLUMNS.get(name, name.replace("_", " "))


def _claim(finding: Mapping[str, Any]) -> str:
    """Return a finding with its size: one name, or the set that the data cannot tell apart."""
    rivals = finding.get("set") or [finding]
    names = [effect_words(str(r.get("family", "")), str(r.get("target", ""))) for r in rivals]
    size = finding.get("amplitude") or {}
    value, interval = size.get("value"), size.get("ci95")
    told = (
        "" if value is None else f", {amount(value, str(size.get('unit', '')), tuple(interval) if interval else None)}"
    )
    if len(names) == 1:
        return f"{names[0]}{told}"
    size = f", as {effect_words(finding['family'], finding['target'])}{told}" if told else ""
    return f"{_join(names, 'or')} (these data cannot tell which){size}"


def _place(report: Mapping[str, Any]) -> str:
    """Return where an unnamed disagreement is strongest."""
    places = sorted((w for w in report.get("where", []) if w.get("p") is not None), key=lambda w: float(w["p"]))
    if not places or places[0]["p"] > 0.01:
        return ""
    return f"; it is strongest at {places[0]['target']}, over the {column_words(str(places[0]['covariate']))}"


def _join(parts: Sequence[str], last: str = "and") -> str:
    return parts[0] if len(parts) == 1 else f"{', '.join(parts[:-1])} {last} {parts[-1]}"
