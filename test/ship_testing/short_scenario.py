"""A scenario of four seconds."""


SHORT = """\
start_utc: "2014-07-09T11:50:07.8Z"
duration_s: 4.0
carrier:
  kind: sinusoids
  roll: {waves: {swell: {amplitude_deg: 4.0, period_s: 11.0}}}
ins: {tilt_sigma_arcsec: 11.0, heading_sigma_arcsec: 70.0, white_sigma_arcsec: 2.0}
star_sensors:
  fore: {azimuth_deg: 10.0, elevation_deg: 45.0, sigma_up_arcsec: 4.0, flexure_sigma_arcsec: 5.0}
references:
  gyro: {sigma_roll_arcsec: 33.0}
"""
