"""[Z14] (8)-(38): the paper's closed-form factors as printed, and their exact values from our exact Jacobian.

The factors are elements of the ship's rotation R = R(As, Es, γs) R(A0, E0, γ0), in the paper's reading, and derivatives
of these elements. Heading K = atan2(N_K, D_K) with N_K = R31, D_K = R11; pitch asin(S) with S = R21; roll
atan2(N_θ, D_θ) with N_θ = -R23, D_θ = R22. Angles are (As, Es, γs, A0, E0, γ0), shape (..., 6), rad.
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from ship_geometry.frames import rotation_from_angles, rotation_vector_from_angle_errors
from ship_geometry.rotations import FloatArray, skew
from ship_studies.layout.installation_model import InstallationConvention, linearise, ship_rotation

ANGLES = ("As", "Es", "γs", "A0", "E0", "γ0")

# Row, column and sign of each element in R.
_ELEMENTS = {"N_K": (2, 0, 1.0), "D_K": (0, 0, 1.0), "S": (1, 0, 1.0), "N_θ": (1, 2, -1.0), "D_θ": (1, 1, 1.0)}


@dataclass(frozen=True)
class Factor:
    """One of the paper's factors.

    Attributes:
        number: number of the equation.
        symbol: symbol in the paper.
        sign: sign of ``element`` or of its derivative in the factor.
        element: name of the element.
        by: angle with respect to which ``element`` is differentiated; empty for the element itself.
        printed: the factor as printed; None if the factor is missing in our text of the paper.
        remark: remark about the print.
    """

    number: int
    symbol: str
    sign: float
    element: str
    by: str
    printed: Callable[[FloatArray], FloatArray] | None
    remark: str = ""

    @property
    def meaning(self) -> str:
        """Return the exact factor, in symbols."""
        sign = "−" if self.sign < 0.0 else ""
        return f"{sign}∂{self.element}/∂{self.by}" if self.by else f"{sign}{self.element}"

    def exact(self, angles: FloatArray) -> FloatArray:
        """Return the exact value of the factor by our model, shape (...)."""
        row, column, sign = _ELEMENTS[self.element]
        rotation = rotation_by(angles, self.by) if self.by else _rotation(angles)
        value: FloatArray = self.sign * sign * rotation[..., row, column]
        return value


def _rotation(angles: FloatArray) -> FloatArray:
    return ship_rotation(angles[..., :3], angles[..., 3:], InstallationConvention.PAPER)


def rotation_by(angles: FloatArray, by: str) -> FloatArray:
    """Return the derivative of the ship's rotation with respect to an angle, shape (..., 3, 3)."""
    column = ANGLES.index(by)
    first = rotation_from_angles(*np.moveaxis(angles[..., :3], -1, 0))
    second = rotation_from_angles(*np.moveaxis(angles[..., 3:], -1, 0))
    turned = angles[..., :3] if column < 3 else angles[..., 3:]
    vectors = rotation_vector_from_angle_errors(turned[..., 0], turned[..., 1])[..., column % 3]
    derivative: FloatArray = (
        skew(vectors) @ first @ second if column < 3 else first @ skew(vectors) @ second
    )
    return derivative


def _printed_formula(formula: str) -> Callable[[FloatArray], FloatArray]:
    """Return a function for a formula in the paper's letters: CA is cos As, Ca cos A0, SE sin Es, Sg sin γ0."""
    code = compile(formula, "factor", "eval")

    def value(angles: FloatArray) -> FloatArray:
        names = ("A", "E", "G", "a", "e", "g")
        known = {f"S{name}": np.sin(angles[..., i]) for i, name in enumerate(names)}
        known |= {f"C{name}": np.cos(angles[..., i]) for i, name in enumerate(names)}
        result: FloatArray = eval(code, {"__builtins__": {}}, known)
        return result

    return value


SUBSCRIPTS = "subscripts restored"
_LOST = "missing"

_N_K = "Ca*Ce*SA*CE + Se*(CA*SG - SA*SE*CG) + Sa*Ce*(CA*CG + SA*SE*SG)"
_D_K = "-Ca*Ce*CA*CE + Se*(SA*SG + CA*SE*CG) + Sa*Ce*(SA*CG - CA*SE*SG)"
_D_ROLL = "CE*SG*(Ca*Sg - Sa*Se*Cg) + SE*(Sa*Sg + Ca*Se*Cg) - CE*CG*Ce*Cg"
_N_ROLL = "CE*SG*(Ca*Cg + Sa*Se*Sg) + SE*(Sa*Cg - Ca*Se*Sg) + CE*CG*Ce*Sg"

