"""The steps of the genetic algorithm as Cong et al. 2008, section 4.1, state them.

A string is kept as one whole number for each parameter, shape (dim,), of `lengths` bits; in the string as the paper
writes it the first parameter comes first, and of each parameter the highest bit.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from bedrock.compiled import njit
from optimizers._random_kernels import State, index, uniform
from optimizers.base import Array

Words = NDArray[np.int64]


@njit()
def randomize(individuals: Words, words: Words, lengths: Words, state: State) -> None:
    """Draw all bits of these individuals anew."""
    for i in individuals:
        for j in range(lengths.shape[0]):
            words[i, j] = index(state, 1 << lengths[j])


@njit()
def breed(
    words: Words,
    values: Array,
    best: int,
    tournament: int,
    crossover: float,
    by_parameter: bool,
    mutation: float,
    by_bit: bool,
    lengths: Words,
    state: State,
    children: Words,
) -> None:
    """Fill `children`, shape (size, dim), by reproduction, crossover and mutation; the first is the best, untouched."""
    reproduce(words, values, tournament, state, children)
    cross(children, crossover, by_parameter, lengths, state)
    mutate(children, mutation, by_bit, lengths, state)
    for j in range(words.shape[1]):
        children[0, j] = words[best, j]


@njit()
def reproduce(words: Words, values: Array, tournament: int, state: State, children: Words) -> None:
    """Fill `children` with the winners of tournaments, one each, among individuals drawn with replacement."""
    size, dim = words.shape
    for i in range(size):
        winner = index(state, size)
        for _ in range(tournament - 1):
            rival = index(state, size)
            if values[rival] < values[winner]:
                winner = rival
        for j in range(dim):
            children[i, j] = words[winner, j]


@njit()
def cross(children: Words, probability: float, by_parameter: bool, lengths: Words, state: State) -> None:
    """Cross neighbours, each pair with `probability`: behind a random point they exchange their bits.

    The point lies inside the whole string; `by_parameter` there is one in each parameter's, its ends included.
    """
    size, dim = children.shape
    total = lengths.sum()
    for i in range(0, size - 1, 2):
        if uniform(state) >= probability:
            continue
        point = 1 + index(state, total - 1)  # bits in front of it
        for j in range(dim):
            if by_parameter:
                point = index(state, lengths[j] + 1)
            behind = lengths[j] - min(max(point, 0), lengths[j])  # low bits of this parameter that are exchanged
            exchanged = (children[i, j] ^ children[i + 1, j]) & ((1 << behind) - 1)
            children[i, j] ^= exchanged
            children[i + 1, j] ^= exchanged
            point -= lengths[j]


@njit()
def mutate(children: Words, probability: float, by_bit: bool, lengths: Words, state: State) -> None:
    """Flip two different bits of each child with `probability`, or `by_bit` each bit with it."""
    size, dim = children.shape
    total = lengths.sum()
    for i in range(size):
        if by_bit:
            for j in range(dim):
                for bit in range(lengths[j]):
                    if uniform(state) < probability:
                        children[i, j] ^= 1 << bit
        elif uniform(state) < probability:
            first = index(state, total)
            flip(children[i], first, lengths)
            if total > 1:
                second = index(state, total - 1)
                flip(children[i], second + 1 if second >= first else second, lengths)


@njit()
def flip(word: Words, place: int, lengths: Words) -> None:
    """Flip the bit at `place` of a string, counted from its front."""
    j = 0
    while place >= lengths[j]:
        place -= lengths[j]
        j += 1
    word[j] ^= 1 << (lengths[j] - 1 - place)


@njit()
def decode(words: Words, gray: bool, lengths: Words, lower: Array, upper: Array, points: Array) -> None:
    """Fill `points`, shape (size, dim), with lower + k (upper - lower) / (2^L - 1), where k is the string's number."""
    for i in range(words.shape[0]):
        for j in range(words.shape[1]):
            k = words[i, j]
            if gray:
                shift = 1
                while shift < lengths[j]:
                    k ^= k >> shift
                    shift *= 2
            v = lower[j] + k * (upper[j] - lower[j]) / ((1 << lengths[j]) - 1)
            points[i, j] = min(v, upper[j])
