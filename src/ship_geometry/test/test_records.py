"""A class made by ``records.dataclass`` does what the standard library's does."""

import copy
import dataclasses
import pickle
from dataclasses import field
from typing import Any

import pytest

from ship_geometry import records


def _classes(dataclass: Any) -> dict[str, Any]:
    @dataclass(frozen=True)
    class Base:
        """A base."""

        first: int
        second: float = 2.0
        told: list[int] = field(default_factory=lambda: [1], repr=False)

    @dataclass(frozen=True)
    class Derived(Base):
        """Derived, with a default changed and a field that is worked out."""

        second: float = 3.0
        twice: float = field(init=False, compare=False, default=0.0)

        def __post_init__(self) -> None:
            object.__setattr__(self, "twice", 2.0 * self.second)

    @dataclass(frozen=True, kw_only=True)
    class Named:
        """Given by name."""

        value: int = field(metadata={"unit": "m"})
        made: dict[str, int] = field(default_factory=dict, init=False)

    @dataclass
    class Changing:
        """Not frozen, thus without a hash."""

        value: int

    @dataclass(frozen=True, eq=False)
    class Itself:
        """Equal to nothing but itself."""

        value: int

    return {"Base": Base, "Derived": Derived, "Named": Named, "Changing": Changing, "Itself": Itself}


OURS, THEIRS = _classes(records.dataclass), _classes(dataclasses.dataclass)


@records.dataclass(frozen=True)
class Stored:
    """One that pickle finds."""

    value: int


def _result(call: Any) -> Any:
    try:
        return call()
    except (TypeError, dataclasses.FrozenInstanceError, AttributeError) as error:
        return type(error)


@pytest.mark.parametrize(
    "use",
    [
        lambda made: repr(made["Base"](1)),
        lambda made: repr(made["Base"](1, told=[2])),
        lambda made: made["Base"](1, 5.0).second,
        lambda made: made["Base"](1).told,
        lambda made: made["Base"](1).told is made["Base"](1).told,
        lambda made: made["Base"](),
        lambda made: made["Base"](1, third=3),
        lambda made: made["Base"](1) == made["Base"](1),
        lambda made: made["Base"](1) == made["Base"](2),
        lambda made: made["Base"](1) == made["Derived"](1, 2.0),
        lambda made: made["Base"](1) != made["Base"](1),
        lambda made: hash(made["Base"](1)),
        lambda made: hash(made["Named"](value=1)),
        lambda made: setattr(made["Base"](1), "first", 2),
        lambda made: setattr(made["Base"](1), "unknown", 2),
        lambda made: delattr(made["Base"](1), "first"),
        lambda made: repr(made["Derived"](1)),
        lambda made: made["Derived"](1, 4.0).twice,
        lambda made: dataclasses.replace(made["Derived"](1), second=7.0).twice,
        lambda made: dataclasses.asdict(made["Derived"](1)),
        lambda made: [one.name for one in dataclasses.fields(made["Derived"])],
        lambda made: made["Derived"].__match_args__,
        lambda made: made["Named"](1),
        lambda made: repr(made["Named"](value=1)),
        lambda made: dict(dataclasses.fields(made["Named"])[0].metadata),
        lambda made: repr(made["Changing"](1)),
        lambda made: setattr(made["Changing"](1), "value", 2),
        lambda made: hash(made["Changing"](1)),
        lambda made: made["Itself"](1) == made["Itself"](1),
        lambda made: len({made["Itself"](1), made["Itself"](1)}),
    ],
)
def test_is_what_the_standard_library_makes(use: Any) -> None:
    assert _result(lambda: use(OURS)) == _result(lambda: use(THEIRS))


def test_equal_ones_have_one_hash() -> None:
    assert len({Stored(1), Stored(1), Stored(2)}) == 2


def test_is_copied_and_pickled() -> None:
    one = Stored(1)
    assert copy.deepcopy(one) == one
    assert pickle.loads(pickle.dumps(one)) == one


def test_a_class_derived_from_one_without_fields_of_its_own_is_made_before_and_after_its_base() -> None:
    class Plain(OURS["Named"]):  # type: ignore[misc]
        pass

    assert Plain(value=1).value == 1
    assert OURS["Named"](value=2).value == 2
    assert Plain(value=3).value == 3