FACTORS = (
    Factor(8, "ks1", -1.0, "N_K", "Es", _printed_formula("Ca*Ce*SA*SE + Se*SA*CE*CG - Sa*Ce*SA*CE*SG")),
    Factor(9, "ks2", -1.0, "D_K", "", _printed_formula(_D_K)),
    Factor(10, "ks3", -1.0, "D_K", "Es", _printed_formula("Ca*Ce*CA*SE + Se*CA*CE*CG - Sa*Ce*CA*CE*SG")),
    Factor(11, "ks4", 1.0, "N_K", "", _printed_formula(_N_K)),
    Factor(
        12, "ks5", 1.0, "N_K", "",
        _printed_formula("Ca*Ce*SA*CE + Se*(CA*SG - CA*SE*CG) + Sa*Ce*(CA*CG + SA*SE*SG)"),
        "printed with cos As instead of sin As in the second term; corrected, it equals (11)",
    ),
    Factor(13, "ks6", 1.0, "N_K", "γs", _printed_formula("Se*(CA*CG + SA*SE*SG) - Sa*Ce*(CA*SG - SA*SE*CG)")),
    Factor(14, "ks7", -1.0, "D_K", "γs", _printed_formula("Se*(SA*CG - CA*SE*SG) - Sa*Ce*(SA*SG + CA*SE*CG)")),
    Factor(15, "fs1", 1.0, "S", "Es", _printed_formula("Ca*Ce*CE - Se*SE*CG + Sa*Ce*SE*SG"), SUBSCRIPTS),
    Factor(16, "fs2", 1.0, "S", "", None, _LOST),
    Factor(17, "fs3", 1.0, "S", "γs", None, _LOST),
    Factor(
        18, "ts1", -1.0, "N_θ", "Es",
        _printed_formula("SE*SG*(Ca*Cg + Sa*Se*Sg) - CE*(Sa*Cg - Ca*Se*Sg) + SE*CG*Ce*Sg"), SUBSCRIPTS,
    ),
    Factor(19, "ts2", -1.0, "D_θ", "", _printed_formula(_D_ROLL)),
    Factor(20, "ts3", 1.0, "N_θ", "", _printed_formula(_N_ROLL)),
    Factor(
        21, "ts4", -1.0, "D_θ", "Es",
        _printed_formula("-SE*SG*(Ca*Sg - Sa*Se*Cg) + CE*(Sa*Sg + Ca*Se*Cg) + SE*CG*Ce*Cg"), SUBSCRIPTS,
    ),
    Factor(22, "ts5", 1.0, "N_θ", "γs", _printed_formula("CE*CG*(Ca*Cg + Sa*Se*Sg) - CE*SG*Ce*Sg"), SUBSCRIPTS),
    Factor(23, "ts6", -1.0, "D_θ", "γs", None, _LOST),
    Factor(24, "kb1", 1.0, "N_K", "A0", _printed_formula("Ca*Ce*(CA*CG + SA*SE*SG) - Sa*Ce*SA*CE")),
    Factor(25, "kb2", -1.0, "D_K", "", _printed_formula(_D_K)),
    Factor(26, "kb3", -1.0, "D_K", "A0", _printed_formula("Ca*Ce*(SA*CG - CA*SE*SG) + Sa*Ce*CA*CE")),
    Factor(27, "kb4", 1.0, "N_K", "", _printed_formula(_N_K)),
    Factor(
        28, "kb5", -1.0, "N_K", "E0", _printed_formula("Ca*Se*SA*CE + Sa*Se*(CA*CG + SA*SE*SG) - Ce*(CA*SG - SA*SE*CG)")
    ),
    Factor(
        29, "kb6", -1.0, "D_K", "E0",
        _printed_formula("Ca*Se*CA*CE + Ce*(SA*SG + CA*SE*CG) - Sa*Se*(SA*CG - CA*SE*SG)"),
        "exact without an unclosed bracket in our text",
    ),
    Factor(30, "fb1", -1.0, "S", "A0", _printed_formula("Ca*Ce*CE*SG + Sa*Ce*SE"), "must be subtracted in (6)"),
    Factor(31, "fb2", 1.0, "S", "", _printed_formula("Ca*Ce*SE + Se*CE*CG - Sa*Ce*CE*SG")),
    Factor(32, "fb3", 1.0, "S", "E0", _printed_formula("-Ca*Se*SE + Ce*CE*CG + Sa*Se*CE*SG")),
    Factor(33, "tb1", 1.0, "N_θ", "A0", _printed_formula("SE*(Ca*Cg + Sa*Se*Sg) - CE*SG*(Sa*Cg - Ca*Se*Sg)")),
    Factor(34, "tb2", -1.0, "D_θ", "", _printed_formula(_D_ROLL)),
    Factor(35, "tb3", -1.0, "D_θ", "A0", _printed_formula("SE*(Ca*Sg - Sa*Se*Cg) - CE*SG*(Sa*Sg + Ca*Se*Cg)")),
    Factor(36, "tb4", 1.0, "N_θ", "", _printed_formula(_N_ROLL)),
    Factor(37, "tb5", -1.0, "N_θ", "E0", _printed_formula("SE*Ca*Ce*Sg + CE*CG*Se*Sg - CE*SG*Sa*Ce*Sg")),
    Factor(38, "tb6", -1.0, "D_θ", "E0", _printed_formula("SE*Ca*Ce*Cg + CE*CG*Se*Cg - CE*SG*Sa*Ce*Cg")),
)  # fmt: skip
"""Every factor of the paper, in the letters of :func:`_printed_formula`. Lost subscripts and an unclosed bracket are
repaired; other misprints are kept."""


