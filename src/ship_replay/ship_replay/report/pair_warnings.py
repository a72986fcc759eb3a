"""The warnings of a comparison: what is different, why that matters, what to do."""

import re
from collections.abc import Sequence
from dataclasses import dataclass

from ship_bags.suite_commit import COMMIT_RECORD
from ship_replay.report.pair import Pair, origin

_REPLAY_BOTH = "replay one recording with both configurations, and compare the two replays"

_EXPLANATIONS = (
    (
        r"They do not stem from the same inputs",
        "B − A contains the difference of the inputs as well as that of the suite or its parameters",
        _REPLAY_BOTH,
    ),
    (
        r"Nothing in the bags tells whether",
        "without truth or a scenario in the bags, B − A may come from other inputs",
        f"compare first and last message and the counts of inputs below; to be certain, {_REPLAY_BOTH}",
    ),
    (
        r"The nodes did not receive the same number",
        "outputs may differ because messages were missing, and not because of a parameter",
        f"see Refusals and the gaps in the states; of losses on the ship, {_REPLAY_BOTH}",
    ),
    (
        r"They are not of the same time",
        "a share or mean of A is of other minutes than that of B",
        "judge by the difference of the outputs and by the errors: those are at equal stamps only",
    ),
    (
        r"is left out: no .* while the truth is known|not evaluated",
        "errors of this source are not in the tables; the outputs and their errors are not affected",
        "to see its errors, name the bag that was replayed: --truth BAG",
    ),
    (
        r"messages could be read, the last at|is damaged|are lost",
        "what could not be read is missing in all tables",
        "recover the bag (record --recover), and compare again",
    ),
    (
        r"were made by different commits",
        "a difference may come from the code and not from a parameter",
        "replay both inputs with one commit to compare parameters",
    ),
)
"""Pattern of a warning, why it matters, what to do."""


@dataclass(frozen=True)
class PairWarning:
    """A warning about a comparison.

    Attributes:
        what: what is different or wrong.
        why: why that matters; empty where the text says all.
        do: what to do; likewise.
    """

    what: str
    why: str = ""
    do: str = ""


def pair_warnings(pair: Pair, problems: Sequence[str]) -> list[PairWarning]:
    """Return the warnings about two recordings: how their inputs and commits differ, and what is wrong with the bags.

    Args:
        pair: both recordings.
        problems: of the bags, each beginning with the letters of those that have it.
    """
    found = [_explained(text) for text in [*origin(pair), *_commits(pair)]]
    return [one for one in found if one.why] + [_explained(text) for text in problems]


def _explained(text: str) -> PairWarning:
    for pattern, why, do in _EXPLANATIONS:
        if re.search(pattern, text):
            return PairWarning(text, f"{why[0].upper()}{why[1:]}.", f"{do[0].upper()}{do[1:]}.")
    return PairWarning(text)


def _commits(pair: Pair) -> list[str]:
    a, b = (night.metadata.get(COMMIT_RECORD, {}).get("commit", "") for night in pair.nights)
    return [f"A and B were made by different commits of the suite: {a} and {b}."] if a and b and a != b else []
