"""Alerts for the alert management of the bridge (ALF, ALC, ARC, HBT), and commands of the bridge (ACN).

As in IEC 61162-1 and IEC 62923-1, an ALF is sent at every change of an alert. A heartbeat (HBT) and the list of all
alerts (ALC), by which the bridge can detect missed changes, are sent periodically. The bridge sends
commands by ACN; a command that cannot be executed is answered with ARC. An alert is identified by a manufacturer's
code, a number from 10000 on and its instance.

pynmea2 lacks these sentences; their definition here adds them to its parser. pynmea2 registers a sentence under the
name of its class, with (description, name, converter) of each field.
"""

import itertools
import unicodedata
from collections.abc import Sequence
from dataclasses import dataclass

import pynmea2

LONGEST_BYTES = 82
"""Maximum length of a sentence in bytes, with its ``$`` and its line end (IEC 61162-1)."""

_RESERVED = "!$*,\\^~\x7f\r\n"
"""Reserved characters: in a text they are written as ``^`` and their hexadecimal code."""
_ASCII_REPLACEMENTS = str.maketrans({
    "″": '"', "′": "'", "°": " deg", "σ": "sigma", "–": "-", "−": "-", "…": "...",
    "×": "x", "·": " ", "µ": "u", "≤": "<=", "≥": ">=", "±": "+-",
})  # fmt: skip
_ELLIPSIS = ".."
"""End of a text that is longer than its field."""

FIRST_IDENTIFIER, LAST_IDENTIFIER = 10_000, 9_999_999
"""Range of alert identifiers that a manufacturer may use."""
MAX_INSTANCE = 999_999
MAX_ALERTS = 200
"""Maximum number of alerts sent: ten times the highest number in any suite so far."""

ACKNOWLEDGE, REPEAT = "A", "Q"
"""Commands that are executed; O (responsibility transfer) and S (silence) are refused."""

TITLE_LENGTH = 16
"""Maximum length of the title of an alert, characters."""

_CATEGORY = "B"
"""Category of all alerts: an alert contains all information needed to decide what to do."""
_TIME_DECIMALS = 2
_FRAME_LENGTH = len("$*hh\r\n")


class ALF(pynmea2.TalkerSentence):  # type: ignore[misc]
    """Alert: the state of one alert; two sentences if the alert has a description in addition to its title."""

    fields = (
        ("Total number of sentences, 1 or 2", "total", int),
        ("Sentence number", "number", int),
        ("Sequential message identifier, 0 to 9", "sequence", int),
        ("Time of last change, UTC", "time", pynmea2.nmea_utils.timestamp),
        ("Category: A, B or C", "category"),
        ("Priority: E, A, W or C", "priority"),
        ("State: V, S, A, O, U or N", "state"),
        ("Manufacturer mnemonic code", "manufacturer"),
        ("Alert identifier", "alert", int),
        ("Alert instance, 1 to 999999", "instance", int),
        ("Revision counter, 1 to 99", "revision", int),
        ("Escalation counter, 0 to 9", "escalation", int),
        ("Alert text", "text"),
    )


class ALC(pynmea2.TalkerSentence):  # type: ignore[misc]
    """Cyclic alert list: these fields are followed by manufacturer, identifier, instance and revision of each alert."""

    fields = (
        ("Total number of sentences, 01 to 99", "total", int),
        ("Sentence number", "number", int),
        ("Sequential message identifier, 00 to 99", "sequence", int),
        ("Number of alert entries", "entries", int),
    )


class ACN(pynmea2.TalkerSentence):  # type: ignore[misc]
    """Alert command."""

    fields = (
        ("Time, UTC", "time", pynmea2.nmea_utils.timestamp),
        ("Manufacturer mnemonic code", "manufacturer"),
        ("Alert identifier", "alert", int),
        ("Alert instance, 1 to 999999", "instance", int),
        ("Command: A acknowledge, Q repeat, O responsibility transfer, S silence", "command"),
        ("Sentence status flag: C", "flag"),
    )


