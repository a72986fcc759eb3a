"""The message that says why an input was not used, the same for every node."""

from typing import Any

import numpy as np

from ship_bags.message_factory import MessageFactory
from ship_bags.stamps import make_header
from ship_estimation.refusals import Reason, shortened


def refusal_message(factory: MessageFactory, source: str, time_ns: int, reason: Reason, text: str) -> Any:
    """ship_msgs/Innovation of an input that was refused before it was compared."""
    source = shortened(source)
    return factory.make(
        "ship_msgs/msg/Innovation",
        header=make_header(factory, time_ns, source),
        source=source,
        components=[],
        residual=np.empty(0),
        sigma=np.empty(0),
        nis=float("nan"),
        gate=float("nan"),
        accepted=False,
        reason=int(reason),
        reason_text=shortened(text),
    )
