"""Recordings with malicious names: in the pages of ``compare`` and ``report`` no code runs, and all names are shown."""

import contextlib

import numpy as np
import pytest

from ship_bags.mcap.bag_writer import BagWriter
from ship_bags.stamps import make_header
from ship_geometry.rotations import ARCSEC
from ship_replay.commands.compare import main as compare
from ship_replay.commands.report import main as report
from ship_testing.browser import CHROMIUM, Browser
from ship_testing.hand_made_bags import FACTORY, START_NS, innovation, ship_attitude

SECOND_NS = 1_000_000_000
NAMES = {
    "markup": "</script></style></svg><img src=x onerror=window.hit=1><svg onload=window.hit=1>",
    "entity": "&lt;img src=x onerror=window.hit=1&gt; \"onclick='window.hit=1'",
    "formula": r"a $x^{$ $$y$$ {{7*7}} {% raw %} javascript:window.hit=1 b",
}


def write_hostile(path, name, offset_rad, units="rad"):
    """Write twenty seconds of outputs with the name wherever a recording has a name or a text."""
    with BagWriter(path) as bag:
        bag.add_attachment("scenario.yaml", f"# {name}\nname: {offset_rad}\n")
        bag.add_metadata(name, {name: f"{name} {offset_rad}"})
        for tick in range(200):
            stamp_ns = START_NS + tick * SECOND_NS // 10
            header = make_header(FACTORY, stamp_ns, name)
            bag.write("ship/attitude", ship_attitude(stamp_ns, offset_rad), stamp_ns)
            if tick % 10:
                continue
            message = innovation(
                stamp_ns, name, [ARCSEC, 0.0], [ARCSEC] * 2, 1.0, components=(f"{name} right", f"{name} up")
            )
            bag.write("ship/innovation", message, stamp_ns)
            rejected = innovation(stamp_ns, f"{name} 2", [], [], np.nan, accepted=False, reason=1, components=())
            rejected.reason_text = name
            bag.write("ship/innovation", rejected, stamp_ns)
            bag.write(
                "ship/error_budget",
                FACTORY.make(
                    "ship_msgs/msg/ErrorBudget",
                    header=header,
                    quantity=name,
                    sources=[name, "ins"],
                    covariances=np.tile(np.eye(3).ravel(), 2) * ARCSEC**2,
                    total=2.0 * np.eye(3).ravel() * ARCSEC**2,
                ),
                stamp_ns,
            )
            bag.write(
                "ship/alignment",
                FACTORY.make(
                    "ship_msgs/msg/AlignmentState",
                    header=header,
                    names=[name],
                    values=np.array([offset_rad]),
                    covariance=np.array([ARCSEC**2]),
                    units=[units],
                ),
                stamp_ns,
            )
            alert = FACTORY.make(
                "ship_msgs/msg/Alert",
                id=f"{name} {offset_rad}",
                instance=1,
                priority=1,
                state=1,
                source=name,
                text=name,
                value=1.0,
                limit=1.0,
                unit=name,
                raised=header.stamp,
                changed=header.stamp,
            )
            bag.write("ship/alerts", FACTORY.make("ship_msgs/msg/AlertArray", header=header, alerts=[alert]), stamp_ns)
            bag.write(
                "input_health",
                FACTORY.make(
                    "ship_msgs/msg/InputHealth",
                    header=header,
                    topic=name,
                    received=1,
                    accepted=0,
                    rejected=1,
                    rate_hz=1.0,
                    latency_s=0.1,
                    age_s=0.1,
                    level=2,
                    reasons=[name],
                    reason_counts=np.array([1], np.uint64),
                ),
                stamp_ns,
            )
    return path


def view_page(page, name):
    """Return the text of a page in a browser; assert that no code runs and that nothing else is requested."""
    with contextlib.closing(Browser()) as browser:
        browser.open(page.as_uri())
        assert browser.problems == []
        assert set(browser.addresses) == {page.as_uri()}
        assert browser.evaluate("window.hit") is None
        assert browser.evaluate("document.images.length + document.scripts.length") == 0
        assert browser.evaluate("[...document.querySelectorAll('*')].flatMap((each) => each.getAttributeNames())"
                                ".filter((each) => each.startsWith('on'))") == []  # fmt: skip
        text = browser.evaluate("document.documentElement.textContent")
    assert text.count(name) >= 5
    return text


@pytest.mark.skipif(CHROMIUM is None, reason="there is no Chromium here")
@pytest.mark.parametrize("kind", NAMES)
def test_nothing_of_a_name_runs_in_the_pages(kind, tmp_path, capsys):
    name = NAMES[kind]
    a = write_hostile(tmp_path / "a<img src=x onerror=hit=1>$x^{$.mcap", name, ARCSEC)
    b = write_hostile(tmp_path / "b.mcap", name, 2 * ARCSEC, units=name)
    assert compare([str(a), str(b), "--out", str(tmp_path / "compare.html")]) == 0, capsys.readouterr().err
    assert report([str(a), "--out", str(tmp_path / "report.html")]) == 0, capsys.readouterr().err
    for page in ("compare.html", "report.html"):
        view_page(tmp_path / page, name)
