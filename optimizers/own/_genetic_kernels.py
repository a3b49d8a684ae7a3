"""The steps of the genetic algorithm as Cong et al. 2008, section 4.1, state them.

A string is kept as one whole number for each parameter, shape (dim,), of `lengths` bits; in the string as the paper
writes it the first parameter comes first, and of each parameter the highest bit.
"""

import numpy as np
from numpy.typing import NDArray

from calibench.core.compilation.compiled import njit, part
from calibench.core.compilation.lanes import LANES, exchange
from calibench.optimizers.base import Array
from calibench.optimizers.own._random_kernels import WHOLE, State, half, halves, index, scaled

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
    dim = words.shape[1]
    winners = reproduce(values, tournament, distinct, state)
    cross(words, winners, crossover, by_parameter, lengths, state, children)
    mutate(children, mutation, mutation_per, lengths, state)
    for j in range(dim):
        children[0, j] = words[best, j]


@njit()
def reproduce(values: Array, tournament: int, distinct: bool, state: State) -> Words:
    """Return the winners of tournaments, shape (size,), among individuals drawn at random, or `distinct`."""
    size = values.shape[0]
    drawn = halves(state, size * tournament)
    winners = np.zeros(size, dtype=np.int64)
    if not distinct:
        for i in range(size):
            winner = scaled(drawn[i * tournament], size)
            lowest = values[winner]
            for t in range(1, tournament):
                rival = scaled(drawn[i * tournament + t], size)
                wins = values[rival] < lowest
                winner, lowest = rival if wins else winner, values[rival] if wins else lowest
            winners[i] = winner
        return winners
    everyone = np.empty(size, dtype=np.int64)
    for i in range(size):
        everyone[i] = i
    for i in range(size):
        for t in range(tournament):  # the first steps of a shuffle; where an earlier one ended does not matter
            at = t + scaled(drawn[i * tournament + t], size - t)
            everyone[t], everyone[at] = everyone[at], everyone[t]
            if (t == 0) | (values[everyone[t]] < values[winners[i]]):
                winners[i] = everyone[t]
    return winners


