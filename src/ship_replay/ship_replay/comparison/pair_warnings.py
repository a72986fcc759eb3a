"""Warnings of a comparison: the difference, why the difference matters, and what to do."""

import re
from collections.abc import Sequence
from dataclasses import dataclass

from ship_bags.suite_commit import COMMIT_RECORD
from ship_replay.comparison.pair import Pair, input_sentences

_REPLAY_BOTH = "replay one recording with both configurations, and compare the two replays"

_EXPLANATIONS = (
    (
        r"The inputs are not the same",
        "B − A contains differences of the inputs in addition to those of the suite or its parameters",
        _REPLAY_BOTH,
    ),
    (
        r"Whether the inputs are the same is unknown",
        "B − A may be caused by different inputs",
        f"compare first and last message and the input counts below; to be certain, {_REPLAY_BOTH}",
    ),
    (
        r"The nodes received different numbers",
        "outputs may differ because of missing messages and not because of a parameter",
        f"see Rejections and the gaps in the states; if messages were lost on the ship, {_REPLAY_BOTH}",
    ),
    (
        r"The times differ",
        "shares and means of A and B refer to different times",
        "use the output differences and the errors, which are compared at equal stamps only",
    ),
    (
        r"not evaluated",
        "errors of this source are missing in the tables; the outputs and their errors are not affected",
        "to see its errors, add the bag that was replayed: --truth BAG",
    ),
    (
        r"messages could be read, the last at|is damaged|are lost",
        "the unreadable part is missing in all tables",
        "recover the bag (record --recover) and compare again",
    ),
    (
        r"were made by different commits",
        "a difference may be caused by the code and not by a parameter",
        "replay both inputs with one commit to compare parameters",
    ),
)
"""Pattern of a warning, why the warning matters, what to do."""


@dataclass(frozen=True)
class PairWarning:
    """A warning about a comparison.

    Attributes:
        what: what differs or is wrong.
        why: why the warning matters; empty if ``what`` is complete.
        do: what to do; empty if ``what`` is complete.
    """

    what: str
    why: str = ""
    do: str = ""


def pair_warnings(pair: Pair, problems: Sequence[str]) -> list[PairWarning]:
    """Return the warnings: different or unknown inputs, different times or commits, and problems of the bags.

    Args:
        pair: both recordings.
        problems: problems of the bags, each preceded by the letters of the bags with this problem.
    """
    found = [_with_explanation(text) for text in [*input_sentences(pair), *_commit_sentences(pair)]]
    return [one for one in found if one.why] + [_with_explanation(text) for text in problems]


def _with_explanation(text: str) -> PairWarning:
    for pattern, why, do in _EXPLANATIONS:
        if re.search(pattern, text):
            return PairWarning(text, f"{why[0].upper()}{why[1:]}.", f"{do[0].upper()}{do[1:]}.")
    return PairWarning(text)


def _commit_sentences(pair: Pair) -> list[str]:
    a, b = (recording.metadata.get(COMMIT_RECORD, {}).get("commit", "") for recording in pair.recordings)
    return [f"A and B were made by different commits of the suite: {a} and {b}."] if a and b and a != b else []
