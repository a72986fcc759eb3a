"""Stars minus INS alongside, as Fig. 4 of Pan et al. (2015): draws docs/figures/mooring.png.

Simulates the scenario mooring and replays it, or uses a given bag and its replayed outputs. For each VALID joint
solution, computes heading, pitch and roll minus those of ins/imu, interpolated to its stamp. Prints mean and standard
deviation of each difference in arcsec. If the bag has the truth, truth minus INS is drawn too.
"""

import argparse
import sys
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import matplotlib

matplotlib.use("Agg")

import matplotlib.pyplot as plt
import numpy as np

from ship_attitude_star.adapters.star_attitude_adapter import StarAttitudeAdapter
from ship_attitude_star.ship_attitude.config import ShipAttitudeConfig
from ship_bags.command_line import EXIT_DONE, CommandParser, run_command
from ship_bags.errors import BadInput
from ship_bags.mcap.bag_reader import Bag, read_bag
from ship_bags.mcap.bag_writer import SUITE_ATTACHMENT
from ship_bags.stamps import NS_PER_S, ns_from_stamp
from ship_bags.topic_names import relative_topics
from ship_geometry.earth.time_scales import utc_text
from ship_geometry.frames import angles_from_rotation
from ship_geometry.rotations import ARCSEC, FloatArray, wrap_pi
from ship_replay.evaluation.evaluate import named_config
from ship_replay.evaluation.sources import JOINT_SOLUTION, InsAttitude, Truth
from ship_replay.offline.replay import replay
from ship_stars.attitude_from_stars.solution import SolutionStatus
from ship_testing.trials.fault_voyage import make_bag
from ship_watch.orientations import SHIP_ATTITUDE

ROOT = Path(__file__).resolve().parents[1]
SCENARIO = ROOT / "bags" / "scenarios" / "mooring.yaml"
FIGURE = ROOT / "docs" / "figures" / "mooring.png"
LENGTH_S = 1800.0
_INS = "ins/imu"
_STARS, _TRUE = "#1b4f72", "#f5b041"


@dataclass(frozen=True)
class Differences:
    """Stars minus INS.

    Attributes:
        start_ns: first stamp, ns.
        time_s: time since the first stamp, shape (n,).
        arcsec: heading, pitch, roll by the stars minus the INS's values, shape (n, 3).
        sigma_arcsec: sigma of the attitude by the stars, shape (n, 3).
        true_arcsec: truth minus INS at the same stamps, shape (n, 3); NaN without truth.
    """

    start_ns: int
    time_s: FloatArray
    arcsec: FloatArray
    sigma_arcsec: FloatArray
    true_arcsec: FloatArray


def main(arguments: list[str] | None = None) -> int:
    """Draw the figure."""
    first, _, *others = __doc__.splitlines()
    parser = CommandParser(
        prog="mooring",
        description=first,
        epilog=" ".join(others),
        example="python tools/mooring.py --bag night.mcap --replayed replayed.mcap --figure night.png",
    )
    parser.add_argument("--bag", type=Path, help="bag with ins/imu (a simulation of the scenario)")
    parser.add_argument("--replayed", type=Path, help="bag with star/joint/solution (--bag is replayed)")
    parser.add_argument("--length-s", type=float, default=LENGTH_S, help="length of the scenario's voyage, s (1800)")
    parser.add_argument("--seed", type=int, default=1, help="seed of the scenario's voyage (1)")
    parser.add_argument("--out", type=Path, default=ROOT / "out" / "mooring", help="folder of the bags")
    parser.add_argument("--figure", type=Path, default=FIGURE, help="PNG to draw (docs/figures/mooring.png)")
    return run_command(parser, _run, arguments)


def _run(options: argparse.Namespace) -> int:
    name = f"{options.length_s:g}s_{options.seed}.mcap"
    bag = options.bag or make_bag(SCENARIO, options.length_s, options.seed, options.out / f"in_{name}")
    replayed = options.replayed
    if replayed is None:
        replayed = options.out / f"out_{bag.stem}.mcap"
        replayed.parent.mkdir(parents=True, exist_ok=True)
        replay(bag, replayed, [StarAttitudeAdapter])
    found = stars_minus_ins(bag, replayed)
    print(f"mooring: {len(found.time_s)} joint solutions in {found.time_s[-1]:.0f} s, stars minus INS [arcsec]")
    for column, angle in enumerate(SHIP_ATTITUDE.angles):
        of_stars = found.arcsec[:, column]
        noise = of_stars - found.true_arcsec[:, column]
        print(
            f"  {angle:8s} mean {np.mean(of_stars):+7.2f}  standard deviation {np.std(of_stars):6.2f}  "
            f"sigma of the stars {np.mean(found.sigma_arcsec[:, column]):5.2f}  "
            f"stars minus truth: mean {np.mean(noise):+6.2f}, standard deviation {np.std(noise):5.2f}"
        )
    draw(found, options.figure)
    return EXIT_DONE


