"""The node ``nmea_out``: its parameters, its sinks, and the schedule of what is sent to which sink.

The folder imports ``sentences`` and the node runtime. Each sink has a thread of its own, so that none delays another.
"""