class ARC(pynmea2.TalkerSentence):  # type: ignore[misc]
    """Alert command refused."""

    fields = (
        ("Time, UTC", "time", pynmea2.nmea_utils.timestamp),
        ("Manufacturer mnemonic code", "manufacturer"),
        ("Alert identifier", "alert", int),
        ("Alert instance, 1 to 999999", "instance", int),
        ("Refused command: A, Q, O or S", "command"),
    )


class HBT(pynmea2.TalkerSentence):  # type: ignore[misc]
    """Heartbeat."""

    fields = (
        ("Configured repeat interval, s", "interval_s", float),
        ("Equipment status: A or V", "status"),
        ("Sequential sentence identifier, 0 to 9", "sequence", int),
    )


def text_field(text: str, max_length: int) -> str:
    """Return a text as a field of a sentence: ASCII, reserved characters as codes, at most ``max_length`` characters.

    A character without an equivalent in ASCII becomes ``?``. A text that is too long is cut after a word, or
    within a first word that is too long, and ends with ``..``.

    Example:
        >>> text_field("σ 3.2″, limit 2″", 40)
        'sigma 3.2"^2C limit 2"'
        >>> text_field("no data from star.starboard", 20)
        'no data from..'
    """
    words = [_escape(word) for word in _ascii_text(text).split(" ")]
    field = " ".join("".join(word) for word in words)
    if len(field) <= max_length:
        return field
    room, shortened = max_length - len(_ELLIPSIS), ""
    for word in words:
        longer = f"{shortened} {''.join(word)}" if shortened else "".join(word)
        if len(longer) > room:
            break
        shortened = longer
    if not shortened:
        # The first word alone is too long: it is cut to the characters that fit.
        lengths = itertools.accumulate(map(len, words[0]))
        shortened = "".join(code for code, length in zip(words[0], lengths, strict=True) if length <= room)
    return shortened.rstrip(":;") + _ELLIPSIS


def _ascii_text(text: str) -> str:
    parts = unicodedata.normalize("NFKD", text.translate(_ASCII_REPLACEMENTS))
    return "".join(part if part.isascii() else "?" for part in parts if not unicodedata.combining(part))


def _escape(word: str) -> list[str]:
    """Return the characters of a word as written in a field; a code is one element, so that it is never cut."""
    return [f"^{ord(one):02X}" if one in _RESERVED or not one.isprintable() else one for one in word]


