"""A verdict in an engineer's words: the same sentences on the terminal and on the page.

They are made from the report as JSON has it (`report.to_dict()`), so a stored report reads as a fresh one.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from bench.discovery.page.quantity import amount

_FAMILIES = {
    "gear": "gear-ratio error",
    "cyclic": "cyclic error at the tooth count",
    "lag": "timing lag",
    "slip": "encoder slip",
    "drift": "drift",
    "outlier": "outlying readings",
    "heavy_tails": "heavy-tailed noise",
    "quantisation": "coarse quantisation",
    "thermal_links": "thermal growth",
    "thermal_leg": "thermal growth",
    "thermal_legs": "thermal growth",
    "thermal_drives": "thermal shift",
    "thermal_base": "thermal growth of the base",
    "scale": "encoder-scale error",
}

_NOISE = {"outlier": "spread", "quantisation": "step", "heavy_tails": "excess kurtosis"}  # and what their size is
_OF_ALL = {
    "thermal_links": "thermal growth of all links", "thermal_legs": "thermal growth of all legs",
    "thermal_base": "thermal growth of the base", "thermal_drives": "thermal shift of all drives",
    "lag": "timing lag of all encoders", "gravity": "gravity",
    "heavy_tails": "heavy-tailed noise",
}  # fmt: skip
_PATTERNS = ("common", "cyclic", "mirrored")  # one number for the three axes of the Orthoglide
_PARAMETERS = {
    "la": "proximal link {}", "lb": "distal link {}", "xa": "x of base {}", "ya": "y of base {}",
    "z": "encoder zero of joint {}", "drho_": "joint offset of leg {}", "dL_": "length of leg {}, above nominal",
}  # fmt: skip
_OF_JOINT = {"enc": "angle", "dir": "direction", "vel": "velocity", "tau": "torque", "axial": "axial force"}
_COLUMNS = {
    "t_s": "time", "temp_K": "temperature above reference", "deviation": "the reading", "load_x": "load along x",
    "load_y": "load along y", "place": "place in the workspace", "payload_N": "payload", "place_x": "x of the tool",
    "place_y": "y of the tool",
}  # fmt: skip


def headline(report: Mapping[str, Any]) -> str:
    """Return the verdict in one sentence, with amplitude and interval where an effect is named."""
    findings = report.get("findings", [])
    verdict = report["verdict"]
    laws = [_claim(f) for f in findings if is_noise(f)]
    if verdict == "none":
        return "Nothing is missing from the model that these data could show."
    if verdict == "negligible":
        which = f" ({_join([_claim(f) for f in findings])})" if findings else ""
        return f"Something is missing{which}, but it is too small to matter against the noise."
    if verdict == "unknown":
        known = [f for f in findings if f.get("family") not in (None, "", "unknown")]
        where = f"; the clearest sign is at {place[0]}, {place[1]}" if (place := _place(report)) else ""
        beside = f" beside {_join([_claim(f) for f in known])}" if known else ""
        return f"Something is missing that no effect of the catalogue explains{beside}{where}."
    claims = [_claim(f) for f in findings if not is_noise(f)]
    said = [f"Missing from the model: {'; and '.join(claims)}."] if claims else []
    said += [f"The noise is not as stated: {'; and '.join(laws)}."] if laws else []
    return " ".join(said)


def is_noise(finding: Mapping[str, Any]) -> bool:
    """Tell whether a finding blames the noise: it moves no mean, it says which readings to trust less."""
    return str(finding.get("family")) in _NOISE


def gap_sentence(report: Mapping[str, Any]) -> str:
    """Return what adding the effect does to the error on readings that were not fitted."""
    gap = report.get("gap") or {}
    unseen = gap.get("held_out_before") is not None
    before, after = (gap.get(f"{'held_out' if unseen else 'train'}_{when}") for when in ("before", "after"))
    floor, interval = gap.get("noise_floor"), gap.get("held_out_ci95")
    if before is None or floor is None:
        return "The gap between model and data could not be measured."
    left_out = (
        "On poses left out of the fit in turn" if gap.get("cross_validated") else "On readings that were not fitted"
    )
    where = left_out if unseen else "On the fitted readings (none were held out)"
    ends = None if not interval or None in interval else f" (95 %: {interval[0]:.2f} to {interval[1]:.2f})"
    unit = " times the stated noise" if gap.get("unit", "sigma") == "sigma" else f" {gap['unit']}"
    said = f"{where} the error is {before:.2f}{unit}"
    if report["verdict"] == "none" or after is None or after == before:
        return f"{said}{ends or ''}; noise alone leaves {floor:.2f}."
    without, with_it = compared(report)
    shrink = gap.get("excess_shrink")
    share = f"; {100 * shrink:.0f} % of the excess is gone" if shrink is not None and after < before else ""
    share = "; what was added makes it no smaller" if after >= before else share
    return f"{said} {without} and {after:.2f}{ends or ''} {with_it}; noise alone leaves {floor:.2f}{share}."


def compared(report: Mapping[str, Any]) -> tuple[str, str]:
    """Return what the two errors of the gap are of, in words."""
    findings = report.get("findings", [])
    if report["verdict"] == "unknown":
        return "for the model as it is", "with a smooth correction without a name"
    if findings and all(is_noise(f) for f in findings):
        return "with the noise as stated", "with the noise as found"
    many = sum(not is_noise(f) for f in findings) > 1
    return ("without the effects", "with them") if many else ("without the effect", "with it")


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
    if abs(in_sd) < 0.05:
        return ""
    size = amount(moved, units.get(name, "1")).split(" (")[0]
    which = f"{name} ({words})" if (words := parameter_words(name)) else name
    return f"Of the calibrated parameters, {which} moves furthest: by {size}, {abs(in_sd):.1f} standard errors."


def chance_sentence(report: Mapping[str, Any]) -> str:
    """Return how often data would look so if nothing were missing."""
    p = report.get("p")
    if p is None:
        return ""
    findings = report.get("findings", [])
    if p >= 0.01 and findings and all(is_noise(f) for f in findings):
        return f"Beside this noise nothing missing shows: {100 * p:.0f} of 100 sound machines look at least so odd."
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
    ends = (float(interval[0]), float(interval[1])) if interval and None not in interval else None
    unit = "" if finding.get("family") == "heavy_tails" else str(size.get("unit", ""))  # a kurtosis is no share
    return amount(float(size["value"]), unit, ends)


def next_sentences(report: Mapping[str, Any]) -> list[str]:
    """Return what to measure next, once each."""
    said = [f"{f['separated_by']}." for f in report.get("findings", []) if f.get("separated_by")]
    place = _place(report) if report["verdict"] == "unknown" else None
    if report["verdict"] == "unknown" and not place:
        said.append("more poses, each with repeats: these readings do not tell where it sits.")
    if place:
        said.append(f"readings with repeats, spread evenly {place[1]}, would show the shape of what is missing.")
    if report["verdict"] == "unknown" and (columns := column_sentence(report)):
        said.append(columns)
    return list(dict.fromkeys(said))


def column_sentence(report: Mapping[str, Any]) -> str:
    """Return which columns would let more effects be tested; empty where none is missing."""
    by_column: dict[str, list[str]] = {}
    for item in report.get("not_testable", []):
        needed, _, columns = str(item["reason"]).partition(" ")
        columns = columns.removeprefix("columns ").removeprefix("column ")
        if needed == "needs":
            words = effect_words(str(item["family"]), "")
            for column in columns.split(", "):
                by_column.setdefault(column, []).append(words)
    asked: dict[tuple[str, ...], list[str]] = {}
    for column, names in by_column.items():
        asked.setdefault(tuple(dict.fromkeys(names)), []).append(column)
    told = [f"{', '.join(columns)} ({_join(_widest(names))})" for names, columns in asked.items()]
    return f"columns that would let more effects be tested: {'; '.join(told)}." if told else ""


def _widest(names: Sequence[str]) -> list[str]:
    """Return the names without those that say another one more narrowly."""
    return [name for name in names if not any(name.startswith(f"{other} ") for other in names)]


def effect_words(family: str, target: str) -> str:
    """Return an effect in words.

    >>> effect_words("backlash", "joint 2"), effect_words("thermal_links", "all")
    ('backlash of joint 2', 'thermal growth of all links')
    """
    words = _FAMILIES.get(family, family.replace("_", " "))
    if target in ("", "tracker"):
        return words
    if target == "all":
        return _OF_ALL.get(family, f"{words} (all)")
    if target in _PATTERNS:
        return f"{words}, {target} in the three axes"
    kind = target.partition(" ")[0]
    return f"{words.removeprefix(f'{kind} ')} of {target}"  # not "base shift of base 1"


def column_words(name: str) -> str:
    """Return the name of a column, quantity or covariate in words.

    >>> column_words("enc_2"), column_words("dir_1"), column_words("lb3"), column_words("t_s")
    ('angle of joint 2', 'direction of joint 1', 'distal link 3', 'time')
    """
    head, _, number = name.partition("_")
    if head in _OF_JOINT and number.isdigit():
        return f"{_OF_JOINT[head]} of joint {number}"
    return _COLUMNS.get(name) or parameter_words(name) or name.replace("_", " ")


def parameter_words(name: str) -> str:
    """Return what a calibrated parameter of the machines that ship is; empty for one of another machine.

    >>> parameter_words("la1"), parameter_words("drho_y"), parameter_words("offset")
    ('proximal link 1', 'joint offset of leg y', '')
    """
    words = _PARAMETERS.get(name[:-1])
    return words.format(name[-1]) if words else ""


def _claim(finding: Mapping[str, Any]) -> str:
    """Return a finding with its size: one name, or the set that the data cannot tell apart."""
    rivals = finding.get("set") or [finding]
    names = [effect_words(str(r.get("family", "")), str(r.get("target", ""))) for r in rivals]
    size = size_of(finding)
    told = f", {_NOISE.get(str(finding.get('family')), '')} {size}".replace("  ", " ") if size else ""
    if len(names) == 1:
        return f"{names[0]}{told}"
    size = f": {told.removeprefix(', ')} if it is the first" if told else ""
    return f"{_join(names, 'or')} (these data cannot tell which){size}"


def _place(report: Mapping[str, Any]) -> tuple[str, str] | None:
    """Return where an unnamed disagreement is strongest: a target, and over what, in words."""
    places = sorted((w for w in report.get("where", []) if w.get("p") is not None), key=lambda w: float(w["p"]))
    if not places or places[0]["p"] > 0.01:
        return None
    covariate = str(places[0]["covariate"])
    return str(places[0]["target"]), "over time" if covariate == "t_s" else f"over the {column_words(covariate)}"


def _join(parts: Sequence[str], last: str = "and") -> str:
    return parts[0] if len(parts) == 1 else f"{', '.join(parts[:-1])} {last} {parts[-1]}"