def stars_minus_ins(bag_path: Path, replayed_path: Path) -> Differences:
    """Return attitudes by the stars in the replayed bag minus INS attitudes in the other bag.

    Raises:
        BadInput: the bag has no suite file with a section for ship_attitude, or no VALID joint solution has an INS
            attitude at its time.
    """
    truth = Truth(SHIP_ATTITUDE)
    with read_bag(bag_path) as bag:
        ins = InsAttitude(truth, _config(bag).ins)
        for message in _messages(bag, SHIP_ATTITUDE.truth_topic):
            truth.add(message)
        for message in _messages(bag, _INS):
            ins.add_message(message)
    rows = []
    with read_bag(replayed_path) as bag:
        for message in _messages(bag, JOINT_SOLUTION):
            time_ns = ns_from_stamp(message.header.stamp)
            by_ins = ins.track.at(time_ns)
            if message.status != SolutionStatus.VALID or by_ins is None:
                continue
            ins_angles = angles_from_rotation(by_ins.rotation_nd)
            by_stars = np.array([message.azimuth, message.elevation, message.roll])
            sigma = np.sqrt(np.diagonal(np.asarray(message.covariance).reshape(3, 3)))
            true_nd = truth.interpolated_rotation(time_ns)
            true = np.full(3, np.nan) if true_nd is None else wrap_pi(angles_from_rotation(true_nd) - ins_angles)
            rows.append((time_ns, wrap_pi(by_stars - ins_angles), sigma, true))
    if not rows:
        raise BadInput(f"{replayed_path}: {JOINT_SOLUTION}: no VALID solution within the times of {_INS} in {bag_path}")
    time_ns = np.array([row[0] for row in rows])
    arcsec = [np.array([row[column] for row in rows]) / ARCSEC for column in (1, 2, 3)]
    return Differences(int(time_ns[0]), (time_ns - time_ns[0]) / NS_PER_S, *arcsec)


def _config(bag: Bag) -> ShipAttitudeConfig:
    text = bag.attachments.get(SUITE_ATTACHMENT, b"").decode("utf-8", errors="replace")
    config = named_config(text, ShipAttitudeConfig, "ship_attitude") if text else None
    if config is None:
        raise BadInput(f"{bag.path}: no suite file with a section for ship_attitude is attached")
    return config


def _messages(bag: Bag, topic: str) -> list[Any]:
    names = {name for known, name in relative_topics(bag.topics, "").items() if known == topic}
    return [record.decode() for record in bag.records(names)] if names else []


def draw(found: Differences, path: Path) -> None:
    """Draw three panels, one for each angle, over minutes."""
    style = {"font.size": 11, "axes.spines.top": False, "axes.spines.right": False, "savefig.facecolor": "white"}
    with plt.rc_context(style):
        figure, panels = plt.subplots(3, 1, figsize=(9.5, 7.5), sharex=True, layout="constrained")
        minutes = found.time_s / 60.0
        for column, (axes, angle) in enumerate(zip(panels, SHIP_ATTITUDE.angles, strict=True)):
            if np.isfinite(found.true_arcsec).any():
                axes.plot(minutes, found.true_arcsec[:, column], color=_TRUE, lw=2.4, label="truth − INS")
            axes.plot(minutes, found.arcsec[:, column], color=_STARS, lw=0.6, label="stars − INS")
            mean, spread = np.mean(found.arcsec[:, column]), np.std(found.arcsec[:, column])
            axes.axhline(mean, color="0.5", lw=0.8, ls=":")
            axes.set_title(f"{angle}: mean {mean:+.1f}″, standard deviation {spread:.1f}″", loc="left", fontsize=11)
            axes.set_ylabel("arcsec")
            axes.grid(alpha=0.25)
        panels[0].legend(loc="lower right", bbox_to_anchor=(1.0, 1.0), ncols=2, frameon=False, borderaxespad=0.2)
        panels[-1].set_xlabel(f"minutes after {utc_text(found.start_ns)}")
        figure.savefig(path, dpi=110, metadata={"Software": None})
        plt.close(figure)


if __name__ == "__main__":
    sys.exit(main())
