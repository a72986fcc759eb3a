"""Parameters that name the frames of the ship herself: other trees of ROS frames have names of their own for them."""

from dataclasses import dataclass
from typing import Any

from ship_estimation.parameter_fields import parameter
from ship_estimation.parameters import ParameterError


def publish_tf() -> Any:
    """Return the parameter ``publish_tf`` of a node that publishes transforms.

    Example:
        >>> import dataclasses
        >>> @dataclasses.dataclass(frozen=True)
        ... class Node:
        ...     publish_tf: bool = publish_tf()
        >>> Node().publish_tf
        True
    """
    return parameter(
        True, doc="transforms go out on /tf and /tf_static; false where another node publishes those of these frames"
    )


def _check_name(name: str, frame: str) -> None:
    """Refuse what tf2 takes for no frame's name."""
    if not frame or frame.startswith("/") or frame != frame.strip():
        raise ParameterError(
            f"parameter '{name}' = {frame!r} is no name of a frame: expected one as 'base_link', without a slash first",
            name,
            value=frame,
        )


@dataclass(frozen=True, kw_only=True)
class DeckFrame:
    """The name of the ship's own frame."""

    deck: str = parameter("deck", doc="name of the ship's frame (forward, left, up), as base_link")

    def __post_init__(self) -> None:
        _check_name("frames.deck", self.deck)


@dataclass(frozen=True, kw_only=True)
class HorizonFrame:
    """The name of the horizon's frame."""

    horizon: str = parameter("horizon", doc="name of the frame East, North, Up at the ship")

    def __post_init__(self) -> None:
        _check_name("frames.horizon", self.horizon)


@dataclass(frozen=True, kw_only=True)
class FrameNames(DeckFrame, HorizonFrame):
    """The names of both.

    Raises:
        ParameterError: one is no name, or both are the same.
    """

    def __post_init__(self) -> None:
        DeckFrame.__post_init__(self)
        HorizonFrame.__post_init__(self)
        if self.deck == self.horizon:
            raise ParameterError(
                f"parameter 'frames.deck' = {self.deck!r} is that of 'frames.horizon': expected two names",
                "frames.deck",
                value=self.deck,
            )


FRAME_NAMES = FrameNames()
"""The names by default."""
