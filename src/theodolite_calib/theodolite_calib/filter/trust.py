"""Which sources are trusted: what a disagreement says, which source is excluded, and when it is used again.

A source whose exclusion makes the rest agree is excluded (:mod:`ship_estimation.exclusion`). A baseline that jumps
although its drone cannot have is excluded at once. While lights are refused and no single source explains it, nobody is
believed: the pointing may be off by what the lights say. What is excluded returns once it has agreed with the others
for a while. Agreement counts only where it could have failed: the others must know so well where the light should be
that what was refused would be refused again. A baseline that has jumped back has nothing left to be refused.
"""

from collections.abc import Mapping, Set
from dataclasses import dataclass, field, replace

import numpy as np

from ship_estimation.exclusion import HEARD_NS, Exclusion, Finding, find_fault, judge_return
from ship_estimation.gates import GateConfig, chi_square_gate
from ship_estimation.hypotheses import RowsCompared
from ship_estimation.protection import IntegrityConfig
from ship_estimation.running_means import SEEN_BY_ROWS, WELL, Means, excess_limit, forgotten, no_means, observed
from ship_geometry.rotations import FloatArray
from ship_geometry.time_scales import SECOND_NS
from theodolite_calib.filter.alternatives import BEACON, CHAIN, ENCODER, SHIP, TELESCOPE, RowsSeen, SourceRows
from theodolite_calib.measured.baseline_track import BaselineJump
from theodolite_calib.measured.contradiction import Streams

_SAME_JUMP_NS = SECOND_NS
"""Jumps of one baseline that are found so close to one another are one."""
_UNDONE_SIGMAS = 4.0
"""A baseline has jumped back where so many sigmas of its jumps are left."""
_ALIKE_SIGMAS, _ALIKE_COSINE = 2.0, 0.7
"""Lights creep alike where the mean of each is off by more than so many sigmas, in directions so close."""
_SUSPECTED = 0.3
"""A ship that has left its own rates is wrong where the means reach this share of their limit; either alone may be."""
_POWER_SIGMAS = 5.0
"""What was refused would be refused again where it is so many times the sigma of the place of the light."""


@dataclass(frozen=True)
class LeftOut:
    """A source that is excluded.

    Attributes:
        exclusion: since when, and how long it has agreed.
        why: in words.
        refused_m: size on the detector of what was refused, m; 0 where its baseline jumped.
        jumped_n: sum of the jumps of its baseline, m, shape (3,); zeros where it has jumped back, or never jumped.
        jumped_sigma_m: its standard deviation.
        jump_ns: stamp of the last of them.
    """

    exclusion: Exclusion
    why: str
    refused_m: float = 0.0
    jumped_n: FloatArray = field(default_factory=lambda: np.zeros(3))
    jumped_sigma_m: float = 0.0
    jump_ns: int = 0


@dataclass(frozen=True)
class Conflict:
    """Lights that disagree with the encoders and the ship's attitude, and no single source explains it.

    Attributes:
        spread_n: by so much the pointing may be off: covariance of the rotation vector in n, rad², shape (3, 3).
        lasting: whether it was more than a sighting or two: then it ends by agreement that lasts.
        agrees_since_ns: since when lights have been accepted again; None where they are refused.
    """

    spread_n: FloatArray
    lasting: bool = False
    agrees_since_ns: int | None = None


@dataclass(frozen=True)
class Trust:
    """What is known of the sources.

    Attributes:
        means: what the estimate by all sources (first) and every row have seen of every drone.
        left_out: the sources that are excluded, by name.
        conflict: None where there is none.
        jumped_ns: stamps up to which jumps of baselines are known, by source.
    """

    means: Means
    left_out: Mapping[str, LeftOut] = field(default_factory=dict)
    conflict: Conflict | None = None
    jumped_ns: Mapping[str, int] = field(default_factory=dict)

    @property
    def excluded(self) -> Set[str]:
        """Names of the sources that are excluded."""
        return self.left_out.keys()


