"""The node ``nmea_out``: its parameters, its sinks, and the schedule of what is sent to which sink.

The folder imports the folder ``sentences``, but not ``instruments``. Each sink has a separate thread, so that
no sink delays another.
"""
