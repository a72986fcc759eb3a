"""NMEA 0183 live: attitude and alerts sent to bridge and logger, instruments' sentences received and published.

The nodes of the package run in their own processes and exchange only messages with the estimators, so they cannot
delay an estimator.
"""