def blamed(source: str, explaining: Set[str], told: Streams, off_rad: float) -> str | None:
    """Who is wrong where lights suddenly contradict the encoders or the ship's attitude; None where nobody knows.

    Args:
        source: the encoders or the ship's attitude, as the rows have it.
        explaining: all sources without which the rest agrees.
        told: what the streams of both say of the time in which the contradiction began.
        off_rad: by so much the lights are off on the sky.
    """
    if told.ship_in_doubt:
        return SHIP if SHIP in explaining else None
    steps = {ENCODER: told.encoder, SHIP: told.ship}
    stepped = [name for name, step in steps.items() if step is not None and step.is_there(off_rad)]
    if stepped:
        return stepped[0] if len(stepped) == 1 and stepped[0] in explaining else source
    suspects = [steps[name] for name in {source, *explaining} & steps.keys()]
    right = all(step is not None and step.is_not(off_rad) for step in suspects)
    return TELESCOPE if right else source


def crept(source: str | None, explaining: Set[str], alike: bool, ship_crept: bool | None) -> str | None:
    """Who is wrong where lights that were used creep away from the estimate; None where nobody knows.

    Lights that creep alike do so by the encoders or the ship's attitude: two drones do not. The ship's own rates tell
    which. Where they creep in other ways, and encoders or ship explain that as well as a drone does, nobody is named.

    Args:
        source: as the rows have it; None where they do not know.
        explaining: all sources without which the rest agrees.
        alike: whether all lights creep alike.
        ship_crept: whether the ship's attitude has left its own rates; None where nothing tells.
    """
    chain = explaining & {ENCODER, SHIP}
    if ship_crept is not None:
        chain = chain & {SHIP if ship_crept else ENCODER}
    if not chain:
        return source
    if len(chain) == 1 and (alike or ship_crept or source in CHAIN):
        return next(iter(chain))
    return source if source in CHAIN else None


def no_doubt(rows: SourceRows) -> Trust:
    """At the start every source is trusted."""
    return Trust(no_means(1 + len(rows.sources), len(rows.beacons)))


