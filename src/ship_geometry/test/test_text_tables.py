"""Numbers of text tables are those of Python's float, to the last bit; other texts are refused."""

from pathlib import Path

import numpy as np
import pytest

from ship_geometry.text_tables import numbers, read_lines


def lines_of(texts: list[str]) -> np.ndarray:
    width = max(map(len, texts))
    return np.array([list(text.rjust(width).encode()) for text in texts], dtype=np.uint8)


@pytest.mark.parametrize(
    "texts",
    [
        [" 1.25", "-0.50", "99.99", "-0.00"],
        ["  1.5", " -2.5", "123.5"],
        ["1.", "2."],
        [".25", ".50"],
        ["   7", "-118"],
        ["0.0190068680", "0.3403189126"],
        ["1.25", " 2.5", "3.5  ", "-4   "],
        [".2", "-2"],
        ["1e3", " 25"],
        ["+1.5", " 2.5"],
        ["nan", "inf"],
        ["1234567890.123456", "0.000000000000001", "999999999999999"],
    ],
)
def test_numbers_are_those_of_float_to_the_last_bit(texts: list[str]) -> None:
    lines = lines_of(texts)
    found = numbers(lines, (1, lines.shape[1]))[0]
    assert found.tobytes() == np.array([float(text) for text in texts]).tobytes()


def test_random_numbers_are_those_of_float_to_the_last_bit() -> None:
    rng = np.random.default_rng(4)
    texts = [
        f"{value:.{places}f}"
        for value, places in zip(rng.normal(scale=1e4, size=5000), rng.integers(0, 10, 5000), strict=True)
    ]
    lines = lines_of(texts)
    assert numbers(lines, (1, lines.shape[1]))[0].tolist() == [float(text) for text in texts]


def test_blank_is_nan() -> None:
    assert np.isnan(numbers(lines_of(["    ", "1.25"]), (1, 4))[0]).tolist() == [True, False]


@pytest.mark.parametrize("text", ["1 25", "1.2.3", "-", ".", "1-2", "--1", "- 1"])
def test_text_that_float_refuses_is_refused(text: str) -> None:
    with pytest.raises(ValueError, match="could not convert"):
        numbers(lines_of(["1.5", text]), (1, max(3, len(text))))


@pytest.mark.parametrize("columns", [(0, 2), (2, 1), (1, 4)])
def test_columns_that_the_lines_do_not_have_are_refused(columns: tuple[int, int]) -> None:
    with pytest.raises(ValueError, match="do not fit together"):
        numbers(lines_of(["1.5"]), columns)


def test_lines_are_equally_long(tmp_path: Path) -> None:
    path = tmp_path / "table.dat"
    path.write_bytes(b"1.5\n2.5\n")
    assert read_lines(path, 4).shape == (2, 4)
    for content in (b"", b"1.5\n2.5", b"12345678"):
        path.write_bytes(content)
        with pytest.raises(ValueError, match="lines of 3 characters"):
            read_lines(path, 4)
