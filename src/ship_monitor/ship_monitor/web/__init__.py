"""Parts that both servers of the monitor share: the hosts and origins they answer, and the bounds of connections."""
