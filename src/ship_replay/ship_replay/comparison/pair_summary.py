"""Summary and warnings of a comparison in sentences.

The summary states the better run in each respect, and the differences of the runs. A warning states a difference, why
the difference matters, and what to do.
"""

import math
import re
from collections.abc import Sequence
from dataclasses import dataclass, replace

from ship_bags.provenance import COMMIT_RECORD
from ship_replay.comparison.pair import OutputDifference, Pair, input_sentences
from ship_replay.comparison.pair_tables import SAME_TIME_NS, ErrorRow, ParameterDifference
from ship_replay.report.recording import RecordedHistory
from ship_replay.report.tables import SourceOutage, number, outages, utc
from ship_watch.orientations import ORIENTATIONS, channel_name
from ship_watch.suite_state import ANGLES, Safety

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

_EQUAL_WITHIN = 0.02
"""Relative difference of RMS errors below which neither run counts as better."""

_LAST_BITS_ARCSEC = 1e-6
"""Maximum difference of an angle that is ascribed to rounding on another machine or with another library, arcsec."""

_MOST_NAMED = 3
_ON_SKY = "_cos_elevation"
_NEVER_NS = 1 << 63


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


def pair_summary(pair: Pair, errors: Sequence[ErrorRow], parameters: Sequence[ParameterDifference]) -> list[str]:
    """Return the summary, one or two sentences per point.

    Args:
        pair: both recordings.
        errors: errors of both recordings against the truth; empty without truth.
        parameters: parameters that differ.
    """
    sentences = input_sentences(pair)
    if not pair.is_same:
        sentences.append(_configuration_sentence(parameters))
    sentences += [*_safe_share_sentences(pair), *_accuracy_sentences(errors)]
    sentences += [text for name in ANGLES if (text := _angle_sentence(pair, name, errors))]
    sentences += [_difference_sentence(found) for found in pair.differences]
    sentences += _missing_sentences(pair)
    return [*sentences, *_outage_sentences(pair)]


def _configuration_sentence(parameters: Sequence[ParameterDifference]) -> str:
    if not parameters:
        return "No parameter differs."
    named = [
        f"{one.node} {one.name} {one.a or 'nothing'} in A, {one.b or 'nothing'} in B".replace("  ", " ")
        for one in parameters[:_MOST_NAMED]
    ]
    rest = len(parameters) - len(named)
    count = "One parameter differs" if len(parameters) == 1 else f"{len(parameters)} parameters differ"
    return f"{count}: {'; '.join(named)}{f'; {rest} more below' if rest else ''}."


def _safe_share_sentences(pair: Pair) -> list[str]:
    """Return a sentence that names, for each run, the angles that were SAFE for a larger share of the time."""
    longer: dict[str, list[str]] = {"A": [], "B": []}
    for name in ANGLES:
        a, b = (_safe_share(recording, name) for recording in pair.recordings)
        if a != b and math.isfinite(a) and math.isfinite(b):
            longer["A" if a > b else "B"].append(name)
    parts = [f"{letter} was SAFE longer in {', '.join(names)}" for letter, names in longer.items() if names]
    return [f"{'; '.join(parts)}."] if parts else []


def _accuracy_sentences(errors: Sequence[ErrorRow]) -> list[str]:
    """Return a sentence with the channels of the outputs in which A, B or neither has the smaller RMS error."""
    ratios = {row.channel: row.ratio for row in _output_rows(errors) if math.isfinite(row.ratio)}
    if not ratios:
        return []
    nearer = {
        "A has the smaller RMS error in": [name for name, ratio in ratios.items() if ratio > 1.0 + _EQUAL_WITHIN],
        "B has the smaller RMS error in": [name for name, ratio in ratios.items() if ratio < 1.0 - _EQUAL_WITHIN],
        "RMS errors are equal within 2 % in":
            [name for name, ratio in ratios.items() if 1.0 - _EQUAL_WITHIN <= ratio <= 1.0 + _EQUAL_WITHIN],
    }
    parts = [f"{text} {', '.join(map(channel_name, names))}" for text, names in nearer.items() if names]
    sentence = "; ".join(parts)
    return [f"{sentence[0].upper()}{sentence[1:]}."]


def _angle_sentence(pair: Pair, name: str, errors: Sequence[ErrorRow]) -> str:
    """Return a sentence with the SAFE share of the time and the error of an angle in each run."""
    safe = [_safe_share(recording, name) for recording in pair.recordings]
    if not any(map(math.isfinite, safe)):
        return ""
    if all(map(math.isfinite, safe)):
        text = f"{name.capitalize()}: SAFE {_percent(safe[0])} of the time in A, {_percent(safe[1])} in B"
    else:
        has, lacks = ("A", "B") if math.isfinite(safe[0]) else ("B", "A")
        share = safe["AB".index(has)]
        return f"{name.capitalize()}: published in {has} (SAFE {_percent(share)} of the time), not in {lacks}."
    for row in _output_rows(errors):
        if row.channel.removesuffix(_ON_SKY) == name and math.isfinite(row.ratio):
            text += (
                f"; RMS error {number(row.rms[0])}″ in A, {number(row.rms[1])}″ in B (B/A {row.ratio:.2f}), "
                f"95 % within {number(row.size_95[0])}″ and {number(row.size_95[1])}″"
            )
    return f"{text}."


