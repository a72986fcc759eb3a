"""Estimate of the suite's processor load on this computer, from the rates of its inputs.

The cost of a message is the processor time in a live node for receipt, estimation and outputs, measured on one
reference computer. The speed of another computer is measured with a small computation of the same kind. The load is
accurate to a factor of about 1.5.
"""

import time
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from ship_node.adapters.adapter import Adapter

MOST_SHARE = 0.7
"""Share of a core above which a node may fall behind at times."""

_IDLE_SHARE = 0.06
"""Share of a core that a node needs without inputs: ticks, diagnostics."""

_COST_MS: Mapping[str, tuple[tuple[str, float], ...]] = {
    "ship_attitude": (("ins/", 0.7), ("star/", 1.5), ("", 0.6)),
    "star_attitude": (("star/", 2.0), ("", 0.4)),
}
"""Node → prefix of a topic and cost of a message on it, ms; the first matching row counts."""

_OTHER_COST_MS = 0.6
"""Cost of a message of any other node, ms."""

_REFERENCE_S = 14e-6
"""Duration of the test computation on the reference computer, s."""

_MEASURED_S, _SLICES = 0.2, 10


@dataclass(frozen=True)
class NodeLoad:
    """Load of one node.

    Attributes:
        node: name of the node.
        share: share of one core of this computer.
        busiest: input with the largest share, with its rate.
    """

    node: str
    share: float
    busiest: str

    @property
    def is_too_much(self) -> bool:
        """True if the node is expected to fall behind at times."""
        return self.share > MOST_SHARE


def node_loads(adapters: Sequence[Adapter], rates_hz: Mapping[str, float], slowness: float) -> list[NodeLoad]:
    """Return the load of each node.

    Args:
        adapters: adapters of the nodes.
        rates_hz: topic → rate of inputs from outside; rates of topics between nodes are derived from these rates.
        slowness: relative slowness of this computer, see :func:`measured_slowness`.
    """
    found = []
    for adapter in adapters:
        rates = {topic.topic: rate for topic in adapter.inputs if (rate := _rate_hz(topic.topic, rates_hz)) > 0.0}
        shares = {topic: rate * _cost_s(adapter.node_name, topic) for topic, rate in rates.items()}
        busiest = max(shares, key=lambda topic: shares[topic], default="")
        text = f"{busiest} at {rates[busiest]:.4g} Hz" if busiest else ""
        found.append(NodeLoad(adapter.node_name, slowness * (_IDLE_SHARE + sum(shares.values())), text))
    return found


def load_text(found: Sequence[NodeLoad]) -> str:
    """Return the loads of the nodes as a line for the user.

    Example:
        >>> load_text([NodeLoad("ship_attitude", 0.142, ""), NodeLoad("star_attitude", 0.093, "")])
        'load: about 14 % of one core for ship_attitude, 9 % for star_attitude'
    """
    first, *others = found
    words = [f"load: about {100.0 * first.share:.0f} % of one core for {first.node}"]
    return ", ".join([*words, *(f"{100.0 * load.share:.0f} % for {load.node}" for load in others)])


def load_warnings(found: Sequence[NodeLoad], cores: int) -> Iterator[str]:
    """Yield a warning for each node, and for all nodes together, if this computer is expected to be too slow.

    Args:
        found: the loads of the nodes.
        cores: processor cores of this computer.

    Example:
        >>> for text in load_warnings([NodeLoad("ship_attitude", 0.84, "imu at 1000 Hz")], cores=1):
        ...     print(text)
        ship_attitude takes about 84 % of one core, limit 70 %: it may fall behind; largest load: imu at 1000 Hz
    """
    for load in found:
        if load.is_too_much:
            yield (
                f"{load.node} takes about {100.0 * load.share:.0f} % of one core, limit {100.0 * MOST_SHARE:.0f} %: "
                f"it may fall behind; largest load: {load.busiest}"
            )
    total = sum(load.share for load in found)
    if len(found) > 1 and total > MOST_SHARE * cores:
        limit = f"limit {100.0 * MOST_SHARE:.0f} % of each"
        yield f"all nodes together take about {100.0 * total:.0f} % of a core, {limit}, and there are {cores}"


def measured_slowness() -> float:
    """Return the computing time of this computer relative to the reference computer; the measurement takes 0.2 s."""
    matrix, times_s = np.eye(21) + 0.01, []
    for _ in range(_SLICES):
        begin_s, count = time.process_time(), 0
        while time.process_time() - begin_s < _MEASURED_S / _SLICES:
            _reference_step(matrix)
            count += 1
        times_s.append((time.process_time() - begin_s) / count)
    # Other programs can only increase the time.
    return min(times_s) / _REFERENCE_S


def _reference_step(matrix: np.ndarray) -> None:
    """Do a computation typical of a filter step: small matrices, and Python around them."""
    known = {str(number): 0.5 * number for number in range(40)}
    matrix = matrix @ (known["2"] * (matrix + matrix.T))
    np.linalg.cholesky(matrix @ matrix.T + np.eye(len(matrix)))


def _cost_s(node: str, topic: str) -> float:
    rows = _COST_MS.get(node, ())
    return 1e-3 * next((cost_ms for begin, cost_ms in rows if topic.startswith(begin)), _OTHER_COST_MS)


def _rate_hz(topic: str, rates_hz: Mapping[str, float]) -> float:
    """Return the rate of a topic; for the output of another node, the rate of the input from which it is computed."""
    if topic in rates_hz:
        return rates_hz[topic]
    made_of = "ins/imu" if topic == "ship/attitude" else topic.replace("/solution", "/observations")
    return rates_hz.get(made_of, 0.0)
