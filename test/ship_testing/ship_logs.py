"""Lines of a real ship's logs, and hand-made sentences."""

import functools
import operator

SEAP = """\
2014-08-01T00:00:00.814000Z $GPZDA,000000.70,01,08,2014,,*6F
2014-08-01T00:00:00.814000Z $GPGGA,000000.70,2200.112071,S,01756.360200,W,1,10,0.9,1.04,M,,M,,*41
2014-08-01T00:00:00.931000Z $GPHDT,218.83,T*05
2014-08-01T00:00:00.931000Z $PSXN,20,1,0,0,0*3A
2014-08-01T00:00:00.951000Z $PSXN,23,0.58,-1.09,218.83,0.78*1F
"""

MWX1 = """\
2014-08-01T00:00:00.274000Z MET,12.1,22,19.07,63.9,7.477909,-0.0766031,-0.4043191,295.1065,294.2919,1023.328
2014-08-01T00:00:00.761000Z SUS,A,325,009.31,M,+344.00,+020.63,60,03
"""

GYR1 = "2014-08-01T00:00:00.183000Z $HEHDT,218.53,T*12\n"


def sentence(body: str) -> str:
    """Return a sentence with its checksum, from the text between ``$`` and ``*``."""
    return f"${body}*{functools.reduce(operator.xor, body.encode(), 0):02X}"
