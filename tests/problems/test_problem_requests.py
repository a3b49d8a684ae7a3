"""Wrong requests for a problem: each is a `ValueError` of one line that names the argument and the way out."""

import pytest

from calibench import problems

REFUSED = {
    "an unknown problem": (("fulll12", {}), "unknown problem 'fulll12'; did you mean 'full12'"),
    "a name in capitals": (("FULL12", {}), "did you mean 'full12'"),
    "a name like nothing": (("zzz", {}), "choices: sensor_zero, link_length, full11, full12"),
    "an unknown option": (("full12", {"gage": "ya2"}), "full12 has no option 'gage'; did you mean 'gauge'"),
    "an option of another problem": (("sensor_zero", {"gauge": "ya2"}), "sensor_zero has no option 'gauge'"),
    "an unknown error function": (("full12", {"error": "J4"}), r"full12\.error=J4: choices: J1, J2, J3"),
    "error in small letters": (("full12", {"error": "j3"}), r"full12\.error=j3: .*choices: J1, J2, J3"),
    "J3 for sensor_zero": (("sensor_zero", {"error": "J3"}), r"sensor_zero\.error=J3: .*choices: J1, J2"),
    "an unknown plan": (("full11", {"plan": "disk"}), r"full11\.plan=disk: did you mean 'disc'"),
    "an unknown gauge": (("full12", {"gauge": "xa3"}), r"full12\.gauge=xa3: .*choices: xa2, ya2"),
    "an unknown section": (("full11", {"paper_section": 5}), r"full11\.paper_section=5: .*choices: 3, 4"),
    "too few samples for 12": (("full12", {"n": 11}), r"full12\.n=11: 12 parameters need at least 12 configurations"),
    "too few samples for 3": (("sensor_zero", {"n": 2}), r"sensor_zero\.n=2: 3 parameters need at least 3"),
    "no samples": (("full12", {"n": 0}), r"full12\.n=0"),
    "a negative number of samples": (("full12", {"n": -5}), r"full12\.n=-5"),
    "half a sample": (("full12", {"n": 50.5}), r"full12\.n=50\.5: a whole number is needed"),
    "samples in words": (("full12", {"n": "many"}), r"full12\.n=many: a whole number is needed"),
    "negative noise": (
        ("full12", {"noise": -1e-4}),
        r"noise=-0\.0001: must lie in 0 \.\. 1 \(a standard dev",
    ),
    "noise that is no number": (("full12", {"noise": float("nan")}), r"full12\.noise=nan: a finite number"),
    "infinite noise": (("full12", {"noise": float("inf")}), r"full12\.noise=inf: a finite number"),
    "radius zero": (("full12", {"radius": 0.0}), r"full12\.radius=0: must be above 0 mm"),
    "a negative radius": (("full12", {"radius": -10}), r"full12\.radius=-10: must be above 0 mm"),
    "out of reach": (
        ("full12", {"radius": 400.0, "plan": "circle"}),
        r"full12\.radius=400: position \(.*\) mm is out of reach of leg [123]; take a smaller radius",
    ),
    "a grid of a prime number": (("full12", {"plan": "grid", "n": 53}), r"full12\.n=53: a grid needs rows and columns"),
    "a negative data seed": (("full12", {"data_seed": -1}), r"full12\.data_seed=-1: must be 0 or more"),
    "a parameter that is not the problem's": (
        ("sensor_zero", {"free": ["la1"]}),
        r"sensor_zero\.free: 'la1' is no parameter of it; .*choices: z1, z2, z3",
    ),
    "a misspelt parameter": (("full12", {"free": ["ya22"]}), r"full12\.free: 'ya22' .*did you mean 'ya2'"),
    "the held coordinate": (("full12", {"free": ["xa2"]}), r"full12\.free: 'xa2' is no parameter of it"),
    "nothing free": (("full12", {"free": []}), r"full12\.free=\[\]: at least one parameter must stay free"),
    "J3 with la without z": (
        ("full12", {"error": "J3", "free": ["la1", "lb1"]}),
        r"full12\.free: J3 searches \(la1 cos z1, la1 sin z1\), so free both or neither",
    ),
    "J3 with z without la": (("full11", {"error": "J3", "free": ["z3", "lb1"]}), r"full11\.free: J3 searches \(la3"),
    "a module that is not there": (("no_such_module:Mine", {}), "cannot import problem 'no_such_module:Mine'"),
    "a class that is not there": (("math:Mine", {}), "cannot find problem 'math:Mine': math has no 'Mine'"),
    "what cannot be called": (("math:pi", {}), "problem 'math:pi' is not a class or function"),
}


@pytest.mark.parametrize("request_", list(REFUSED), ids=lambda name: name.replace(" ", "_"))
def test_a_wrong_request_is_refused_in_one_line(request_):
    (name, options), message = REFUSED[request_]
    with pytest.raises(ValueError, match=message) as caught:
        problems.make(name, **options)
    assert "\n" not in str(caught.value)
    assert len(str(caught.value)) < 250


@pytest.mark.parametrize("request_", [name for name, ((_, options), _m) in REFUSED.items() if options])
def test_a_family_called_directly_says_the_same_as_the_registry(request_):
    (name, options), message = REFUSED[request_]
    with pytest.raises(ValueError, match=message):
        problems.registry.factories()[name](**options)


def test_right_values_in_other_types_are_taken():
    problem = problems.make("full11", n=50.0, noise=0, data_seed=1e1, paper_section="3", radius=90)
    assert (problem.options["n"], problem.options["data_seed"], problem.options["paper_section"]) == (50, 10, 3)
    assert isinstance(problem.options["noise"], float)
    assert isinstance(problem.options["radius"], float)