class Referee:
    """Judges the sources of a configuration by what the rows of hypotheses see.

    Args:
        config: how sure exclusions are.
        gate: of the lights.
        rows: the rows.
        threshold: of a separation, in sigmas.
    """

    def __init__(self, config: IntegrityConfig, gate: GateConfig, rows: SourceRows, threshold: float) -> None:
        self._config, self._rows, self._threshold = config, rows, threshold
        self._limit = excess_limit(config, max(len(rows.beacons), 1))
        self._light_gate, self._degraded_after = chi_square_gate(gate.probability, 2), gate.degraded_after
        own = np.array([[BEACON + id_ == source for id_ in rows.beacons] for source in rows.sources], dtype=bool)
        self._leaves_out = np.vstack([np.zeros((1, len(rows.beacons)), dtype=bool), own])

    def heard_again(self, trust: Trust, names: tuple[str, ...], time_ns: int) -> Trust:
        """What is known before a sighting: in a silence before it nobody has agreed with anything.

        Args:
            trust: after the sighting before.
            names: of the lights that are seen now.
            time_ns: of the sighting.
        """
        heard_ns, silent_ns = trust.means.heard_ns, time_ns - HEARD_NS
        quiet: Set[str] = {BEACON + name for name in names if heard_ns[self._rows.beacons.index(name)] < silent_ns}
        if not quiet or not (trust.left_out or trust.conflict):
            return trust
        conflict = trust.conflict
        if heard_ns.max() < silent_ns:
            quiet = quiet | CHAIN
            conflict = None if conflict is None else replace(conflict, agrees_since_ns=None)
        left_out = dict(trust.left_out)
        for name in quiet & left_out.keys():
            exclusion = replace(left_out[name].exclusion, agrees_since_ns=None)
            left_out[name] = replace(left_out[name], exclusion=exclusion)
        return replace(trust, left_out=left_out, conflict=conflict)

    def observed(self, trust: Trust, names: tuple[str, ...], seen: RowsSeen, used: bool, time_ns: int) -> Trust:
        """What is known after the rows have seen a sighting, used or not, with lights that are not excluded."""
        beacons = [self._rows.beacons.index(name) for name in names]
        by_row = np.concatenate([[used], seen.accepted])[:, None]
        accepted = np.where(self._leaves_out[:, beacons], seen.light_nis <= self._light_gate, by_row)
        means = observed(trust.means, beacons, seen.light_turn, accepted, time_ns, self._limit)
        return replace(trust, means=means)

    def fault(self, trust: Trust, statistic: FloatArray, time_ns: int) -> tuple[bool, str | None, Set[str]]:
        """Whether a source is wrong, which one, where one explains it better than all others, and all that explain it.

        Args:
            trust: after the sighting.
            statistic: distance of each row from the estimate by all sources, in sigmas, shape (h,).
            time_ns: of the sighting.
        """
        sources, excluded = self._rows.sources, trust.excluded
        gone = np.array([BEACON + id_ in excluded for id_ in self._rows.beacons], dtype=bool)
        uses = ~(self._leaves_out | gone)
        distance = np.concatenate([[0.0], statistic])

        def found(names: list[str]) -> Finding:
            rows = [1 + sources.index(name) for name in names]
            return find_fault(trust.means, uses, distance, self._threshold, rows, time_ns, self._degraded_after)

        candidates = [name for name in sources if name not in excluded]
        finding = found(candidates)
        if not finding.fault:
            return False, None, set()
        explaining = {sources[row - 1] for row in finding.explaining}
        if finding.row is not None:
            return True, sources[finding.row - 1], explaining
        # What the encoders and what the ship's attitude do to the lights is much alike: either may explain it.
        for name, other in ((ENCODER, SHIP), (SHIP, ENCODER)):
            alone = found([candidate for candidate in candidates if candidate != other])
            if alone.row is not None and sources[alone.row - 1] == name:
                return True, name, explaining
        return True, None, explaining

    def creep_alike(self, trust: Trust, time_ns: int) -> bool:
        """Whether two lights or more, and all that are used, creep alike in the image."""
        used = [
            row
            for row, id_ in enumerate(self._rows.beacons)
            if BEACON + id_ not in trust.excluded and trust.means.heard_ns[row] >= time_ns - HEARD_NS
        ]
        if len(used) < 2:
            return False
        # Of the longer means, in sigmas: shape (w, l, 2).
        running = trust.means.running[0, used, 1:].swapaxes(0, 1)
        off = running[..., :2] / np.sqrt(running[..., 4:])
        size = np.linalg.norm(off, axis=-1)
        cosines = np.einsum("wlk,wmk->wlm", off, off) / (size[:, :, None] * size[:, None, :])
        alike = (size.min(axis=1) > _ALIKE_SIGMAS) & (cosines.min(axis=(1, 2)) > _ALIKE_COSINE)  # NaN is not
        return bool(np.any(alike))

    def suspects_ship(self, trust: Trust, time_ns: int) -> bool:
        """Whether lights creep away from the estimate, within the limit, and agree where it does without the ship."""
        heard = trust.means.heard_ns >= time_ns - HEARD_NS
        if trust.excluded or trust.conflict is not None or not np.any(trust.means.excess[0, heard] > _SUSPECTED):
            return False
        row = 1 + self._rows.sources.index(SHIP)
        return bool(np.all(trust.means.excess[row, heard] <= WELL) and np.all(trust.means.refused[row, heard] == 0))

    def without(self, trust: Trust, source: str, left_out: LeftOut, seen_by: str | None = None) -> Trust:
        """A source is excluded: every row now sees what the row without it, or without ``seen_by``, has seen."""
        row, means = 1 + self._rows.sources.index(seen_by or source), trust.means
        same = {
            name: np.repeat(getattr(means, name)[row : row + 1], 1 + len(self._rows.sources), axis=0)
            for name in SEEN_BY_ROWS
        }
        all_left_out = {**trust.left_out, source: left_out}
        return replace(trust, means=replace(means, **same), left_out=all_left_out, conflict=None)

    def jumped(self, trust: Trust, source: str, jump: BaselineJump) -> Trust:
        """Another jump of the baseline of a drone that is excluded: it may have jumped back."""
        left_out = trust.left_out[source]
        if jump.time_ns <= left_out.jump_ns + _SAME_JUMP_NS:
            return trust
        jumped_n, sigma_m = left_out.jumped_n + jump.jump_n, float(np.hypot(left_out.jumped_sigma_m, jump.sigma_m))
        again = replace(left_out, jumped_n=jumped_n, jumped_sigma_m=sigma_m, jump_ns=jump.time_ns)
        means = trust.means
        if np.linalg.norm(jumped_n) <= _UNDONE_SIGMAS * sigma_m:
            again = replace(again, jumped_n=np.zeros(3), jumped_sigma_m=0.0)
            means = forgotten(means, slice(None), [self._rows.sources.index(source)])
        return replace(trust, means=means, left_out={**trust.left_out, source: again})

    def watched_light(
        self, trust: Trust, name: str, compared: RowsCompared, time_ns: int, refused_m: float
    ) -> Trust:
        """A light of a drone that is excluded, beside the estimate by the others; it may be used again.

        Args:
            trust: before.
            name: of the light.
            compared: with the estimate by all other sources, one row.
            time_ns: of the sighting.
            refused_m: size on the detector of what must be refused, were it still there; 0 for nothing.
        """
        index, source = self._rows.beacons.index(name), BEACON + name
        left_out = trust.left_out[source]
        rows = 1 + len(self._rows.sources)
        turn = np.repeat(compared.turn, rows, axis=0)
        accepted = np.full(rows, bool(compared.nis[0] <= self._light_gate))
        means = observed(trust.means, index, turn, accepted, time_ns, self._limit, compared.turn_noise)
        exclusion, returns = judge_return(left_out.exclusion, means, index, time_ns, self._config.return_after_s)
        sigma_m = float(np.sqrt(np.max(np.linalg.eigvalsh(compared.covariance[0]))))
        if 0.0 < refused_m <= _POWER_SIGMAS * sigma_m:
            exclusion, returns = replace(exclusion, agrees_since_ns=None), False
        return self._watched(replace(trust, means=means), source, exclusion, returns)

    def watched_turn(self, trust: Trust, source: str, agrees: bool, time_ns: int) -> Trust:
        """The encoders, or the ship's attitude, while they are excluded: do they lead from sighting to sighting?"""
        exclusion = trust.left_out[source].exclusion
        since_ns = (exclusion.agrees_since_ns or time_ns) if agrees else None
        returns = since_ns is not None and time_ns - since_ns >= self._config.return_after_s * SECOND_NS
        return self._watched(trust, source, replace(exclusion, agrees_since_ns=since_ns), returns)

    def _watched(self, trust: Trust, source: str, exclusion: Exclusion, returns: bool) -> Trust:
        left_out, jumped_ns, means = dict(trust.left_out), dict(trust.jumped_ns), trust.means
        if returns:
            jumped_ns[source] = left_out.pop(source).jump_ns + _SAME_JUMP_NS
            row = len(self._rows.beacons) if source in CHAIN else self._rows.sources.index(source)
            if row < len(self._rows.beacons):
                # The rows that use it again see it otherwise than as one that they do without.
                others = [other for other in range(1 + len(self._rows.sources)) if other != 1 + row]
                means = forgotten(means, others, [row])
        else:
            left_out[source] = replace(left_out[source], exclusion=exclusion)
        return replace(trust, means=means, left_out=left_out, jumped_ns=jumped_ns)

    def disagreed(self, trust: Trust, spread_n: FloatArray, lasting: bool) -> Trust:
        """Lights were refused, and no single source explains it."""
        before = trust.conflict
        if before is not None and np.trace(before.spread_n) > np.trace(spread_n):
            spread_n = before.spread_n
        lasting = lasting or (before is not None and before.lasting)
        return replace(trust, conflict=Conflict(spread_n, lasting))

    def agreed(self, trust: Trust, time_ns: int) -> Trust:
        """Lights were accepted."""
        conflict = trust.conflict
        if conflict is None:
            return trust
        if not conflict.lasting:
            return replace(trust, conflict=None)
        if conflict.agrees_since_ns is None:
            # What the subfilters have seen while all lights were rejected is over: it isolates no source from now on.
            means = forgotten(trust.means, slice(None), slice(None))
            return replace(trust, means=means, conflict=replace(conflict, agrees_since_ns=time_ns))
        over = time_ns - conflict.agrees_since_ns >= self._config.return_after_s * SECOND_NS
        return replace(trust, conflict=None if over else conflict)
