"""Parameters for the names of the ship's frames, which differ between the frame trees of ROS systems."""

from dataclasses import dataclass
from typing import Any

from ship_estimation.parameters.fields import parameter
from ship_estimation.parameters.schema import ParameterError


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
        True, doc="publish transforms on /tf and /tf_static; false if another node publishes those of these frames"
    )


def _check_name(name: str, frame: str) -> None:
    """Raise :class:`ParameterError` for a name that tf2 does not accept as a frame."""
    if not frame or frame.startswith("/") or frame != frame.strip():
        raise ParameterError(
            f"parameter '{name}' = {frame!r} is not a frame name: expected one like 'base_link', no slash first",
            name,
            value=frame,
        )


@dataclass(frozen=True, kw_only=True)
class DeckFrame:
    """Name of the ship's frame."""

    deck: str = parameter("deck", doc="name of the ship's frame (forward, left, up), as base_link")

    def __post_init__(self) -> None:
        _check_name("frames.deck", self.deck)


@dataclass(frozen=True, kw_only=True)
class HorizonFrame:
    """Name of the horizon frame."""

    horizon: str = parameter("horizon", doc="name of the frame East, North, Up at the ship")

    def __post_init__(self) -> None:
        _check_name("frames.horizon", self.horizon)


@dataclass(frozen=True, kw_only=True)
class FrameNames(DeckFrame, HorizonFrame):
    """Names of the ship's frame and of the horizon frame.

    Raises:
        ParameterError: a name is invalid, or both names are the same.
    """

    def __post_init__(self) -> None:
        DeckFrame.__post_init__(self)
        HorizonFrame.__post_init__(self)
        if self.deck == self.horizon:
            raise ParameterError(
                f"parameter 'frames.deck' = {self.deck!r} equals 'frames.horizon': expected two different names",
                "frames.deck",
                value=self.deck,
            )


FRAME_NAMES = FrameNames()
"""The default names."""