def _difference_sentence(found: OutputDifference) -> str:
    topic, stamps = found.orientation.topic, len(found.time_ns)
    if found.all_equal:
        return f"{topic}: all {stamps} messages are equal to the last bit."
    unpaired_text = ", ".join(
        f"{count} only in {letter}" for letter, count in zip("AB", found.unpaired_counts, strict=True) if count
    )
    text = f"{topic}: {stamps} equal stamps{f' ({unpaired_text})' if unpaired_text else ''}"
    if all(found.channels_equal):
        rest = stamps - found.messages_equal
        rest_text = f"; other fields differ in {rest} messages" if rest else ""
        return f"{text}; the angles are equal to the last bit{rest_text}."
    largest = [found.largest(channel) for channel in range(len(found.orientation.channels))]
    if all(abs(value) < _LAST_BITS_ARCSEC for value, _ in largest):
        return f"{text}; the angles differ only by rounding, by less than {_LAST_BITS_ARCSEC:g}″."
    parts = [
        f"{channel_name(name)} up to {number(abs(value))}″ at {utc(stamp_ns)}"
        for name, (value, stamp_ns) in zip(found.orientation.channels, largest, strict=True)
    ]
    return f"{text}; B differs from A in {', '.join(parts)}."


def _missing_sentences(pair: Pair) -> list[str]:
    """Return a sentence for each output that only one run published, and for each output without a common stamp."""
    sentences = []
    compared = {found.orientation.label for found in pair.differences}
    for known in ORIENTATIONS:
        claims = [known.label in one.series for one in pair.published]
        if all(claims) and known.label not in compared:
            sentences.append(f"{known.topic}: A and B have no stamp in common, so no difference is shown.")
        elif claims[0] != claims[1]:
            sentences.append(f"{known.topic}: published in {'A' if claims[0] else 'B'} only.")
    return sentences


def _outage_sentences(pair: Pair) -> list[str]:
    """Return sentences about outages within the time that both runs cover.

    Each source that was out in one run only has a sentence. One more sentence lists the sources with the same outages
    in both runs.
    """
    a, b = (outages(recording) for recording in pair.recordings)
    sentences, named = [], set()
    for source in dict.fromkeys(outage.source for outage in (*a, *b)):
        for letter, other, mine, others in (("A", "B", a, b), ("B", "A", b, a)):
            found = _outages_only_here([one for one in mine if one.source == source],
                            [*(one for one in others if one.source == source), *_unrecorded_spans(pair, other, source)])
            if found:
                named.add(source)
                more = f" and {len(found) - _MOST_NAMED} times more" if len(found) > _MOST_NAMED else ""
                times = ", ".join(one.text for one in found[:_MOST_NAMED])
                sentences.append(f"{source} was out in {letter} and not in {other}: {times}{more}.")
    common = [source for source in dict.fromkeys(outage.source for outage in a) if source not in named]
    if common:
        sentences.append(f"Identical outages in both runs: {', '.join(common)}.")
    return sentences if a or b else ["No source was out in A or in B."]


def _outages_only_here(outages_here: list[SourceOutage], elsewhere: list[SourceOutage]) -> list[SourceOutage]:
    """Return the parts of outages that the other run does not have; parts of two seconds or less are ignored."""
    for other in elsewhere:
        outages_here = [left for outage in outages_here for left in _split_outage(outage, other)]
    return [one for one in outages_here if (one.to_ns or _NEVER_NS) - one.from_ns > SAME_TIME_NS]


def _split_outage(outage: SourceOutage, other: SourceOutage) -> list[SourceOutage]:
    """Return the parts of an outage before and after another outage."""
    end_ns, other_end_ns = outage.to_ns or _NEVER_NS, other.to_ns or _NEVER_NS
    left = []
    if outage.from_ns < other.from_ns:
        to_ns = outage.to_ns if end_ns <= other.from_ns else other.from_ns
        left.append(replace(outage, to_ns=to_ns))
    if other_end_ns < end_ns:
        left.append(replace(outage, from_ns=max(outage.from_ns, other_end_ns)))
    return left


def _unrecorded_spans(pair: Pair, letter: str, source: str) -> list[SourceOutage]:
    """Return the times that the recording of a letter does not cover, as outages of the source.

    The time after the end of this recording is returned only if the other recording ends more than two seconds later.
    """
    (start_ns, end_ns), (_, other_end_ns) = (
        recording.span_ns for recording in (pair.recordings if letter == "A" else reversed(pair.recordings))
    )
    before, after = SourceOutage(source, 0, start_ns, ""), SourceOutage(source, end_ns, 0, "")
    return [before, after] if other_end_ns > end_ns + SAME_TIME_NS else [before]


def _output_rows(errors: Sequence[ErrorRow]) -> list[ErrorRow]:
    labels = [orientation.label for orientation in ORIENTATIONS]
    return [row for row in errors if row.label in labels]


def _safe_share(recording: RecordedHistory, angle: str) -> float:
    """Return the SAFE share of the time in which an angle was published; NaN if it was never published."""
    seconds = recording.seconds(angle)
    total = sum(seconds.values())
    return seconds[Safety.SAFE] / total if total else math.nan


def _percent(share: float) -> str:
    return f"{100.0 * share:.1f} %"
