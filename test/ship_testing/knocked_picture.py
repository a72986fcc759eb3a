"""Pictures made by hand: an officer sees a knocked star sensor."""

import dataclasses
import math

from ship_watch.picture import (
    ANGLES,
    AlertShown,
    AngleShown,
    Event,
    InputShown,
    NisVerdict,
    Picture,
    Presence,
    Priority,
    Safety,
    SourceShown,
)

ARCSEC = math.pi / 648000
NOON_NS = 1_777_636_807_000_000_000  # 2026-05-01 12:00:07
# The screen of design: value in degrees, 95 % and limit in arcsec, word, reason.
ANGLES_SHOWN = {
    "heading": (34.392, 4.2, 5.0, Safety.CAUTION, "one star source"),
    "pitch": (-0.12, 2.8, 3.0, Safety.SAFE, ""),
    "roll": (-2.1, 3.7, 3.0, Safety.CAUTION, "over the limit"),
    "azimuth": (359.88, 4.9, 10.0, Safety.SAFE, ""),
    "elevation": (68.74, 5.3, 10.0, Safety.SAFE, ""),
}


def angle(name, **changed):
    degrees, accuracy, limit, safety, reason = ANGLES_SHOWN[name]
    value, accuracy_95, limit = math.radians(degrees), accuracy * ARCSEC, limit * ARCSEC
    shown = AngleShown(name, value, accuracy_95, limit, math.nan, safety, reason, 0.1, False, NOON_NS, NOON_NS)
    return dataclasses.replace(shown, **changed)


def source(name, **changed):
    shown = SourceShown(name, Presence.IN, "", "", math.nan, None, 0.1, 20.0, 0, 0, ())
    return dataclasses.replace(shown, **changed)


KNOCKED = source(
    "star.starboard",
    presence=Presence.OUT,
    reason="81 refused in a row",
    disagreement="right +49″",
    residual=8.1,
    age_s=0.6,
    rate_hz=2.0,
    refused=81,
    out_since_ns=NOON_NS,
    topics=("star/starboard/observations",),
)
FORE = source("star.fore", verdict=NisVerdict(1.01, 200, "σ as stated (1.01)", is_as_stated=True))
OTHERS = tuple(map(source, ("ins", "lights", "encoder", "baselines", "gnss", "weather")))
WARNING = AlertShown(
    "star.starboard.out",
    2,
    Priority.WARNING,
    1,
    "star.starboard",
    "star.starboard out",
    8.1,
    5.0,
    "σ",
    NOON_NS,
    NOON_NS,
)
INPUT = InputShown("star/starboard/observations", 2.0, 0.1, 0.6, 1, 81, {"gate": 9, "attitude_conflict": 72})
EVENTS = (
    Event(NOON_NS, "state", "roll", "roll SAFE → CAUTION, over the limit"),
    Event(NOON_NS, "alert", "star.starboard.out", "WARNING star.starboard out: 5 refused in a row, residual 8.1 σ"),
)


def picture(**changed):
    fields = {
        "utc_ns": NOON_NS,
        "angles": tuple(map(angle, ANGLES)),
        "ages_s": {"stars": 0.5, "lights": 0.6, "ins": 0.1},
        "pointing_by": "2 lights",
        "horizon": "geodetic",
        "sources": (KNOCKED, FORE, *OTHERS),
        "alerts": (WARNING,),
        "inputs": (INPUT,),
        "events": EVENTS,
        "waiting_for": "",
    }
    return Picture(**fields | changed)
