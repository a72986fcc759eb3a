"""What comes out of the star-attitude core: solutions of one sensor or of all, and the stars that were refused."""

from dataclasses import dataclass, field

from ship_attitude_star.stars.solution import SolutionStatus, StarSolution
from ship_estimation.refusals import Refusal


@dataclass(frozen=True)
class RefusedStar:
    """A star that had no part in a solution.

    Attributes:
        source: ``star.<id>``, the sensor that saw it.
        time_ns: stamp of the exposure.
        name: which star, for people.
        refusal: why.
        residual: measured minus predicted direction, up and right in the sensor, rad; empty where it was not compared.
        sigma: standard deviation of each of the two, rad.
    """

    source: str
    time_ns: int
    name: str
    refusal: Refusal
    residual: tuple[float, ...] = ()
    sigma: float = float("nan")


@dataclass(frozen=True)
class Solved:
    """An attitude from stars: of a sensor, or of the deck by several.

    Attributes:
        sensor_id: which sensor, or JOINT.
        time_ns: moment of validity: the stamp of the exposure, of a joint solution that of its first.
        solution: the attitude.
        refused: stars that had no part in it.
        sources: the sensors whose stars have a part in it, ``star.<id>``.
        text: what else is to be said, for people; empty mostly.
    """

    sensor_id: str
    time_ns: int
    solution: StarSolution
    refused: tuple[RefusedStar, ...]
    sources: tuple[str, ...]
    text: str = ""

    @property
    def star_count(self) -> int:
        """Stars used."""
        return int(self.solution.members.sum()) if self.valid else 0

    @property
    def rejected_count(self) -> int:
        """Stars refused, here or before."""
        return len(self.refused)

    @property
    def valid(self) -> bool:
        """Whether there is an attitude."""
        return self.solution.status is not SolutionStatus.INVALID


@dataclass
class StarOutcome:
    """What one input led to.

    Attributes:
        refusal: why this very input was not used; None where it was, or still waits.
        solved: solutions to publish, in order.
        not_joined: exposures (source, stamp) that came too late for the joint solution of their time.
    """

    refusal: Refusal | None = None
    solved: list[Solved] = field(default_factory=list)
    not_joined: list[tuple[str, int]] = field(default_factory=list)
