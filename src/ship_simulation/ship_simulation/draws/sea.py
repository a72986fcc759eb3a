"""A sea state as a wave spectrum, and the ship's response to the sea as a sum of sinusoids.

The wave elevation has the two-parameter spectrum of Bretschneider (1959), which ITTC (15th conference, 1978;
Recommended Procedure 7.5-02-07-01.1) recommends for the open ocean:

    S(w) = 5/16 Hs² wp⁴ / w⁵ exp(-5/4 (wp / w)⁴)

Hs is the significant wave height, w the angular frequency, and wp its modal value. Sea state 5 of STANAG 4194 has Hs of
2.5 m to 4 m, mean 3.25 m, and a modal period of 9.7 s in the North Atlantic.

The response of each angle is a damped resonance, excited by the wave slope averaged over the hull, at zero speed:

    angle / elevation = direction factor * gain * k * sinc(k L / 2) / (1 - (w / wn)² + 2 i z w / wn),  k = w² / g

L is the length of hull that averages the slope, wn the natural frequency, and z the damping ratio.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ship_geometry.rotations import FloatArray

_GRAVITY = 9.80665
"""Standard gravity, m/s²."""

# Multiples of the modal frequency. Only 0.5 % of the variance of the elevation lies outside them, at high frequencies
# to which the hull does not respond.
_LOWEST, _HIGHEST = 0.5, 4.0


@dataclass(frozen=True)
class Response:
    """Response of one angle of the ship to the slope of the waves.

    Attributes:
        direction_factor: factor of the slope due to the direction of the waves.
        gain: angle per slope of a long wave.
        period_s: natural period.
        damping: damping ratio.
        length_m: length of hull that averages the slope.
    """

    direction_factor: float
    gain: float
    period_s: float
    damping: float
    length_m: float

    def transfer(self, angular_frequency: FloatArray) -> np.ndarray:
        """Return the angle per wave elevation, rad/m, complex, shape (n,)."""
        wave_number = angular_frequency**2 / _GRAVITY
        averaged_slope = wave_number * np.sinc(wave_number * self.length_m / (2.0 * np.pi))
        ratio = angular_frequency * self.period_s / (2.0 * np.pi)
        return self.direction_factor * self.gain * averaged_slope / (1.0 - ratio**2 + 2j * self.damping * ratio)


def wave_components(
    significant_height_m: float, modal_period_s: float, count: int, rng: np.random.Generator
) -> tuple[FloatArray, np.ndarray]:
    """Return a realisation of the sea as sinusoids: angular frequencies, rad/s, and complex amplitudes, m, each (n,).

    Each of the equal frequency bands contains one component with a random frequency, a random phase, and the exact
    variance of the band. Due to the random frequencies the sum is not periodic.
    """
    modal = 2.0 * np.pi / modal_period_s
    edges = modal * np.linspace(_LOWEST, _HIGHEST, count + 1)
    # The integral of the spectrum from 0 to w is Hs² / 16 exp(-5/4 (wp / w)⁴).
    variance = significant_height_m**2 / 16.0 * np.diff(np.exp(-1.25 * (modal / edges) ** 4))
    angular_frequency = edges[:-1] + np.diff(edges) * rng.random(count)
    phase = 2.0 * np.pi * rng.random(count)
    return angular_frequency, np.sqrt(2.0 * variance) * np.exp(1j * phase)


def ship_phasors(angular_frequency: FloatArray, elevation: np.ndarray, responses: Sequence[Response]) -> np.ndarray:
    """Return the complex amplitude of (heading, pitch, roll) for each wave, rad, shape (n, 3)."""
    return np.stack([elevation * response.transfer(angular_frequency) for response in responses], axis=-1)
