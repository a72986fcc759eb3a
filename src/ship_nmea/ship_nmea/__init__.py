"""NMEA 0183 live: attitude and alerts sent to bridge and logger, instruments' sentences received and published.

The package and the estimators do not depend on each other, and the package cannot delay an estimator.
"""
