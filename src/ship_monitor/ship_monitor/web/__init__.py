"""What both servers of the monitor share: which hosts and origins they answer, and the bounds of connections."""