def random_attitudes(count: int, seed: int = 14) -> FloatArray:
    """Return random angles of a sensor and of its installation, with elevations within 80°, shape (count, 6)."""
    degrees = np.array([180.0, 80.0, 180.0])
    return np.deg2rad(np.random.default_rng(seed).uniform(-1.0, 1.0, (count, 6)) * np.tile(degrees, 2))


def largest_difference(factor: Factor, angles: FloatArray) -> float:
    """Return the largest difference between printed and exact value; NaN if the print is missing."""
    if factor.printed is None:
        return float("nan")
    return float(np.max(np.abs(factor.printed(angles) - factor.exact(angles))))


def jacobian_of_factors(angles: FloatArray) -> FloatArray:
    """Return the Jacobian of heading, pitch, roll by [Z14] (5)-(7) from the printed factors, shape (..., 3, 6).

    The three missing factors are replaced by exact factors. The missing parts of (5)-(7) in the scan are restored.
    """
    f = {factor.symbol: (factor.printed or factor.exact)(angles) for factor in FACTORS}
    none, one = np.zeros(angles.shape[:-1]), np.ones(angles.shape[:-1])
    of_k = f["ks2"] ** 2 + f["ks4"] ** 2
    heading = [
        one,
        (f["ks1"] * f["ks2"] + f["ks3"] * f["ks4"]) / of_k,
        -(f["ks6"] * f["ks2"] - f["ks4"] * f["ks7"]) / of_k,
        -(f["kb1"] * f["kb2"] - f["kb3"] * f["kb4"]) / of_k,
        (f["kb5"] * f["kb2"] + f["kb4"] * f["kb6"]) / of_k,
        none,
    ]
    cosine = np.sqrt(1.0 - f["fb2"] ** 2)
    pitch = [none, f["fs1"] / cosine, f["fs3"] / cosine, -f["fb1"] / cosine, f["fb3"] / cosine, none]
    of_roll = f["ts2"] ** 2 + f["ts3"] ** 2
    roll = [
        none,
        (f["ts1"] * f["ts2"] + f["ts3"] * f["ts4"]) / of_roll,
        -(f["ts5"] * f["ts2"] - f["ts3"] * f["ts6"]) / of_roll,
        -(f["tb1"] * f["tb2"] - f["tb3"] * f["tb4"]) / of_roll,
        (f["tb5"] * f["tb2"] + f["tb4"] * f["tb6"]) / of_roll,
        one,
    ]
    return np.stack([np.stack(angle, axis=-1) for angle in (heading, pitch, roll)], axis=-2)


def exact_jacobian(angles: FloatArray, reading: InstallationConvention) -> FloatArray:
    """Return the Jacobian from the model of the layout study, shape (..., 3, 6); NaN at a pitch of the ship of 90°."""
    model = linearise(angles[..., :3], angles[..., 3:], reading)
    return np.concatenate([model.star, model.installation], axis=-1)