def time_field(time_ns: int, decimals: int) -> str:
    """Return the time of day (UTC) of a POSIX time as hhmmss.s with ``decimals`` decimals, rounded.

    Example:
        >>> time_field(1_403_741_109_999_600_000, 3)  # less than half a millisecond before the next second
        '000510.000'
    """
    unit_ns = 10 ** (9 - decimals)
    seconds, parts = divmod((time_ns + unit_ns // 2) // unit_ns, 10**decimals)
    minutes, second = divmod(seconds % 86_400, 60)
    hour, minute = divmod(minutes, 60)
    return f"{hour:02d}{minute:02d}{second:02d}.{parts:0{decimals}d}"


@dataclass(frozen=True)
class SentenceAlert:
    """An alert with the values of its sentences.

    Attributes:
        identifier: from FIRST_IDENTIFIER to LAST_IDENTIFIER.
        instance: from 1 to MAX_INSTANCE.
        revision: from 1 to 99, incremented at every change.
        escalation: number of times that the alert became more urgent, from 0 to 9.
        priority: A alarm, W warning, C caution.
        state: V unacknowledged, S silenced, A acknowledged or a caution, U rectified and unacknowledged, N normal.
        changed_ns: time of the last change, POSIX UTC, ns.
        title: a few words.
        description: a sentence; may be empty.
    """

    identifier: int
    instance: int
    revision: int
    escalation: int
    priority: str
    state: str
    changed_ns: int
    title: str
    description: str = ""


@dataclass(frozen=True)
class AlertCommand:
    """A command of the bridge.

    Attributes:
        identifier: identifier of the alert.
        instance: instance of the alert; None if the command contains no instance.
        command: A, Q, O or S.
    """

    identifier: int
    instance: int | None
    command: str


def alf(alert: SentenceAlert, talker: str, manufacturer: str, sequence: int) -> list[pynmea2.NMEASentence]:
    """Return an alert in one sentence, or in two if it has a description.

    The second sentence contains identity, revision, escalation and description of the alert.

    Args:
        alert: the alert.
        talker: two letters of the talker.
        manufacturer: code of three letters; may be empty.
        sequence: number of the call; its last digit identifies the two sentences of one alert.
    """
    total = "2" if alert.description else "1"
    which = manufacturer, str(alert.identifier), str(alert.instance), str(alert.revision), str(alert.escalation)
    time_text = time_field(alert.changed_ns, _TIME_DECIMALS)
    title = text_field(alert.title, TITLE_LENGTH)
    head = total, "1", str(sequence % 10)
    sentences = [ALF(talker, "ALF", (*head, time_text, _CATEGORY, alert.priority, alert.state, *which, title))]
    if alert.description:
        data = (total, "2", str(sequence % 10), "", "", "", "", *which)
        room = LONGEST_BYTES - _FRAME_LENGTH - len(f"{talker}ALF,{','.join(data)},")
        sentences.append(ALF(talker, "ALF", (*data, text_field(alert.description, room))))
    return sentences


def alc(
    alerts: Sequence[SentenceAlert], talker: str, manufacturer: str, sequence: int
) -> list[pynmea2.NMEASentence]:
    """Return the list of all alerts, in as many sentences as needed; no alert is split. Arguments as for `alf`."""
    room = LONGEST_BYTES - _FRAME_LENGTH - len(f"{talker}ALC,01,01,00,99")
    groups: list[list[str]] = [[]]
    for alert in alerts:
        entry = f"{manufacturer},{alert.identifier},{alert.instance},{alert.revision}"
        if sum(len(other) + 1 for other in groups[-1]) + len(entry) + 1 > room:
            groups.append([])
        groups[-1].append(entry)
    total, order = f"{len(groups):02d}", f"{sequence % 100:02d}"
    return [
        ALC(talker, "ALC", (total, f"{number:02d}", order, str(len(group)), *",".join(group).split(",")))
        if group else ALC(talker, "ALC", (total, "01", order, "0"))
        for number, group in enumerate(groups, start=1)
    ]  # fmt: skip


def arc(command: AlertCommand, talker: str, manufacturer: str, time_ns: int) -> pynmea2.NMEASentence:
    """Return the refusal of a command (ARC); ``time_ns`` is the time of the refusal, POSIX UTC."""
    instance = "" if command.instance is None else str(command.instance)
    time_text = time_field(time_ns, _TIME_DECIMALS)
    return ARC(talker, "ARC", (time_text, manufacturer, str(command.identifier), instance, command.command))


def hbt(is_operational: bool, talker: str, period_s: float, sequence: int) -> pynmea2.NMEASentence:
    """Return a heartbeat of the source of alerts, with its period, s, and its state: operational or not."""
    return HBT(talker, "HBT", (f"{period_s:g}", "A" if is_operational else "V", str(sequence % 10)))


def parse_command(text: str, manufacturer: str) -> AlertCommand | None:
    """Return the command in a sentence; None for any other sentence.

    A command to another source of alerts, or without the status flag C, counts as another sentence.

    Raises:
        ValueError: the text is not a sentence, its checksum is wrong or absent, or its command cannot be read.
    """
    try:
        sentence = pynmea2.NMEASentence.parse(text, check=True)
    except pynmea2.nmea.SentenceTypeError:
        return None
    if not isinstance(sentence, ACN) or sentence.manufacturer != manufacturer or sentence.flag != "C":
        return None
    identifier, instance, command = sentence.alert, sentence.instance, sentence.command
    if not isinstance(identifier, int) or not isinstance(instance, (int, type(None))):
        raise ValueError("a command about an alert without a number")
    if command not in ("A", "Q", "O", "S"):
        raise ValueError(f"command '{command:.10}': expected A, Q, O or S")
    return AlertCommand(identifier, instance, command)
