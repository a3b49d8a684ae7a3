"""The steps of the genetic algorithm as Cong et al. 2008, section 4.1, state them.

A string is kept as one whole number for each parameter, shape (dim,), of `lengths` bits; in the string as the paper
writes it the first parameter comes first, and of each parameter the highest bit.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from calibench.core.compilation.compiled import njit
from calibench.optimizers.base import Array
from calibench.optimizers.own._random_kernels import WHOLE, State, halves, index, scaled

Words = NDArray[np.int64]

PER_INDIVIDUAL, PER_PARAMETER, PER_BIT = range(3)  # whose share the probability of a mutation is


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
    distinct: bool,
    crossover: float,
    by_parameter: bool,
    mutation: float,
    mutation_per: int,
    lengths: Words,
    state: State,
    children: Words,
) -> None:
    """Fill `children`, shape (size, dim), by reproduction, crossover and mutation; the first is the best, untouched."""
    reproduce(words, values, tournament, distinct, state, children)
    cross(children, crossover, by_parameter, lengths, state)
    mutate(children, mutation, mutation_per, lengths, state)
    for j in range(words.shape[1]):
        children[0, j] = words[best, j]


@njit()
def reproduce(words: Words, values: Array, tournament: int, distinct: bool, state: State, children: Words) -> None:
    """Fill `children` with the winners of tournaments, one each, among individuals drawn at random, or `distinct`."""
    size, dim = words.shape
    drawn = halves(state, size * tournament)
    everyone = np.arange(size)
    for i in range(size):
        winner, lowest = 0, np.inf
        for t in range(tournament):
            if distinct:  # the first steps of a shuffle; where an earlier one ended does not matter
                at = t + scaled(drawn[i * tournament + t], size - t)
                everyone[t], everyone[at] = everyone[at], everyone[t]
                rival = everyone[t]
            else:
                rival = scaled(drawn[i * tournament + t], size)
            value = values[rival]
            wins = (value < lowest) | (t == 0)
            winner, lowest = rival if wins else winner, value if wins else lowest
        for j in range(dim):
            children[i, j] = words[winner, j]


@njit()
def cross(children: Words, probability: float, by_parameter: bool, lengths: Words, state: State) -> None:
    """Cross neighbours, each pair with `probability`: behind a random point they exchange their bits.

    The point lies inside the whole string; `by_parameter` there is one in each parameter's, its ends included.
    """
    size, dim = children.shape
    total, each = lengths.sum(), 2 + dim if by_parameter else 2
    drawn = halves(state, size // 2 * each)
    for pair in range(size // 2):
        crosses = drawn[pair * each] < probability * WHOLE
        i, point = 2 * pair, 1 + scaled(drawn[pair * each + 1], total - 1)  # bits in front of it
        for j in range(dim):
            if by_parameter:
                point = scaled(drawn[pair * each + 2 + j], lengths[j] + 1)
            behind = lengths[j] - min(max(point, 0), lengths[j])  # low bits of this parameter that are exchanged
            exchanged = (children[i, j] ^ children[i + 1, j]) & ((1 << behind) - 1) if crosses else 0
            children[i, j] ^= exchanged
            children[i + 1, j] ^= exchanged
            point -= lengths[j]


@njit()
def mutate(children: Words, probability: float, per: int, lengths: Words, state: State) -> None:
    """Flip two different bits of a child with `probability`, or of each of its parameters, or each bit: see `per`."""
    size, dim = children.shape
    total = lengths.sum()
    if per == PER_BIT:
        drawn = halves(state, size * total)
        at = 0
        for i in range(size):
            for j in range(dim):
                flips = 0
                for bit in range(lengths[j]):
                    flips |= int(drawn[at + bit] < probability * WHOLE) << bit
                children[i, j] ^= flips
                at += lengths[j]
        return
    parts = dim if per == PER_PARAMETER else 1
    drawn = halves(state, size * parts * 3)
    for i in range(size):
        for part in range(parts):
            at = 3 * (i * parts + part)
            if drawn[at] < probability * WHOLE:
                front = lengths[:part].sum()
                bits = lengths[part] if per == PER_PARAMETER else total
                first = scaled(drawn[at + 1], bits)
                flip(children[i], front + first, lengths)
                if bits > 1:
                    second = scaled(drawn[at + 2], bits - 1)
                    flip(children[i], front + second + (second >= first), lengths)


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
