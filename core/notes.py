"""A note as a value: what was seen in data and nobody stated, by a code, and in words that are made once.

Whoever decides looks at `Note.code`, `columns`, `rows` and `values`; `text` is for people. In JSON a note is an object
with these keys. `DataError` is the refusal of data, and may carry a note that says what is wrong and what cures it.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from enum import StrEnum
from typing import Any, final


@final
class Code(StrEnum):
    """What a note is about. The first word of a member is written to files; `meaning` says what it means."""

    meaning: str

    def __new__(cls, value: str, meaning: str) -> Code:
        member = str.__new__(cls, value)
        member._value_ = value
        member.meaning = meaning
        return member

    # the file
    FILE = "file", "how a file was read: its header, decimals, variables that are no columns, files that were joined"
    BESIDE_THE_ARM = "beside_the_arm", "what in a URDF is not read, or wrong, and stands beside the chain of the arm"
    COLUMNS_MATCHED = "columns_matched", "columns were matched to joints otherwise than by their names"
    COLUMNS_UNREAD = "columns_unread", "columns of numbers that nothing reads"
    ROWS_LEFT_OUT = "rows_left_out", "rows without a value, or that the file marks as not valid, are left out"
    ROWS_COPIED = "rows_copied", "rows that equal an earlier one are left out"
    HELD_OUT_FITTED = "held_out_fitted", "rows that are held back repeat a pose that was fitted"
    UNIT = "unit", "a unit that nothing states was told by the name of a column, or by sizes"
    UNIT_FOUND = "unit_found", "a unit that nothing states was found by what fits the arm"
    ROTATION = "rotation", "how columns of a rotation are read, as nothing states it"
    ROTATION_LEFT_OUT = "rotation_left_out", "measured rotations fit in no way, and are left out"
    # mistakes of a file, each with its cure
    JOINTS_EXCHANGED = "joints_exchanged", "the columns of two joints are exchanged"
    JOINT_REVERSED = "joint_reversed", "a joint counts the other way than in the description of the arm"
    JOINT_SHIFTED = "joint_shifted", "a joint's zero is another one than in the description of the arm"
    JOINT_UNIT = "joint_unit", "joints are in another unit than was stated or taken"
    POSITION_UNIT = "position_unit", "positions are in another unit than was stated or taken"
    ROWS_OUT_OF_STEP = "rows_out_of_step", "joints and what was measured stand in different rows"
    LEFT_HANDED = "left_handed", "positions fit the arm in a left-handed frame only"
    TWO_STANDS = "two_stands", "base, tracker or target was moved between the rows"
    OTHER_ARM = "other_arm", "the readings are far from all that the described arm can give"
    BEYOND_LIMITS = "beyond_limits", "a joint stands outside its limits"
    JOINT_STILL = "joint_still", "a joint, or a column of a rotation, holds one value in every row"
    TABLE_MISTAKE = "table_mistake", "the readings fit the arm with one change of its table"
    # how sure the answer is
    DISTANCE_UNKNOWN = "distance_unknown", "no distance of two sockets is stated, so that nothing tells the arm's size"
    GAINS_WOULD_HELP = "gains_would_help", "scales of the joints' readings would predict better, and have no place"
    GAINS_ELSEWHERE = "gains_elsewhere", "scales of the joints' readings are part of the answer, and stand elsewhere"
    FEW_POSES = "few_poses", "fewer poses than make the numbers sure"
    WILD_UNCOUNTED = "wild_uncounted", "wild readings are in no error"
    MANY_WILD = "many_wild", "more readings are wild than mishaps make"
    FAR_OFF = "far_off", "so much is left that the description is hardly that of the arm"
    NARROW_RANGE = "narrow_range", "beyond the poses that were read the answer is much less sure"
    STEP = "step", "base or tracker moved a little between two rows"
    PARTS_OF_PLACES = "parts_of_places", "less than places was read: some axes, distances, or planes that were touched"
    TARGETS = "targets", "several targets on the flange are read, each at a place of its own"
    BASE_DRIFT = "base_drift", "what targets that stand with the base tell of the tracker's drift"
    SCALE = "scale", "the camera sees the board at another scale than the robot's moves have"
    ALIKE = "alike", "what is left of a pair of poses follows the pair before, and intervals are wider"
    NOISE_BY_AXIS = "noise_by_axis", "a camera's noise differs along and across its line of sight"
    FORMS_DIFFER = "forms_differ", "closed forms of other tools have the camera outside of the fit's interval"
    FEW_TURNS = "few_turns", "the flange turned too little for narrow intervals"
    # poses to measure
    NO_LIMITS = "no_limits", "joints without limits, for which a range is taken"
    NOT_CHECKED = "not_checked", "what is not known of proposed poses: collisions and the line of sight"
    # rows and columns of a search
    ROWS_WILD = "rows_wild", "rows that lie where no reading of the machine can are left out"
    ROWS_EQUAL = "rows_equal", "rows are the same in every column, as chance makes them on a coarse scale, or copies"
    ROWS_SAID_TWICE = "rows_said_twice", "rows that were there before are taken as repeats"
    ROWS_THINNED = "rows_thinned", "of very many rows some are searched, and the others held out"
    ROWS_FITTED = "rows_fitted", "rows without a word in the column of held-out rows are fitted"
    TIME_BACKWARDS = "time_backwards", "the time runs backwards, and rows are taken in its order"
    TIME_REPEATED = "time_repeated", "rows share a time stamp, so that nothing in time falls between them"
    TIME_UNKNOWN = "time_unknown", "no column tells the time, or from where a joint came: the order of the rows does"
    COLUMN_STILL = "column_still", "a column that is read holds one value in every row"
    COLUMN_MISSING = "column_missing", "a column is not there, and what depends on it is not looked for"
    COLUMN_NOT_FOLLOWED = "column_not_followed", "nothing that depends on a column is looked for, as it stands there"
    COLUMN_NOT_USED = "column_not_used", "a column that the machine knows is not used, as too little stands in it"
    COLUMN_IN_SOME = "column_in_some", "a column is not in every block of the data, and 0 is taken where it is not"
    SIGNS_TAKEN = "signs_taken", "which of two words, or which way of counting, is taken for the positive one"
    TURNS = "turns", "an angle jumps by whole turns"
    UNIT_TURNED = "unit_turned", "a column is turned from its stated unit into another"
    NOT_HELD_OUT = "not_held_out", "no rows are held out: the gap on unseen poses is by cross-validation"
    GAP_OF_FITTED = "gap_of_fitted", "no rows are held out, and none can be: the gap is that of the fitted readings"
    # the noise
    NOISE_UNSTATED = "noise_unstated", "the noise is not stated, and taken from repeats, or from what all terms leave"
    NOISE_OF_REPEATS = "noise_of_repeats", "the noise of some columns is not stated, and is that of their repeats"
    NOISE_LEARNED = "noise_learned", "the noise is not stated, and learned from what the model leaves"
    NO_REPEATS = "no_repeats", "no repeats tell the noise, or too few"
    REPEATS_EQUAL = "repeats_equal", "repeats are the same number, and tell nothing of the noise"
    REPEATS_TAKEN = "repeats_taken", "rows that follow each other at the same inputs are taken as repeats"
    NOISE_CARRIED = "noise_carried", "a part of the noise is carried on from one reading to the next"
    NOISE_MISSTATED = "noise_misstated", "repeats scatter otherwise than the stated noise, and their scatter is used"
    NOISE_TOO_WIDE = "noise_too_wide", "the fit leaves far less than the stated noise"
    HEAVY_TAILS = "heavy_tails", "the noise has heavier tails than a Gaussian"
    # the fit
    UNDETERMINED = "undetermined", "the data do not determine a parameter, which is held at its nominal value"
    MASSES_UNKNOWN = "masses_unknown", "nothing tells the masses, and gravity is that of rods"
    OTHER_START = "other_start", "a start elsewhere than at the nominal machine led to a better fit"
    OUTSIDE_BOUNDS = "outside_bounds", "parameters end outside their bounds, of which the fit is free"
    FAR_FROM_MODEL = "far_from_model", "the calibrated model is hardly nearer to the readings than to shuffled ones"
    ONE_READING = "one_reading", "one reading makes nearly all of what the calibrated model leaves"
    ROWS_STAND_OUT = "rows_stand_out", "rows lie further off than noise makes them, alone or some after each other"
    ONE_UNSEEN = "one_unseen", "one reading makes most of the error of the readings that were not fitted"
    EXACT_READINGS = "exact_readings", "what is measured comes in exact levels: the noise is that of the inputs"
    FEW_LEFT = "few_left", "so few equations are left after calibration that nothing missing could show"
    FEW_EQUATIONS = "few_equations", "names were found from few equations, and nobody stated the noise"
    # the names
    NEGATIVE_SIZE = "negative_size", "the size of a name is negative, which it never is in a machine"
    MOSTLY_UNSEEN = "mostly_unseen", "the terms of a name cancel over what was read, and its size tells little"
    AGAINST_EACH_OTHER = "against_each_other", "names move one quantity against each other, further than together"
    MANY_WAVES = "many_waves", "many waves of one part tell the course of its error, and not its cause"
    NO_TRENDS = "no_trends", "no trend over further columns has a name, as nothing but joints is read"
    IMPOSSIBLE_SIZE = "impossible_size", "what would explain most was left out, as its size is taken for impossible"
    # a simulator
    SIMULATOR_CALLS = "simulator_calls", "how often a simulator was called, and its own noise"
    SIMULATOR_ROWS = (
        "simulator_rows",
        "rows of a simulator depend on each other, so that errors of inputs are not looked for",
    )
    # the page
    NO_PAGE = "no_page", "the page of a search could not be drawn"


@final
@dataclass(frozen=True)
class Note:
    """One note: its code, its words without a full stop, and the columns, rows and numbers that it is about."""

    code: Code
    text: str
    columns: tuple[str, ...] = ()
    rows: tuple[str, ...] = ()
    values: Mapping[str, Any] = field(default_factory=dict, hash=False)

    def __str__(self) -> str:
        return self.text

    def to_dict(self) -> dict[str, Any]:
        """Return plain values for JSON."""
        return {
            "code": self.code.value, "text": self.text, "columns": list(self.columns), "rows": list(self.rows),
            "values": dict(self.values),
        }  # fmt: skip


def once(notes: Iterable[Note]) -> tuple[Note, ...]:
    """Return notes in their order, each text once."""
    return tuple({note.text: note for note in notes}.values())


class DataError(ValueError):
    """The data cannot be used as they are; the message names the column, what is wrong, and the way out.

    `note` says the same as a value, where more than the message is known.
    """

    def __init__(self, text: str = "", note: Note | None = None) -> None:
        super().__init__(text)
        self.note = note
