"""Common parts of both servers: allowed hosts and origins, and bounds of connections."""
