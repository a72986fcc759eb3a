"""NMEA 0183 live: the suite's attitude and alerts out to bridge and logger, instruments' sentences in as topics.

It stands beside :mod:`ship_monitor`; no estimator knows of it, and nothing that it does can hold one up.
"""
