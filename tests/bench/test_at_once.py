"""Calls that do not wait for each other: their order, their processes, and what they raise."""

import os

import pytest

from calibench.bench.gate import processes
from calibench.bench.gate.processes import at_once


def test_answers_come_in_the_order_of_the_calls():
    assert at_once([lambda k=k: k**2 for k in range(7)]) == [0, 1, 4, 9, 16, 25, 36]


def test_calls_run_beside_this_process(monkeypatch):
    monkeypatch.setattr(processes.os, "cpu_count", lambda: 2)
    assert os.getpid() not in at_once([os.getpid] * 4)


@pytest.mark.parametrize("cores", [1, 2])
def test_what_a_call_raises_is_raised_here(monkeypatch, cores):
    def fails():
        raise ValueError("no such plan")

    monkeypatch.setattr(processes.os, "cpu_count", lambda: cores)
    with pytest.raises(ValueError, match="no such plan"):
        at_once([fails, os.getpid])


def test_one_core_makes_them_here(monkeypatch):
    monkeypatch.setattr(processes.os, "cpu_count", lambda: 1)
    assert at_once([os.getpid] * 2) == [os.getpid()] * 2