@njit()
def cross(
    words: Words,
    winners: Words,
    probability: float,
    by_parameter: bool,
    lengths: Words,
    state: State,
    children: Words,
) -> None:
    """Fill `children` with the winners, neighbours crossed: behind a random point they exchange their bits.

    Each pair does so with `probability`; who is left without a partner does not. The point lies inside the whole
    string; `by_parameter` there is one in each parameter's, its ends included.
    """
    size, dim = children.shape
    ends = _ends(lengths)
    total, each = ends[dim - 1], 2 + dim if by_parameter else 2
    drawn = halves(state, size // 2 * each)
    parents, flat, whole = words.reshape(-1), children.reshape(-1), 0 if by_parameter else dim - dim % LANES
    for pair in range(size // 2):
        at, own = pair * each, 2 * pair * dim
        crosses = drawn[at] < probability * WHOLE
        point = 1 + scaled(drawn[at + 1], total - 1)  # bits in front of it
        if not crosses:
            point = total  # nothing lies behind it
        a, b = dim * winners[2 * pair], dim * winners[2 * pair + 1]
        for j in range(0, whole, LANES):
            exchange(parents, a + j, b + j, point, ends, lengths, j, flat, own + j, own + dim + j)
        for j in range(whole, dim):
            front = ends[j] - lengths[j]
            if by_parameter & crosses:
                point = front + scaled(drawn[at + 2 + j], lengths[j] + 1)
            behind = min(max(ends[j] - point, 0), lengths[j])  # low bits of this parameter that are exchanged
            first, second = parents[a + j], parents[b + j]
            exchanged = (first ^ second) & ((1 << behind) - 1)
            flat[own + j], flat[own + dim + j] = first ^ exchanged, second ^ exchanged
    if size % 2:
        for j in range(dim):
            children[size - 1, j] = words[winners[size - 1], j]


@part()
def _ends(lengths: Words) -> Words:
    """Return the bits of a string to the end of each of its parameters, shape (dim,)."""
    ends = np.empty(lengths.shape[0], dtype=np.int64)
    end = 0
    for j in range(lengths.shape[0]):
        end += lengths[j]
        ends[j] = end
    return ends


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
        for piece in range(parts):
            at = 3 * (i * parts + piece)
            if drawn[at] < probability * WHOLE:
                front = lengths[:piece].sum()
                bits = lengths[piece] if per == PER_PARAMETER else total
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
def scales(lower: Array, upper: Array, lengths: Words, rows: int) -> Array:
    """Return what `decode` needs, shape (4, rows, dim): in each row lower, width, 2^L - 1 and upper."""
    box = np.empty((4, rows, lower.shape[0]))
    for i in range(rows):
        for j in range(lower.shape[0]):
            box[0, i, j], box[1, i, j] = lower[j], upper[j] - lower[j]
            box[2, i, j], box[3, i, j] = (1 << lengths[j]) - 1, upper[j]
    return box


@njit()
def decode(words: Words, gray: bool, lengths: Words, box: Array, points: Array) -> None:
    """Fill `points`, shape (k, dim), with lower + n (upper - lower) / (2^L - 1), where n is the string's number.

    `box` is of `scales`. It is gone through anew for each so many rows: long loops fill the lanes, and a row of it for
    each point would not stay in the innermost cache.
    """
    if gray:
        words = _numbers(words, lengths)
    flat, numbers = points.reshape(-1), words.reshape(-1)
    lower, width, most, upper = box[0].reshape(-1), box[1].reshape(-1), box[2].reshape(-1), box[3].reshape(-1)
    for first in range(0, flat.shape[0], lower.shape[0]):
        for k in range(min(lower.shape[0], flat.shape[0] - first)):
            at = np.uint64(first + k)  # no negative index, as Python would count that from the end
            flat[at] = min(lower[k] + numbers[at] * width[k] / most[k], upper[k])


@part()
def _numbers(words: Words, lengths: Words) -> Words:
    """Return the numbers that stand in a Gray code in `words`, shape (k, dim)."""
    numbers = words.copy()
    for i in range(words.shape[0]):
        for j in range(words.shape[1]):
            shift = 1
            while shift < lengths[j]:
                numbers[i, j] ^= numbers[i, j] >> shift
                shift *= 2
    return numbers


CURRENT, BEST, STILL, RENEWED, HEAD = range(5)  # of `memory`; then come the lengths, and the rows that were renewed
LOWEST = 0  # of `rules`


@njit()
def advance(words: Words, room: Array, values: Array, found: Array, memory: Words, rules: Array, state: State) -> int:
    """Do `receive` and `proceed` at once, where the population improves as its best does."""
    return proceed(words, room, values, receive(values, found, memory), memory, rules, state)


@njit()
def receive(values: Array, found: Array, memory: Words) -> float:
    """Put what was `found` of the individuals asked for to their `values`; return the value of the best."""
    size, renewed = values.shape[0], memory[RENEWED]
    if renewed:
        rows = memory[memory.shape[0] - size :]
        for i in range(renewed):
            values[rows[i]] = found[i]
    else:
        skipped = size - found.shape[0]
        for i in range(found.shape[0]):
            values[skipped + i] = found[i]
    best, lowest = 0, values[0]
    for i in range(1, size):
        if values[i] < lowest:
            best, lowest = i, values[i]
    memory[BEST] = best
    return lowest  # type: ignore[no-any-return]


@njit()
def proceed(words: Words, room: Array, values: Array, fitness: float, memory: Words, rules: Array, state: State) -> int:
    """Breed the next generation, or renew half where `fitness` did not fall for long; return how many to ask for.

    `words`, shape (2, size, dim), holds this generation and room for the next. `room`, shape (size + 4 rows, dim),
    holds the points to ask for and what `scales` says. `memory`, shape (5 + dim + size,), is brought up to date.
    `rules` are the options as numbers, as each of them would cost as much as all: the lowest fitness so far, which is
    brought up to date too, tournament, distinct, PCrossover, by parameter, PMutation, per what, Gray, NR, the worst
    begin again, the fitness is a mean.
    """
    crossover, mutation, tournament, mutation_per = rules[3], rules[5], int(rules[1]), int(rules[6])
    distinct, by_parameter, gray, worst = rules[2] != 0.0, rules[4] != 0.0, rules[7] != 0.0, rules[9] != 0.0
    size, dim = words.shape[1], words.shape[2]
    lengths, asked, box = memory[HEAD : HEAD + dim], room[:size], room[size:].reshape(4, -1, dim)
    memory[STILL] = 0 if fitness < rules[LOWEST] else memory[STILL] + 1
    rules[LOWEST] = min(fitness, rules[LOWEST])
    current, best = memory[CURRENT], memory[BEST]
    if memory[STILL] < rules[8]:
        children = words[1 - current]
        breed(
            words[current], values, best, tournament, distinct, crossover, by_parameter, mutation, mutation_per,
            lengths, state, children,
        )  # fmt: skip
        decode(children[1:], gray, lengths, box, asked[: size - 1])
        values[0] = values[best]
        memory[CURRENT], memory[RENEWED] = 1 - current, 0
        return int(size - 1)
    renewed = half(values, best, worst, state)
    randomize(renewed, words[current], lengths, state)
    count, rows = renewed.shape[0], memory[HEAD + dim :]
    chosen = np.empty((count, dim), dtype=np.int64)
    for i in range(count):
        rows[i] = renewed[i]
        for j in range(dim):
            chosen[i, j] = words[current, renewed[i], j]
    decode(chosen, gray, lengths, box, asked[:count])
    memory[RENEWED], memory[STILL] = count, 0
    if rules[10] != 0.0:
        rules[LOWEST] = np.inf  # the newly drawn are worse than those they replace
    return int(count)
