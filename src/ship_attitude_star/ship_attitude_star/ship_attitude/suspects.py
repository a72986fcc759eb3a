"""Who is suspected: what the rows of hypotheses say of a ship's sources after each measurement.

What each row leaves out is told by the table of rows (:mod:`ship_attitude_star.ship_attitude.row_table`). A source is
excluded where the row without it explains what the others cannot; so is an INS that creeps away from all others. A step
is another matter: a wrong position moves all stars alike, just as a step of the INS would. Where all stars suddenly
contradict the INS this is told as a doubt, and they are not used until they agree with it again. Whether it was the INS
that jumped, its own rates tell (:mod:`ship_estimation.ins_guard`); where they told so not long ago, it is the INS that
is excluded (:mod:`ship_attitude_star.ship_attitude.ins_at_fault`).
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import replace
from types import MappingProxyType

import numpy as np
from numpy.typing import NDArray

from ship_attitude_star.ship_attitude.comparison import Compared
from ship_attitude_star.ship_attitude.config import ShipAttitudeConfig
from ship_attitude_star.ship_attitude.ins_at_fault import InsAtFault, distrusted
from ship_attitude_star.ship_attitude.model import Device, ShipStateModel
from ship_attitude_star.ship_attitude.row_table import INS, LEAST_FOR_PAIRS, RowTable
from ship_attitude_star.ship_attitude.state import Apart, Doubt, FilterState, Lately, changed, shared_turn, with_entry
from ship_estimation.common_error import SUSPECTED_SIGMAS
from ship_estimation.exclusion import (
    HEARD_NS,
    Exclusion,
    Finding,
    agrees_with_all,
    find_fault,
    judge_return,
    must_agree_s,
)
from ship_estimation.hypotheses import (
    RowsCompared,
    add_error,
    promoted,
    separations,
    stand_together,
    update_rows,
)
from ship_estimation.outcome import Measurement
from ship_estimation.protection import UNDISPUTED_SIGMAS, disputed
from ship_estimation.running_means import NO_MEANS, averaged, forgotten, no_means, observed
from ship_geometry.rotations import ARCSEC, FloatArray
from ship_geometry.time_scales import SECOND_NS

_KNOCKED_SIGMA = 2.0
"""After a knock the mounting may be off by so many times what is seen of the knock."""

_LEAST_KNOCK_RAD, _LARGEST_KNOCK_RAD = 10.0 * ARCSEC, 3600.0 * ARCSEC
"""As its sigma."""

_WATCHED_NS = 3 * SECOND_NS
"""So long all sources in use must have been heard before the INS is said to creep away from them."""


_CREEPS_FOR_NS = 10 * SECOND_NS
"""An INS that all stars contradict creeps if they find it farther off for so long: half of a slow roll, ns."""


class Suspects:
    """The verdicts by the rows of a configuration.

    Args:
        config: the node's configuration.
        model: what the states are.
        devices: the sources by name.

    Attributes:
        table: the rows.
        ins: what is done where the INS is the one that is wrong.

    Raises:
        ParameterError: there are more rows than ``integrity.max_hypotheses``.
    """

    def __init__(self, config: ShipAttitudeConfig, model: ShipStateModel, devices: Mapping[str, Device]) -> None:
        self._integrity, self._model = config.integrity, model
        self._degraded_after = config.gate.degraded_after
        self.table = RowTable(config, model, devices)
        self._sources = self.table.sources
        self._indices = {name: index for index, name in enumerate(self._sources)}
        self.ins = InsAtFault(config, model, self.table)
        self._slow = model.slices["ins.attitude"]
        self._undisputed = min(UNDISPUTED_SIGMAS, self.table.k.false_exclusion)

    def start(self, mean: FloatArray, parts: FloatArray) -> FilterState:
        """All rows at one state, before any measurement; shapes (n,) and (n_sources, n, n)."""
        return FilterState(None, *self.ins.all_rows_at(mean, parts), no_means(self.table.rows, len(self._sources)))

    def uses(self, state: FilterState) -> NDArray[np.bool_]:
        """Which source each row uses, shape (h, s)."""
        if not state.excluded:
            return self.table.uses
        excluded = np.array([name in state.excluded for name in self._sources], dtype=bool)
        used: NDArray[np.bool_] = self.table.uses & ~excluded
        return used

    def learned(
        self,
        state: FilterState,
        predicted: FilterState,
        measurement: Measurement,
        measured: Compared,
        compared: RowsCompared,
        accepted: NDArray[np.bool_],
    ) -> FilterState:
        """All rows with what each learns of a measurement; where none learns, not even the prediction is kept.

        Args:
            state: before the measurement.
            predicted: the same, carried to its moment.
            measurement: itself.
            measured: against the first row.
            compared: with all rows.
            accepted: whether it passed the gate of each row, shape (h,).
        """
        source, index = measurement.source, self._indices[measurement.source]
        used = self.table.users[source] if not state.excluded else self.uses(state)[:, index]
        noise = None if used[0] else compared.turn_noise
        seen = observed(
            state.seen, index, compared.turn, accepted, measurement.time_ns, self.table.limit, noise
        )
        if state.seen.heard_ns[index] < measurement.time_ns - HEARD_NS:
            state, predicted = (self._heard_again(one, source, measurement.time_ns) for one in (state, predicted))
        last = Apart(compared.turn[0], compared.turn_root[0], measured.predicted_nv)
        apart = with_entry(state.apart, source, last)
        exclusion = state.excluded.get(source)
        # A measurement that no row uses leaves all of them, to the last bit, as they are without it. Of an excluded
        # source nothing is used, but how it is mounted may be learnt anew.
        learnt = any((used & accepted).tolist()) if exclusion is None else exclusion.apart is None
        if not learnt:
            return changed(state, seen=seen, apart=apart)
        learns = self.ins.learns(state, self._learns(state, source, used) & accepted[:, None])
        corrections, stack = update_rows(predicted.stack, measured.linear, compared, learns)
        lately, absorbed = state.lately, state.absorbed
        if used[0] and accepted[0]:
            running = lately[source].running if source in lately else NO_MEANS
            lately = with_entry(lately, source, Lately(*averaged(running, compared.turn[0])))
            if source in self.table.stars and INS not in state.excluded:
                absorbed = absorbed.with_correction(compared, measured.linear.jacobian, self._slow.start)
        means = predicted.means + corrections
        return changed(
            predicted, means=means, stack=stack, seen=seen, apart=apart, lately=lately, absorbed=absorbed
        )

    def _learns(self, state: FilterState, source: str, used: NDArray[np.bool_]) -> NDArray[np.bool_]:
        """Which states each row may learn of a source, shape (h, n), by whether it uses the source, shape (h,)."""
        return self.table.learns[source] if not state.excluded else used[:, None] | self.table.own[source]

    def _heard_again(self, state: FilterState, source: str, time_ns: int) -> FilterState:
        """The state before the first measurement after a silence: in that time nobody has agreed with anything."""
        excluded = dict(state.excluded)
        if source in excluded:
            excluded[source] = replace(excluded[source], agrees_since_ns=None)
        if distrusted(state) and state.seen.heard_ns.max() < time_ns - HEARD_NS:
            excluded[INS] = replace(excluded[INS], agrees_since_ns=time_ns)
        heard_since_ns = with_entry(state.heard_since_ns, source, time_ns)
        return changed(state, excluded=MappingProxyType(excluded), heard_since_ns=heard_since_ns)

    def separations(self, state: FilterState) -> tuple[FloatArray, FloatArray]:
        """Distances of the rows from the first one, about North, Up and East, and these in sigmas at most.

        Shapes (h, 3), rad, and (h,).
        """
        return separations(state.means, state.stack, self._slow)

    def judged(
        self, state: FilterState, source: str, compared: RowsCompared, ins_vouched: bool, time_ns: int
    ) -> tuple[FilterState, str]:
        """The state after the verdict that a measurement leads to, and what is to be said of its source.

        Args:
            state: with that measurement.
            source: who measured.
            compared: the measurement with every row.
            ins_vouched: whether the INS's rates would have told a step of it.
            time_ns: stamp of the measurement.
        """
        if self._nothing_disputed(state):
            return state, ""
        state = self.ins.believed_again(state, time_ns)
        if source in state.excluded:
            state, text = self._judge_return(state, source, compared, time_ns)
            if source in state.excluded:
                return state, text
        if distrusted(state):
            agrees = not self._contradicts(state, self._sources.index(source))
            return self.ins.watched(state, compared, agrees, time_ns), ""
        table, uses, in_use = self.table, self.uses(state), state.in_use(self._sources, time_ns)
        apart_n, statistic = self.separations(state)
        candidates: Sequence[int] = table.singles
        if state.excluded:
            candidates = [row for row in candidates if table.names[row - 1] not in state.excluded]
        pairs = table.pairs_in_question(in_use, state.excluded) if table.pairs else []
        # A step of the INS its rates would have told; that it creeps they do not tell.
        stepped = any(state.seen.refused[0].tolist())
        if ins_vouched and stepped:
            candidates, pairs = ([row for row in rows if row not in table.ins_rows] for rows in (candidates, pairs))
        elif stepped and len(in_use) <= LEAST_FOR_PAIRS:
            pairs = []  # One source and an INS that may have stepped are no better than two other sources.
        threshold, after = table.k.false_exclusion, self._degraded_after
        finding = find_fault(state.seen, uses, statistic, threshold, candidates, time_ns, after, pairs)
        # Written so that NaN is shared.
        shared = not state.absorbed.sigmas <= table.common_threshold and INS not in state.excluded
        if not finding.fault and not shared:
            return self._agreed(state, in_use, apart_n, statistic, time_ns), ""
        wrong = self._named(state, finding)
        if state.absorbed.sigmas > SUSPECTED_SIGMAS and not table.stars.isdisjoint(wrong):
            wrong = ()  # All stars together contradict the INS: one that explains a part of it is not at fault.
        if self.ins.told(state, time_ns):
            state = changed(state, ins_suspected_ns=time_ns)
            if INS not in wrong and not set(table.ins_rows).isdisjoint(finding.explaining):
                wrong = ()  # An INS that jumped explains it as well: it may have turned in its own frame.
        contradicting = self._stars_contradicting(state, wrong, in_use, shared)
        against_ins = len(contradicting) > 1 or (INS in wrong and stepped)
        if against_ins and self.ins.told(state, time_ns) and self.ins.may_be_excluded(in_use):
            state, text = self._without(state, (INS,), time_ns)
            return self.ins.contradicted_now(state, time_ns), text
        if INS in wrong and (stepped or not table.contradict_ins([name for name in in_use if name not in wrong])):
            wrong = ()  # A wrong position moves all stars alike, as a step of the INS without rates does.
        if INS in wrong and any(time_ns - state.heard_since_ns[name] < _WATCHED_NS for name in in_use):
            wrong = ()  # What has moved while nobody was heard, the INS or a sensor, a few measurements do not tell.
        if INS in state.excluded and len(in_use) < LEAST_FOR_PAIRS:
            wrong = ()  # Either of two sources explains what the other contradicts.
        if wrong and not set(in_use).issubset(wrong):
            return self._without(state, wrong, time_ns)
        doubted = self._in_doubt(state, apart_n, statistic, contradicting)
        return self._without_stars(doubted, contradicting, shared, time_ns) if contradicting else doubted, ""

    def _nothing_disputed(self, state: FilterState) -> bool:
        """Whether all is as on most days: nobody is excluded, nothing contradicts anything, and nothing did before."""
        if state.excluded or state.doubt is not None or state.disputed_n is not None:
            return False
        # NaN is not within.
        return (
            state.absorbed.sigmas <= SUSPECTED_SIGMAS
            and agrees_with_all(state.seen, self._degraded_after)
            and all(one.sigmas <= UNDISPUTED_SIGMAS for one in state.lately.values())
            and stand_together(state.means, state.stack, self._slow, self._undisputed)
        )

    def _agreed(
        self, state: FilterState, in_use: list[str], apart_n: FloatArray, statistic: FloatArray, time_ns: int
    ) -> FilterState:
        """The state in which nobody is wrong as far as anything tells.

        A source that creeps pulls the attitude away from the row without it long before it may be excluded. One that
        was knocked by a few sigmas pulls it within a second: what it said lately contradicts the first row before the
        two rows stand apart.
        """
        if INS not in state.excluded and self.ins.may_be_excluded(in_use):
            statistic = statistic.copy()
            for row, source in enumerate(self._sources, start=1):
                if source in in_use and source in state.lately:
                    statistic[row] = np.maximum(statistic[row], state.lately[source].sigmas)
        # Written so that a distance that is no number is looked at.
        within = all(sigmas <= UNDISPUTED_SIGMAS for sigmas in statistic.tolist())
        absorbed = state.absorbed.with_suspicion(time_ns, round(self._integrity.return_after_s * SECOND_NS))
        suspicion = absorbed.suspicion
        if within and state.doubt is None and state.disputed_n is None and suspicion is None:
            return state
        disputed_n = None if within else disputed(apart_n, statistic)
        if suspicion is not None:
            shared_n = np.diag(suspicion.variance)
            disputed_n = shared_n if disputed_n is None else disputed_n + shared_n
        return changed(state, doubt=None, disputed_n=disputed_n, absorbed=absorbed)

    def acquitted(self, state: FilterState, time_ns: int) -> FilterState:
        """The state after the INS has told itself that it jumped: those that contradicted it were right.

        What the rows differ by was the contradiction: with it all of them begin anew from the first one.
        """
        if state.doubt is not None:
            means, stack = self.ins.all_rows_at(state.mean, state.parts)
            state = changed(state, means=means, stack=stack)
        if distrusted(state):
            return self.ins.contradicted_now(state, time_ns)
        return self._forgiven(state)

    def without_ins(self, state: FilterState, time_ns: int) -> FilterState:
        """The state after the INS has told that it creeps: it is excluded where enough others check each other.

        The row in which it is wrong has followed all the time. Stars that contradicted it were right.
        """
        told = state if state.doubt is None else self.acquitted(state, time_ns)
        if INS in state.excluded or not self.ins.may_be_excluded(told.in_use(self._sources, time_ns)):
            return state
        return self._without(told, (INS,), time_ns)[0]

    def begun_anew(self, state: FilterState) -> FilterState:
        """The state after a gate was re-opened: what the sources contradicted of one another is forgotten."""
        means, stack = self.ins.all_rows_at(state.mean, state.parts)
        return self._forgiven(changed(state, means=means, stack=stack))

    def _forgiven(self, state: FilterState) -> FilterState:
        """The state in which only those stay excluded that were knocked, and the INS."""
        knocked = {name: exclusion for name, exclusion in state.excluded.items() if exclusion.apart is None}
        seen = forgotten(state.seen, slice(None), slice(None))
        doubt = state.doubt if distrusted(state) else None
        return changed(
            state,
            excluded=MappingProxyType(knocked),
            seen=seen,
            lately=MappingProxyType({}),
            absorbed=state.absorbed.without_corrections(),
            doubt=doubt,
            disputed_n=None,
        )

    # -- verdicts -------------------------------------------------------------------------------------------

    def _named(self, state: FilterState, finding: Finding) -> tuple[str, ...]:
        """Those that are wrong; among those that may be it the only ones that were wrong before. Empty: nobody is."""
        left_out = self.table.left_out
        known = [row for row in finding.explaining if state.record.keys() >= set(left_out[row - 1])]
        row = known[0] if len(known) == 1 else finding.row
        return () if row is None else left_out[row - 1]

    def _without(self, state: FilterState, wrong: tuple[str, ...], time_ns: int) -> tuple[FilterState, str]:
        """The state once sources are excluded: the row without them is now the first, and the start of all others."""
        row, rows = self.table.left_out.index(wrong) + 1, len(state.means)
        means = np.tile(state.means[row], (rows, 1))
        stack = promoted(state.stack, rows, row)
        excluded, record, used_ns = dict(state.excluded), dict(state.record), dict(state.used_ns)
        for name in wrong:
            # What is farther off than a knock can make it has another mistake: that must be mended, not learnt.
            relearns = name != INS and self._knock(state, name) is not None
            if relearns:
                self._open_mounting(stack, state, name)
            record[name] = state.record.get(name, 0) + 1
            apart = None if relearns or name == INS else state.apart[name].turn_v
            excluded[name] = Exclusion(time_ns, record[name], apart=apart)
            used_ns.pop(name, None)
        state = changed(
            state,
            means=means,
            stack=stack,
            seen=forgotten(state.seen, slice(None), slice(None)),
            lately=MappingProxyType({}),
            absorbed=state.absorbed.without_corrections(),
            excluded=MappingProxyType(excluded),
            record=MappingProxyType(record),
            doubt=None,
            disputed_n=None,
            used_ns=MappingProxyType(used_ns),
        )
        are, them = ("is", "it") if len(wrong) == 1 else ("are", "them")
        remaining = ", ".join(name for name in (INS, *self._sources) if name not in excluded)
        return state, f"{' and '.join(wrong)} {are} excluded: without {them} {remaining} agree"

    def _without_stars(
        self, state: FilterState, stars: tuple[str, ...], shared: bool, time_ns: int
    ) -> FilterState:
        """Return the state without any star: all of them contradict the INS, and nothing tells which side is wrong.

        Nothing tells either that the sensors were knocked, so their mountings are kept. All subfilters restart from the
        main filter, which has rejected the stars. What it has learnt of an error that they share is taken back: the INS
        carries on from before.
        """
        turn_n = shared_turn([state.apart[name] for name in stars])
        mean, parts = state.mean, state.parts
        if shared:
            absorbed = state.absorbed
            turn_n = turn_n + absorbed.turn_n
            mean, parts = mean.copy(), parts.copy()
            mean[self._slow] -= absorbed.turn_n
            self.ins.open_slow_error(parts, np.diag(absorbed.variance))
        excluded = {
            name: Exclusion(time_ns, apart=state.apart[name].predicted_nv.T @ turn_n, is_shared=True) for name in stars
        }
        means, stack = self.ins.all_rows_at(mean, parts)
        return changed(
            state,
            means=means,
            stack=stack,
            excluded=MappingProxyType({**state.excluded, **excluded}),
            absorbed=state.absorbed.without_corrections(),
        )

    def _judge_return(
        self, state: FilterState, source: str, compared: RowsCompared, time_ns: int
    ) -> tuple[FilterState, str]:
        """Return the state after a measurement of an excluded source, which may return with it, and a text."""
        state = self._with_distance(state, source, time_ns)
        if self._ins_creeps_on(state, source, time_ns):
            return self.without_ins(state, time_ns), "ins is excluded: it goes on creeping away from all stars"
        index, exclusion = self._sources.index(source), state.excluded[source]
        after_s = self._integrity.return_after_s
        share = self._share_left(state, source, time_ns)
        sigma = _share_sigma(state, source, compared)
        exclusion, back = judge_return(exclusion, state.seen, index, time_ns, after_s, share, sigma)
        after_s = must_agree_s(exclusion, after_s)
        if not back:
            state = changed(state, excluded=with_entry(state.excluded, source, exclusion))
            if exclusion.apart is None and self._contradicts(state, index):
                # Knocked once more, or back: what was learnt of its mounting since is void.
                stack = state.stack.copy()
                self._open_mounting(stack, state, source)
                state = changed(state, stack=stack, seen=forgotten(state.seen, slice(None), [index]))
            since_s = (time_ns - exclusion.since_ns) / SECOND_NS
            agrees = "it does not agree with the others"
            if exclusion.agrees_since_ns is not None:
                agreed_s = (time_ns - exclusion.agrees_since_ns) / SECOND_NS
                agrees = f"it has agreed with the others for {agreed_s:.0f} s of {after_s:g} s"
            return state, f"{source} is excluded for {since_s:.0f} s: {agrees}"
        together = self._excluded_with(state, source)
        seen = forgotten(state.seen, slice(None), [self._indices[name] for name in together])
        remaining = {name: one for name, one in state.excluded.items() if name not in together}
        are = "is" if len(together) == 1 else "are"
        text = f"{' and '.join(together)} {are} used again"
        return changed(state, seen=seen, excluded=MappingProxyType(remaining), doubt=None), text

    def _with_distance(self, state: FilterState, source: str, time_ns: int) -> FilterState:
        """Return the state with the time since which an excluded source is much farther off in the same direction."""
        exclusion, last = state.excluded[source], state.apart[source]
        if exclusion.apart is None:
            return state
        before = np.linalg.pinv(last.root) @ exclusion.apart
        moved = last.whitened - before
        # Both have the noise of a measurement.
        is_farther = moved @ moved > 2.0 * self.table.limit and moved @ before > 0.0
        since_ns = exclusion.farther_since_ns
        since_ns = None if not is_farther else time_ns if since_ns is None else since_ns
        if since_ns == exclusion.farther_since_ns:
            return state
        exclusion = replace(exclusion, farther_since_ns=since_ns)
        return changed(state, excluded=with_entry(state.excluded, source, exclusion))

    def _ins_creeps_on(self, state: FilterState, source: str, time_ns: int) -> bool:
        """True if all stars that were set aside together have found the INS much farther off for half of a roll.

        Where they share an error that stays, only the INS's wander changes the distance, and its covariance holds that.
        Where their clocks are wrong, the distance oscillates with the ship.
        """
        since_ns = state.excluded[source].since_ns
        together = {name: one for name, one in state.excluded.items() if one.since_ns == since_ns and name != INS}
        if state.doubt is None or len(together) < len(self.table.stars) or not self.ins.may_be_excluded([*together]):
            return False
        return all(
            one.farther_since_ns is not None and time_ns - one.farther_since_ns >= _CREEPS_FOR_NS
            for one in together.values()
        )

    @staticmethod
    def _excluded_with(state: FilterState, source: str) -> list[str]:
        """Return the sources that return with one: itself, and those excluded with it that agree with the others now.

        Stars that were excluded because all of them contradicted the INS check each other; one of them alone could not
        be told from an INS that has moved meanwhile.
        """
        own = state.excluded[source]
        if own.apart is None:
            return [source]
        return [
            name
            for name, one in state.excluded.items()
            if name == source
            or (one.apart is not None and one.since_ns == own.since_ns and one.agrees_since_ns is not None)
        ]

    def _share_left(self, state: FilterState, source: str, time_ns: int) -> float:
        """Return the share of an excluded source's distance that is left by its measurement; 0 where it has none.

        Of an error that stars may share it is the share by all of them. One of them sees a turn about its line of sight
        poorly, and would take the INS's wander about the other axes for a part of it.
        """
        own, heard_ns = state.excluded[source], time_ns - HEARD_NS
        names = [source]
        if own.is_shared:
            shared = [name for name, one in state.excluded.items() if one.is_shared and one.since_ns == own.since_ns]
            names = [name for name in shared if state.seen.heard_ns[self._indices[name]] >= heard_ns]
        along = square = 0.0
        for name in names:
            measured, apart = state.apart[name], state.excluded[name].apart
            if apart is not None:
                distance = np.linalg.pinv(measured.root) @ apart
                along += float(distance @ measured.whitened)
                square += float(distance @ distance)
        return along / square if square > 0.0 else 0.0

    def _contradicts(self, state: FilterState, index: int) -> bool:
        """Whether what the first row has seen of a source contradicts it."""
        seen = state.seen
        return not (seen.excess[0, index] <= 1.0 and seen.refused[0, index] < self._degraded_after)

    def _in_doubt(
        self, state: FilterState, apart_n: FloatArray, statistic: FloatArray, contradicting: tuple[str, ...]
    ) -> FilterState:
        """The state in which nothing tells who is wrong: the attitude may be off by all that is in dispute."""
        vectors = [apart.turn_n for name, apart in state.apart.items() if state.refusals.get(name, 0)]
        vectors += [vector for vector, size in zip(apart_n, statistic, strict=True) if size > 1.0]
        if state.absorbed.sigmas > SUSPECTED_SIGMAS:
            vectors.append(state.absorbed.error_n)
        covariance_n = sum((np.outer(vector, vector) for vector in vectors), start=np.zeros((3, 3)))
        if contradicting:
            text = f"{', '.join(contradicting)} {'are' if len(contradicting) > 1 else 'is'} refused: the INS and all "
            text += "stars contradict one another"
        else:
            text = "the sources contradict one another, and which of them is wrong nothing tells"
        return changed(state, doubt=Doubt(text, covariance_n), disputed_n=None)

    def _stars_contradicting(
        self, state: FilterState, wrong: tuple[str, ...], in_use: list[str], shared: bool
    ) -> tuple[str, ...]:
        """All stars in use, where each of them contradicts the rest, or all the INS; none where some do not."""
        heard = [name for name in in_use if name in self.table.stars]
        if shared:
            return tuple(heard)
        long_refused = state.seen.refused[0] >= self._degraded_after
        against = [name for name in heard if name in wrong or long_refused[self._sources.index(name)]]
        return tuple(heard) if heard and len(against) == len(heard) else ()

    def _knock(self, state: FilterState, source: str) -> FloatArray | None:
        """Sigma, as a rotation vector of the device, of a knock that explains a source's last measurement.

        None where no knock is so large.
        """
        knock_v = _KNOCKED_SIGMA * state.apart[source].turn_v
        return knock_v if np.linalg.norm(knock_v) <= _LARGEST_KNOCK_RAD else None

    def _open_mounting(self, stack: FloatArray, state: FilterState, source: str) -> None:
        """Let it be learnt anew, in place, how a source is mounted: it may have been knocked."""
        knock_v = self._knock(state, source)
        if knock_v is not None:
            block = self._model.blocks[f"{source}.installation"]
            covariance = np.outer(knock_v, knock_v) + _LEAST_KNOCK_RAD**2 * np.eye(3)
            part = self._model.sources.index(block.source)
            add_error(stack, len(state.means), part, self._model.slices[block.name], covariance)


def _share_sigma(state: FilterState, source: str, compared: RowsCompared) -> float:
    """Return the standard deviation, by the state alone, of the share of an excluded source's distance that is left."""
    apart = state.excluded[source].apart
    if apart is None:
        return 0.0
    distance = np.linalg.pinv(state.apart[source].root) @ apart
    by_state = np.eye(3) - compared.turn_noise
    return math.sqrt(max(float(distance @ by_state @ distance), 0.0)) / float(distance @ distance)
