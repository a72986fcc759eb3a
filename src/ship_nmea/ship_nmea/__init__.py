"""NMEA 0183 live: attitude and alerts sent to bridge and logger, instruments' sentences received and published.

The package depends on no estimator, and no estimator depends on it. Nothing in it can delay an estimator.
"""
